"""A page to play with, made while the site is built.

The directive `playable` embeds the page that its argument names. If a block of text of its page
ends with the command that writes it, the commands of the block are run in a folder of their own.
"""

import re
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
        """The page in a frame; nothing in a quick build."""
        name = self.arguments[0]
        if self.config.quick:
            return ""
        text = Path(self.env.doc2path(self.env.docname)).read_text()
        block = re.search(rf"^```text\n((?:deepfsi .*\n)*deepfsi .* {name})\n```$", text, re.M)
        if block:
            made(block[1].splitlines(), name, Path(self.env.app.outdir) / "play")
        address = "../" * self.env.docname.count("/") + f"play/{name}"
        return f"```{{raw}} html\n{FRAME.format(address=address)}\n```"


def setup(app):
    """Add the directive."""
    app.add_directive("playable", Playable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
