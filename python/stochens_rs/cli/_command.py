"""Commands from functions, and what they print: arguments and options are those of the signature,
with the help that the docstring has for each of them.

A docstring is a summary, paragraphs, and sections with a line for each argument::

    Options:
      start --from X,Y  Initial state; default: of the problem.

the name in the signature, the option if it is not that name, a word for its value, and the help.
Positional parameters are arguments; a type other than bool, int, float and str is given as
``Annotated[..., click type]``.
"""

from __future__ import annotations

import contextlib
import inspect
import json
import os
import re
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import wrap
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import click
import numpy as np
from click.core import ParameterSource

from .._base import files
from .._base.reading import number
from .._base.tables import columns
from .._base.types import DELTA, Figure
from .._base.validation import nearest
from ..exceptions import InputError, InputTypeError
from ..plots import save_figures
from ..plots.style import require_matplotlib

OK, INTERNAL, USAGE, IO, INTERRUPTED = 0, 1, 2, 5, 130  # 128 + SIGINT
EXIT_CODES = (
    "Exit codes: 0 done, 1 internal error, 2 usage or input, 5 reading or writing files, "
    "130 Ctrl-C, 143 SIGTERM."
)
_QUOTED = re.compile(r"`(\w+)((?:\[[^`]*\])?)`")  # an argument in a message of the package
_ENTRY = re.compile(r"(\w+)(?: (--\S+))?(?: (\S+))?  +(\S.*)")


class Group(click.Group):
    """The subcommands; an unknown one is answered by the nearest name."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Find the subcommand."""
        if self.get_command(ctx, args[0]) is None and not ctx.resilient_parsing:
            ctx.fail(f"No such command {args[0]!r}{nearest(args[0], self.commands)}")
        return super().resolve_command(ctx, args)


class Command(click.Command):
    """A subcommand, with options under headings, examples in lines that can be copied, and errors
    that name options as they are typed.
    """

    sections: dict[str, list[str]]
    examples: list[str]
    arguments: dict[str, str]  # of the package, that options of another name hand over

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options under their headings."""
        options = {one.name: one for one in self.get_params(ctx) if isinstance(one, click.Option)}
        sections = {**self.sections, "Options": [*self.sections["Options"], "help"]}
        for heading, names in sections.items():
            rows = [options[name].get_help_record(ctx) for name in names if name in options]
            with formatter.section(heading):
                formatter.write_dl([row for row in rows if row], col_max=30)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write examples and exit codes."""
        with formatter.section("Examples"):
            for line in self.examples:
                formatter.write(f"{'':{formatter.current_indent}}stochens {line}\n")
        formatter.write_paragraph()
        formatter.write_text(EXIT_CODES)

    def invoke(self, ctx: click.Context) -> Any:
        """Run it; an error about an argument of the package names the option it came from."""
        try:
            return super().invoke(ctx)
        except (InputError, InputTypeError) as error:
            options = {p.name: p.opts[0] for p in self.params if isinstance(p, click.Option)}
            for argument, name in self.arguments.items():
                if ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE:  # not from a file
                    options[argument] = options[name]

            def typed(found: re.Match[str]) -> str:
                return options[found[1]] + found[2] if found[1] in options else found[0]

            raise click.UsageError(_QUOTED.sub(typed, str(error))) from error


