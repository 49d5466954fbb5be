"""What all subcommands have: help on one screen, and errors that name options as they are typed."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import click
from click.core import ParameterSource

from .._base.validation import nearest
from ..exceptions import InputError, InputTypeError

OK, INTERNAL, USAGE, IO = 0, 1, 2, 5
TIME_LIMIT, WORKERS_LOST = 4, 6  # of commands that can be run on
INTERRUPTED, TERMINATED = 130, 143  # 128 + SIGINT, 128 + SIGTERM
_MEANINGS = {
    OK: "done",
    INTERNAL: "internal error",
    USAGE: "usage or input",
    IO: "reading or writing files",
    INTERRUPTED: "Ctrl-C",
    TERMINATED: "SIGTERM",
}
_QUOTED = re.compile(r"`(\w+)((?:\[[^`]*\])?)`")  # an argument in a message of the package


def exit_codes(others: Mapping[int, str] | None = None) -> str:
    """All exit codes and what they mean, in a sentence."""
    meanings = sorted({**_MEANINGS, **(others or {})}.items())
    return f"Exit codes: {', '.join(f'{code} {meaning}' for code, meaning in meanings)}."


class Group(click.Group):
    """The subcommands; an unknown one is answered by the nearest name."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Find the subcommand."""
        if self.get_command(ctx, args[0]) is None and not ctx.resilient_parsing:
            ctx.fail(f"No such command {args[0]!r}{nearest(args[0], self.commands)}")
        return super().resolve_command(ctx, args)


class Command(click.Command):
    """A subcommand.

    `examples` are command lines without the program's name; `sections` has the names of options
    that get a heading of their own; `codes` are exit codes that only this command has; `arguments`
    are options that hand over an argument of another name.
    """

    def __init__(
        self,
        *args: Any,
        examples: Sequence[str],
        sections: Mapping[str, Sequence[str]] | None = None,
        codes: Mapping[int, str] | None = None,
        arguments: Mapping[str, str] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(*args, **options)
        self.examples = tuple(examples)
        self._sections, self._arguments = dict(sections or {}), dict(arguments or {})
        self._codes = exit_codes(codes)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options under their headings."""
        options = [one for one in self.get_params(ctx) if isinstance(one, click.Option)]
        records = {one.name: one.get_help_record(ctx) for one in options}
        special = {name for names in self._sections.values() for name in names}
        rest = [name for name in records if name not in special]
        for heading, names in {**self._sections, "Options": rest}.items():
            rows = [record for name in names if (record := records[name]) is not None]
            with formatter.section(heading):
                formatter.write_dl(rows, col_max=30)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write examples, in lines that can be copied, and exit codes."""
        with formatter.section("Examples"):
            for line in self.examples:
                formatter.write(f"{'':{formatter.current_indent}}stochens {line}\n")
        formatter.write_paragraph()
        formatter.write_text(self._codes)

    def invoke(self, ctx: click.Context) -> Any:
        """Run it; an error about an argument of the package names the option it came from."""
        try:
            return super().invoke(ctx)
        except (InputError, InputTypeError) as error:
            raise click.UsageError(self._as_typed(str(error), ctx)) from error

    def _as_typed(self, message: str, ctx: click.Context) -> str:
        options = {one.name: one.opts[0] for one in self.params if isinstance(one, click.Option)}
        for argument, name in self._arguments.items():
            if ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE:  # not from a file
                options[argument] = options[name]
        return _QUOTED.sub(
            lambda found: options[found[1]] + found[2] if found[1] in options else found[0], message
        )
