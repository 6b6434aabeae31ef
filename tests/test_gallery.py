"""Scripts of the gallery and the tutorial: they use public names, and show commands as commands.

The site's build runs them whole. Beside them, the moving picture of the README.
"""

import ast
import importlib
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
sys.path[:0] = [str(DOCS / "extensions")]

import lessons  # noqa: E402

GALLERY = sorted(DOCS.glob("gallery/*/plot_*.py"))
TUTORIAL = sorted(DOCS.glob("tutorial/plot_*.py"))
SCRIPTS = [*GALLERY, *TUTORIAL]


def named(tree: ast.Module) -> set[tuple[str, str]]:
    """Names of the package that a script uses, as pairs of module and name."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] == "deepfsi":
            found |= {(str(node.module), alias.name) for alias in node.names}
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            found |= {("deepfsi", node.attr)} if node.value.id == "deepfsi" else set()
    return found


def test_names_exist_and_are_public():
    for path in (*SCRIPTS, DOCS / "exposure.py"):
        tree = ast.parse(path.read_text())
        compile(tree, str(path), "exec")
        for module, name in named(tree):
            assert not any(part.startswith("_") for part in (*module.split("."), name)), path
            assert hasattr(importlib.import_module(module), name), f"{module} has no {name}"


def test_form():
    """A title with its line beneath, and figures that are shown, drawn for a phone.

    `docs/extensions/figures.py` has their style; wider ones have too small words there.
    """
    assert len(GALLERY) >= 12
    for path in SCRIPTS:
        text = path.read_text()
        docs = ast.get_docstring(ast.parse(text), clean=False)
        _, title, line, empty, *words = docs.split("\n")
        assert (line, empty) == ("=" * len(title), ""), path
        assert len(re.findall(r"[.?]", " ".join(words))) >= 2, path
        assert "\nplt.show()\n" in text, path
        assert not re.search("rcParams|fontsize", text), path
        assert set(re.findall(r"figsize=\(([\d.]+),", text)) <= {"4.8"}, path


def test_moving_picture_stands_alone():
    """It loads nothing, runs no script, is small, and stops for readers who want no motion."""
    file = DOCS / "figures" / "exposure.svg"
    text = file.read_text()
    assert file.stat().st_size < 600_000
    assert {element.tag.split("}")[1] for element in ET.fromstring(text).iter()} <= {
        *("svg", "style", "g", "rect", "path", "line", "text")
    }
    assert re.findall(r"https?://[^\"]+|url\(", text) == ["http://www.w3.org/2000/svg"]
    assert "prefers-reduced-motion" in text
    assert "prefers-color-scheme:dark" in text


def turned(code):
    """Page of the tutorial with a block of code, as Sphinx reads it."""
    source = [f".. code-block:: Python\n\n\n{code}\n\nText.\n"]
    lessons.turn(None, "generated/tutorial/plot_1_a", source)
    return source[0]


def test_command_lines_are_shown_as_commands():
    page = turned(
        '    os.system("deepfsi a")\n    os.system(\n        "deepfsi b "\n        "-o c"\n    )\n'
    )
    assert ".. code-block:: console\n" in page
    assert "    $ deepfsi a\n    $ deepfsi b -o c\n" in page
    assert "os.system" not in page
    assert page.endswith("Text.\n")


def test_a_file_is_shown_as_a_file():
    page = turned('    Path("my-lab.toml").write_text("""\\\n    a = 1\n    """)\n')
    assert ".. code-block:: toml\n    :caption: my-lab.toml\n\n    a = 1\n" in page


@pytest.mark.parametrize("code", ["x = os.system(1)", 'f("a")', "os.system(line)", "1 +"])
def test_other_code_stays(code):
    assert f"    {code}\n" in turned(f"    import os\n    {code}\n")


def test_no_scaffolding():
    for path in TUTORIAL:
        text = path.read_text()
        assert not re.search(r"tempfile|lesson|report\.style|def |sys\.|subprocess", text), path
        assert "my-pictures" in text, path


def test_a_command_that_fails_ends_the_build():
    with pytest.raises(lessons.subprocess.CalledProcessError):
        lessons.run("deepfsi no-such-command")