def command(**arguments: str) -> Callable[[Callable[..., Any]], Command]:
    """Make a command of a function ``<name>_command``; `arguments` are those of the package that
    options of another name hand over, as in ``x0="start"``.
    """

    def made(function: Callable[..., Any]) -> Command:
        about, *sections = re.split(r"\n(?=[A-Z][\w ]*:\n  )", inspect.getdoc(function) or "")
        entries: dict[str, tuple[str | None, str | None, str]] = {}
        listed: dict[str, list[str]] = {}
        for section in sections:
            heading, _, body = section.partition(":\n")
            lines = re.sub(r"\n {4,}", " ", body).strip().split("\n")
            listed[heading] = [line.strip() for line in lines]
            if heading != "For example":
                found = [_ENTRY.fullmatch(line) for line in listed[heading]]
                listed[heading] = [match[1] for match in found if match]
                entries |= {match[1]: (match[2], match[3], match[4]) for match in found if match}
        kinds = get_type_hints(function, include_extras=True)
        params = [
            _parameter(one, kinds[one.name], *entries[one.name])
            for one in inspect.signature(function).parameters.values()
        ]
        name = function.__name__.removesuffix("_command")
        summary = about.partition("\n")[0]
        new = Command(name, callback=function, params=params, help=about, short_help=summary)
        new.examples, new.sections, new.arguments = listed.pop("For example"), listed, arguments
        return new

    return made


def _parameter(
    one: inspect.Parameter, kind: Any, option: str | None, metavar: str | None, text: str
) -> click.Parameter:
    """The argument or the option for a parameter of a function."""
    of, repeated = (get_args(kind)[1] if get_origin(kind) is Annotated else kind), False
    if get_origin(kind) is tuple:
        of, repeated = get_args(kind)[0], True
        of = get_args(of)[1] if get_origin(of) is Annotated else of
    given = [arm for arm in get_args(of) if arm is not type(None)]
    of = given[0] if given else of  # `str | None`
    if one.kind is not one.KEYWORD_ONLY:
        count = -1 if repeated else 1
        return click.Argument([one.name], metavar=metavar, type=of, required=True, nargs=count)
    how: dict[str, Any] = {"is_flag": True} if of is bool else {"type": of, "metavar": metavar}
    spelled = option or f"--{one.name.replace('_', '-')}"
    how |= {"multiple": True} if repeated else {"default": one.default}
    return click.Option([spelled, one.name], help=text, **how)


class Parsed(click.ParamType):  # type: ignore[type-arg]
    """What a function makes of a text."""

    name = "text"

    def __init__(self, read: Callable[[str], Any], wanted: str) -> None:
        self.read, self.wanted = read, wanted

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Read it; a ValueError says that it is not what was wanted."""
        try:
            return self.read(value)
        except ValueError:
            raise click.BadParameter(f"{value!r} must be {self.wanted}", ctx, param) from None


def _share(text: str) -> float:
    """Read ``5%`` or ``0.05``; 5 without percent sign is a likely mistake."""
    figure = str(text).strip()
    if figure.endswith("%"):
        return number(figure[:-1]) / 100.0
    if (found := number(figure)) >= 1.0:
        raise click.BadParameter(f"{figure} is {100 * found:g} %: give {figure}% or less than 1")
    return found


def _names(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise ValueError
    return names


def numbers(text: str) -> list[float]:
    """Read ``1,0,-0.5``."""
    return [number(one) for one in text.split(",")]


def _entries(text: str) -> float | list[float]:
    """Read ``1``, for all, or ``1,0,2``, one number for each."""
    values = numbers(text)
    return values[0] if len(values) == 1 else values


def _sides(text: str) -> tuple[str, tuple[float, float]]:
    """Read ``-1,1`` and ``force=-1,1``."""
    name, _, pair = text.rpartition("=")
    low, high = numbers(pair)
    return name, (low, high)


Share = Annotated[Any, Parsed(_share, "a share, such as 5%")]
File = Annotated[str, click.Path(readable=False)]
Count = Annotated[int, click.IntRange(min=1)]
Word = Annotated[Any, str]  # one of some words, which the package checks
Names = Annotated[Any, Parsed(_names, "names with commas")]
Numbers = Annotated[Any, Parsed(numbers, "numbers with commas")]
Entries = Annotated[Any, Parsed(_entries, "numbers with commas")]
Sides = Annotated[Any, Parsed(_sides, "LOW,HIGH")]
LEVEL = f"{DELTA:.0%}"


_UNBROKEN = 10_000  # columns of an output that is no terminal


def occupy_standard_descriptors() -> None:
    """Open closed standard streams (``2>&-``), so that no later file gets their numbers."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, this one


