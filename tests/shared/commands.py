"""The commands, by how they are typed."""

import click

from deepfsi.cli import app


def below(group: click.Group, before: str = "") -> dict[str, click.Command]:
    found: dict[str, click.Command] = {}
    context = click.Context(group)
    for name in group.list_commands(context):
        path = f"{before} {name}".strip()
        command = group.get_command(context, name)
        assert command is not None
        found |= below(command, path) if isinstance(command, click.Group) else {path: command}
    return found


COMMANDS = below(app)
"""Every command: ``camera count``."""

OPTIONS = {
    path: {name for each in command.params for name in each.opts if name.startswith("-")}
    for path, command in COMMANDS.items()
}
"""Names of its options: ``--dead-time``."""
