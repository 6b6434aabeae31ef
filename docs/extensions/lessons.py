"""What the tutorial needs while the site is built, so that its scripts hold a reader's lines alone.

The scripts run in a folder of their own, with ``my-pictures`` in it. A command line is
``os.system("deepfsi ...")`` in a script; its page shows the command, and below it what it prints. A
camera file that a script writes is shown as a file.
"""

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

PICTURES = "my_pictures.py"
BLOCK = re.compile(r"^\.\. code-block:: Python\n\n+((?:    .*\n|\n)+)", re.M)


def prepared(scripts, folder):
    """Copy the scripts of the tutorial to a folder in which they can leave files."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for path in [*scripts.glob("plot_*.py"), scripts / "GALLERY_HEADER.rst"]:
        shutil.copy2(path, folder)
    return folder


def write_pictures(app):
    """Write the pictures that stand for a reader's own."""
    if app.config.plot_gallery not in (0, "0", False):
        home = Path(app.srcdir)
        script = home / "tutorial" / PICTURES
        subprocess.run([sys.executable, script], cwd=home / "_build/tutorial", check=True)


def begin(gallery_conf, script):
    """Give a script a ``system`` that prints what the command prints."""
    os.system = run


def run(line):
    """Run a command line of ``deepfsi``; an error ends the build."""
    words = [sys.executable, "-m", *shlex.split(line)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    print(*(each.rstrip() for each in done.stdout.splitlines()), sep="\n")
    print()


def calls(code):
    """Calls of a block of code that holds nothing else, each with its first argument; or none."""
    try:
        found = [each.value for each in ast.parse(code).body]
        return [(ast.unparse(each.func), ast.literal_eval(each.args[0])) for each in found]
    except (AttributeError, IndexError, SyntaxError, ValueError):
        return []


def shown(block):
    """Block of code of a page: command lines as such, and a file that is written as a file."""
    found = calls(textwrap.dedent(block[1]))
    names = {name for name, _ in found}
    if names == {"os.system"}:
        return directive("console", "\n".join(f"$ {line}" for _, line in found))
    if len(found) == 1 and (file := re.fullmatch(r"Path\('(.+)'\)\.write_text", found[0][0])):
        return directive("toml", found[0][1], f":caption: {file[1]}\n")
    return block[0].replace("    import os\n", "")


def directive(language, text, options=""):
    """A block of code in reStructuredText."""
    body = textwrap.indent(f"{options}\n{text}", "    ")
    return f".. code-block:: {language}\n{body}\n\n"


def turn(app, page, source):
    """Turn the command lines of a page of the tutorial, as Sphinx reads it."""
    if page.startswith("generated/tutorial/"):
        source[0] = BLOCK.sub(shown, source[0])


def setup(app):
    """Write the pictures before the scripts run, and turn their pages."""
    app.connect("builder-inited", write_pictures, priority=100)
    app.connect("source-read", turn)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
