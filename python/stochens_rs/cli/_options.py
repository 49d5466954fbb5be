"""Options that several subcommands take, and what a shell completes of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.shell_completion import CompletionItem

from .._base.types import DELTA
from .._base.validation import nearest
from ..cases import CASES
from ._problem import share

if TYPE_CHECKING:
    _ParamType = click.ParamType[str]
    _Choice = click.Choice[str]
else:  # without arguments before click 8.2
    _ParamType, _Choice = click.ParamType, click.Choice

F = TypeVar("F", bound=Callable[..., Any])


class Place(_ParamType):
    """The path of a file or directory, or one of some words; nothing of it is checked."""

    def __init__(self, kind: str, words: Iterable[str] = ()) -> None:
        self.name, self._words = kind, tuple(words)

    def shell_complete(self, *given: Any) -> list[CompletionItem]:
        """Complete the words, or let the shell complete a path."""
        found = [CompletionItem(word) for word in self._words if word.startswith(given[-1])]
        return found or [CompletionItem(given[-1], type=self.name)]


class Words(_ParamType):
    """Words with commas between them; nothing of it is checked."""

    name = "words"

    def __init__(self, words: Iterable[str]) -> None:
        self._words = tuple(words)

    def shell_complete(self, *given: Any) -> list[CompletionItem]:
        """Complete the last word by one that is not there yet."""
        before, comma, last = given[-1].rpartition(",")
        left = [word for word in self._words if word not in before.split(",")]
        return [CompletionItem(before + comma + word) for word in left if word.startswith(last)]


class Choice(_Choice):
    """One of some words; the message asks whether the nearest one was meant."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the word."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter as error:
            text = error.message.rstrip(".") + nearest(str(value), self.choices)
            raise click.BadParameter(text, ctx, param) from None


FILE, DIRECTORY = Place("file"), Place("dir")
ENDINGS = ".npz, .mat or JSON"


def out_option(name: str, more: str = "") -> Callable[[F], F]:
    """The directory for ``<name>.json`` and the figure; `more`: what files it may be, too."""
    text = f"Write {name}.json and the figure to this directory"
    return click.option(
        "--out",
        type=DIRECTORY,
        multiple=bool(more),
        metavar="OUT" if more else "DIR",
        help=f"{text}; or {more}; or both." if more else f"{text}.",
    )


def delta_option(text: str) -> Callable[[F], F]:
    """A probability of failure, as ``5%`` or ``0.05``."""
    return click.option(
        "--delta",
        metavar="P",
        default=f"{DELTA:.0%}",
        callback=lambda _, __, value: share(value, "--delta"),
        help=text,
    )


case_option = click.option("--case", type=Choice(tuple(CASES)), help="An example system.")
file_option = click.option(
    "--file",
    "path",
    type=FILE,
    metavar="FILE",
    help=f"Your system: {ENDINGS} with A, B and optionally x0, xf.",
)
seed_option = click.option(
    "--seed",
    metavar="S",
    type=click.IntRange(min=0),
    default=1,
    help="Seed of all random numbers.",
)
steps_option = click.option(
    "--steps", metavar="K", type=click.IntRange(min=1), default=1, help="Number of steps."
)
force_option = click.option(
    "--force", is_flag=True, help="Replace the files of a run with other options."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
