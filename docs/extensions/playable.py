"""A page to play with, made while the site is built.

The directive `playable` has commands as its content: it shows them, runs them in a folder of their
own, and embeds the page that they write, whole. Its argument is the page's name. Without content it
embeds the page that another makes.
"""

import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from markdown import Made

FRAME = """<p><a href="{address}">Open it on its own</a></p>
<iframe class="playable" src="{address}" title="A camera to play with"></iframe>"""


def made(commands, name, folder):
    """Run commands of ``deepfsi``, and keep the page that they write in a folder."""
    with tempfile.TemporaryDirectory() as home:
        for line in commands:
            words = [sys.executable, "-m", *shlex.split(line)]
            subprocess.run(words, cwd=home, check=True, capture_output=True)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes((Path(home) / name).read_bytes())


class Playable(Made):
    """The directive."""

    required_arguments = 1

    def text(self):
        """The page in a frame, and commands below it; the commands alone in a quick build."""
        name = self.arguments[0]
        shown = "Made by\n\n```sh\n" + "\n".join(self.content) + "\n```" if self.content else ""
        if self.config.quick:
            return shown
        if self.content:
            made(self.content, name, Path(self.env.app.outdir) / "play")
        address = "../" * self.env.docname.count("/") + f"play/{name}"
        return f"```{{raw}} html\n{FRAME.format(address=address)}\n```\n\n{shown}"


def setup(app):
    """Add the directive."""
    app.add_directive("playable", Playable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
