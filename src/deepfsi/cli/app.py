"""The commands by their names, and how a command line is run.

Names and summaries are in `commands.toml`, so that `--help` of a group loads none of its commands.
"""

import contextlib
import gc
import io
import os
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, NoReturn

import click

import deepfsi
from deepfsi.base.errors import InputError, one_line
from deepfsi.base.interrupts import STOPPED_EXIT_CODE, say_stopped
from deepfsi.base.registry import installed, require_extras


@click.pass_context
def _print_help(ctx: click.Context, version: bool = False) -> None:
    """Print the version, or the help of a group that is given without a command."""
    if version:
        print(f"deepfsi {deepfsi.__version__}")
        ctx.exit()
    if ctx.invoked_subcommand is None:
        print(ctx.get_help())


class Group(click.Group):
    """Commands under headings, each with its whole sentence, none of it cut."""

    def __init__(self, name: str, help: str, headings: Mapping[str, Mapping[str, Any]]) -> None:
        super().__init__(
            name,
            help=help,
            callback=_print_help,
            invoke_without_command=True,
            subcommand_metavar="COMMAND [ARGS]...",
            context_settings={"help_option_names": ["-h", "--help"]},
        )
        self.headings = headings
        self.entries = {name: entry for those in headings.values() for name, entry in those.items()}

    @property
    def beside(self) -> dict[str, tuple[str, str]]:
        """Commands of packages beside the core."""
        above = "" if self.name == "deepfsi" else f"{self.name} "
        words = installed().commands.items()
        return {
            name.removeprefix(above): entry
            for name, entry in words
            if name.startswith(above) and " " not in name.removeprefix(above)
        }

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the help."""
        return [*self.entries, *self.beside]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of a name, or the group."""
        entry = self.entries.get(cmd_name) or self.beside.get(cmd_name)
        if entry is None:
            return None
        if isinstance(entry, dict):
            summary, example, *headings = entry
            text = f"{entry[summary]}\n\nExample: {entry[example]}"
            return Group(cmd_name, text, {heading: entry[heading] for heading in headings})
        target, summary = entry
        gc.disable()  # what imports make stays: to look through it takes a seventh of their time
        try:
            from deepfsi.cli.command import ClickCommand  # slow: pydantic

            return ClickCommand(resolve_name(target), cmd_name, summary)
        finally:
            gc.enable()

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands under their headings."""
        beside = {"Beside the core": self.beside} if self.beside else {}
        width = max(map(len, self.list_commands(ctx)))
        for heading, entries in {**self.headings, **beside}.items():
            with formatter.section(heading):
                formatter.write_dl(
                    [
                        (
                            name.ljust(width),
                            entry["summary"] if isinstance(entry, dict) else entry[1],
                        )
                        for name, entry in entries.items()
                    ]
                )


app = Group(
    "deepfsi",
    "Design the masks of a photon-limited single-pixel camera with the network that reads them."
    "\n\nStart with: deepfsi compare",
    tomllib.loads(Path(__file__).with_name("commands.toml").read_text(encoding="utf-8")),
)
"""The command line."""
app.params.append(click.Option(["--version"], is_flag=True, help="print the version and stop"))


def run_command_line() -> NoReturn:
    """Entry point: 0 done, 1 a check failed, 2 bad input, 130 or 143 stopped."""
    # Figures are files here: a notebook's backend, or settings of a user's own, would break them
    os.environ |= {"MPLBACKEND": "agg", "MATPLOTLIBRC": os.devnull}
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a console may lack a letter of a name
    code: Any = 0
    try:
        _check_here()
        with require_extras():
            code = app(prog_name="deepfsi", standalone_mode=False)
    except (KeyboardInterrupt, click.Abort):
        code = STOPPED_EXIT_CODE
    except InputError as error:
        _fail(error.message)
    except click.ClickException as error:
        words = error.format_message()
        context = getattr(error, "ctx", None)
        _fail(f"{words.rstrip('.')}; see `{context.command_path} --help`" if context else words)
    except ValueError as error:
        if not isinstance(error.__cause__, KeyboardInterrupt):  # what pydantic makes of Ctrl-C
            raise
        code = STOPPED_EXIT_CODE
    except OSError as error:
        _fail(f"{error.filename or 'cannot write the output'}: {error.strerror or error}")
    if code == STOPPED_EXIT_CODE:
        say_stopped()
    sys.exit(code if isinstance(code, int) else 0)


def _check_here() -> None:
    """Raise `InputError` in a folder that was removed, in which libraries end the process."""
    try:
        os.getcwd()
    except FileNotFoundError:
        raise InputError("the current folder is no longer there: go to another one") from None


def _fail(message: str) -> NoReturn:
    with contextlib.suppress(OSError):  # a full disk takes no message
        line = " ".join(one_line(message).split())
        print(f"deepfsi: {line}", file=sys.stderr, flush=True)
    sys.exit(2)
