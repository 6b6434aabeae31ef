"""The commands by their words, and how a command line is run.

Words and summaries are in `commands.toml`, so that `--help` of a group loads none of its commands.
"""

import contextlib
import functools
import gc
import io
import os
import sys
import tomllib
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, NoReturn

import click

from deepfsi.base.errors import InputError, one_line
from deepfsi.base.interrupts import STOPPED_EXIT_CODE, say_stopped
from deepfsi.base.registry import installed, require_extras


@functools.cache
def _entries() -> dict[str, dict[str, tuple[str, str]]]:
    """Commands and groups by name, under headings; other packages come last."""
    core = tomllib.loads(Path(__file__).with_name("commands.toml").read_text(encoding="utf-8"))
    return {**core, "Beside the core": installed().commands}


@click.pass_context
def _print_help(ctx: click.Context) -> None:
    """Print the help of a group that stands without a command."""
    if ctx.invoked_subcommand is None:
        print(ctx.get_help())


class Group(click.Group):
    """Commands under headings, each with its whole sentence."""

    def __init__(self, name: str, help: str, above: str = "") -> None:
        super().__init__(
            name,
            help=help,
            callback=_print_help,
            invoke_without_command=True,
            subcommand_metavar="COMMAND [ARGS]...",
            context_settings={"help_option_names": ["-h", "--help"]},
        )
        self.entries: dict[str, tuple[str, str]] = {}  # target, or "", and summary
        self.headings: dict[str, dict[str, tuple[str, str]]] = {}
        for heading, entries in _entries().items():
            for words, entry in entries.items():
                first, _, last = words.rpartition(" ")
                if first == above:
                    self.headings.setdefault(heading, {})[last] = entry
                    self.entries[last] = entry

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the help."""
        return list(self.entries)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of a name, or the group."""
        if cmd_name not in self.entries:
            return None
        target, summary = self.entries[cmd_name]
        if not target:
            return Group(cmd_name, summary, cmd_name)
        # Objects of imports stay: to look through them would take a seventh of their time
        gc.disable()
        try:
            from deepfsi.cli.command import ClickCommand  # slow: pydantic

            return ClickCommand(resolve_name(target), cmd_name, summary)
        finally:
            gc.enable()

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands under their headings."""
        width = max(map(len, self.entries))
        for heading, entries in self.headings.items():
            with formatter.section(heading):
                formatter.write_dl(
                    [(name.ljust(width), words) for name, (_, words) in entries.items()]
                )


app = click.version_option(package_name="deepfsi", message="deepfsi %(version)s")(
    Group(
        "deepfsi",
        "Design the masks of a photon-limited single-pixel camera with the network that reads them."
        "\n\nStart with: deepfsi compare",
    )
)
"""The command line."""


def run_command_line() -> NoReturn:
    """Entry point: 0 done, 1 a check failed, 2 bad input, 130 or 143 stopped."""
    # Figures are files here: a notebook's backend, or settings of a user's own, would break them
    os.environ |= {"MPLBACKEND": "agg", "MATPLOTLIBRC": os.devnull}
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a console may lack a letter of a name
    code: Any = 0
    try:
        with require_extras():
            code = app(prog_name="deepfsi", standalone_mode=False)
    except (KeyboardInterrupt, click.Abort):
        code = STOPPED_EXIT_CODE
    except InputError as error:
        _fail(str(error))
    except click.ClickException as error:
        words = error.format_message()
        context = getattr(error, "ctx", None)
        _fail(f"{words.rstrip('.')}; see `{context.command_path} --help`" if context else words)
    except ValueError as error:
        if not isinstance(error.__cause__, KeyboardInterrupt):  # pydantic wraps Ctrl-C
            raise
        code = STOPPED_EXIT_CODE
    except OSError as error:
        # Else Python flushes again at its end, and exits with 120
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        _fail(f"{error.filename or 'cannot write the output'}: {error.strerror or error}")
    if code == STOPPED_EXIT_CODE:
        say_stopped()
    sys.exit(code or 0)


def _fail(message: str) -> NoReturn:
    line = " ".join(one_line(message).split())
    try:
        print(f"deepfsi: {line}", file=sys.stderr, flush=True)
    except OSError:  # a full disk; Python would flush again at its end, and exit with 120
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
    sys.exit(2)
