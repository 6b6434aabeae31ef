"""Scripts of the gallery and the tutorial: they compile, and use public names that exist.

The site's build runs them whole. Beside them, the moving picture of the README.
"""

import ast
import importlib
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

DOCS = Path(__file__).parent.parent / "docs"
GALLERY = sorted(DOCS.glob("gallery/*/plot_*.py"))
SCRIPTS = [*GALLERY, *sorted(DOCS.glob("tutorial/plot_*.py"))]


def named(tree: ast.Module) -> set[tuple[str, str]]:
    """Names of the package that a script uses, as pairs of module and name."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] == "deepfsi":
            found |= {(str(node.module), alias.name) for alias in node.names}
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            found |= {("deepfsi", node.attr)} if node.value.id == "deepfsi" else set()
    return found


def test_a_dozen_scripts():
    assert len(GALLERY) >= 12


@pytest.mark.parametrize("path", [*SCRIPTS, DOCS / "exposure.py"], ids=lambda path: path.stem)
def test_names_exist_and_are_public(path):
    tree = ast.parse(path.read_text())
    compile(tree, str(path), "exec")
    for module, name in named(tree):
        assert not any(part.startswith("_") for part in (*module.split("."), name))
        assert hasattr(importlib.import_module(module), name), f"{module} has no {name}"


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_form(path):
    """A title with its line beneath, and a figure that is shown."""
    text = path.read_text()
    _, title, line, empty, *words = ast.get_docstring(ast.parse(text), clean=False).split("\n")
    assert (line, empty) == ("=" * len(title), "")
    assert len(re.findall(r"[.?]", " ".join(words))) >= 2
    assert "\nplt.show()\n" in text


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_figures_are_drawn_for_a_phone(path):
    """`docs/extensions/figures.py` has their style; wider ones have too small words there."""
    text = path.read_text()
    assert "rcParams" not in text
    assert "fontsize" not in text
    assert {float(width) for width in re.findall(r"figsize=\(([\d.]+),", text)} <= {4.8}


def test_moving_picture_stands_alone():
    """It loads nothing, runs no script, is small, and stops for readers who want no motion."""
    file = DOCS / "figures" / "exposure.svg"
    text = file.read_text()
    assert file.stat().st_size < 600_000
    assert {element.tag.split("}")[1] for element in ET.fromstring(text).iter()} <= {
        *("svg", "style", "g", "rect", "path", "line", "text"),
    }
    assert re.findall(r"https?://[^\"]+|url\(", text) == ["http://www.w3.org/2000/svg"]
    assert "prefers-reduced-motion" in text
    assert "prefers-color-scheme:dark" in text