def note(text: str) -> None:
    """Write to standard error; the command goes on if that fails."""
    with contextlib.suppress(OSError):
        click.echo(text, err=True)


def drop_unwritten() -> None:
    """Drop what cannot be written: at its end Python would try again, and exit with 120."""
    for stream in filter(None, (sys.stdout, sys.stderr)):  # None: closed from the start
        try:
            stream.flush()
        except (OSError, ValueError):
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def show(text: str) -> None:
    """Write to standard output and flush, so that a closed pipe is noticed here."""
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except BrokenPipeError:  # the reader has closed it: click ends the command
        raise
    except OSError as error:
        raise OSError(f"cannot write to standard output: {error.strerror}") from None


def show_result(facts: dict[str, Any], text: str, as_json: bool) -> None:
    """Print the result as JSON or as text, whose long lines go on below what they say."""
    if not as_json:  # as wide as the terminal; a line goes on below the text of ``certified  the``
        how: Any = {"break_long_words": False, "break_on_hyphens": False}
        how |= {"width": _room(), "subsequent_indent": " " * 11}
        show("\n".join("\n".join(wrap(line, **how)) for line in text.split("\n")))
    else:
        show(json.dumps(facts, allow_nan=False, indent=2))


class Out:
    """What ``--out`` names: a directory, checked when this is made; a `file` with an ending."""

    def __init__(
        self, given: Sequence[str], name: str, force: bool, endings: Sequence[str] = ()
    ) -> None:
        for path in given:
            ending = Path(path).suffix
            if not path.strip():
                raise click.BadParameter("the directory has no name", param_hint="--out")
            if hint := ending not in endings and nearest(ending, endings):
                raise click.BadParameter(f"{path!r} ends in {ending!r}{hint}", param_hint="--out")
        found = [path for path in given if Path(path).suffix in endings]
        folders = [path for path in given if path not in found]
        if max(len(found), len(folders)) > 1:
            raise click.UsageError("--out must be one directory, one file, or one of each")
        self.file, self._name = (found[0] if found else None), name
        self._folder = Path(folders[0]) if folders else None
        if self._folder is not None:
            require_matplotlib()
            there = next(p for p in (self._folder, *self._folder.parents) if os.path.lexists(p))
            if not there.is_dir() or not os.access(there, os.W_OK):
                raise NotADirectoryError(20, "no directory that can be written", str(there))
            taken = [
                p for k in ("json", "png", "svg") if (p := self._folder / f"{name}.{k}").exists()
            ]
            if taken and not force:
                raise InputError(f"{taken[0]} exists: give another --out, or --force to replace it")

    def write(self, facts: dict[str, Any], draw: Callable[[], Figure]) -> None:
        """Write facts and the figure to the directory if there is one; name the files."""
        if self._folder is None:
            return
        self._folder.mkdir(parents=True, exist_ok=True)
        listing = self._folder / f"{self._name}.json"
        files.write_text(listing, json.dumps(facts, allow_nan=False) + "\n")
        for path in (listing, *save_figures({self._name: draw()}, self._folder)):
            note(f"written: {path}")


def finite(values: Any) -> Any:
    """Numbers for JSON, as lists: None where one is infinite or nan."""
    given = np.asarray(values, dtype=np.float64)
    return np.where(np.isfinite(given), given.astype(object), np.array(None)).tolist()


def grid(rows: list[list[str]]) -> list[str]:
    """Lines of cells in columns, as wide as the terminal: see `columns`."""
    return columns(rows, _room())


def _room() -> int:
    """Characters of a line of the terminal."""
    return shutil.get_terminal_size((_UNBROKEN, 0)).columns
