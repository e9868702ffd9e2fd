"""The page of all commands, made from the help of `vsense`: `make docs` writes it into the site."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator

import click

from vsense_ros.cli import main

HEAD = """# Commands

This page is made from the command line itself; `vsense COMMAND --help` prints the same. `--vehicle` takes
a vehicle file, or the name of one in `config/vehicles`.
"""


def commands(group: click.Group, prefix: str) -> Iterator[tuple[str, click.Command]]:
    """Every command of the group and of the groups below it, with its full name, in alphabetical order."""
    for name, command in sorted(group.commands.items()):
        if command.hidden:
            continue
        yield f"{prefix} {name}", command
        if isinstance(command, click.Group):
            yield from commands(command, f"{prefix} {name}")


def page() -> str:
    """The page in Markdown."""
    return HEAD + "".join(section(name, command) for name, command in commands(main, "vsense"))


def section(name: str, command: click.Command) -> str:
    """Usage, description and options of one command."""
    context = click.Context(command, info_name=name)
    usage = " ".join([name, *command.collect_usage_pieces(context)])
    return f"\n## {name}\n\n    {usage}\n\n{description(command.help or '')}\n{options(command, context)}"


def description(text: str) -> str:
    """The help of a command as Markdown: paragraphs, and what click prints as it stands as code."""
    blocks = []
    for paragraph in re.split(r"\n\s*\n", inspect.cleandoc(text)):
        first, *rest = paragraph.splitlines()
        if first.strip() == "\b":
            code = [line for line in rest if not re.fullmatch(r"Examples?:", line.strip())]
            blocks.append("```sh\n" + "\n".join(line.strip() for line in code) + "\n```")
        else:
            blocks.append(_escaped(" ".join(line.strip() for line in paragraph.splitlines())))
    return "\n\n".join(blocks) + "\n"


def options(command: click.Command, context: click.Context) -> str:
    """A table of the options."""
    rows = []
    for parameter in command.params:
        record = parameter.get_help_record(context) if isinstance(parameter, click.Option) else None
        if record is not None:
            name, meaning = (_escaped(cell).replace("|", "\\|") for cell in record)
            rows.append(f"| `{name}` | {meaning} |")
    return "\n| option | meaning |\n|---|---|\n" + "\n".join(rows) + "\n" if rows else ""


def _escaped(text: str) -> str:
    """Text in which Markdown sees no tags and no emphasis, outside of code."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(p if i % 2 else re.sub(r"([<*_\[])", r"\\\1", p) for i, p in enumerate(parts))
