"""What streams take in, as blocks of rows: realizations, and pairs (x, u, 1, x_next)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .._base import running, validation
from .._base.names import Labels, checked_names, order_of
from .._base.types import Floats
from ..data import Trajectories
from ..ensembles.ensemble import Ensemble
from ..exceptions import InputError, ShapeError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    FeedLike: TypeAlias = ArrayLike | Ensemble | Iterable[ArrayLike]
    from collections.abc import Sequence

    from .._base.types import Floats
    from .snapshot import Snapshot


_BLOCK = 2**18  # entries in a block, 2 MiB


def blocks(name: str, value: Any, shape: tuple[int, ...]) -> Iterable[Floats]:
    """Return realizations of this shape as rows; arrays and ensembles are checked at once."""
    entries = int(np.prod(shape))
    rows = max(1, _BLOCK // entries)
    if isinstance(value, Ensemble):
        if value.shape != shape:
            raise ShapeError(f"`{name}` must have shape {shape}, got {value.shape}")
        return (block.reshape(-1, entries) for block in value._dense_blocks(rows))
    if isinstance(value, Iterator):
        return _gathered(name, value, shape, rows)
    array = validation.array(name, value, ndim=(len(shape), len(shape) + 1))
    if array.shape[-len(shape) :] != shape:
        raise ShapeError(
            f"`{name}` must have shape {shape} or (k, {', '.join(map(str, shape))}), "
            f"got {array.shape}"
        )
    return [array.reshape(-1, entries)]


def _gathered(
    name: str, items: Iterator[Any], shape: tuple[int, ...], rows: int
) -> Iterator[Floats]:
    """Collect single realizations into blocks of rows."""
    pending: list[Floats] = []
    try:
        for item in items:
            pending.append(_one(name, item, shape).ravel())
            if len(pending) == rows:
                yield np.stack(pending)
                pending = []
    except GeneratorExit:  # the core refused a block
        raise
    except BaseException:  # the realizations before the faulty one, or Ctrl-C, are taken in
        if pending:
            yield np.stack(pending)
        raise
    if pending:
        yield np.stack(pending)


def _one(name: str, item: object, shape: tuple[int, ...]) -> Floats:
    if len(shape) == 1:
        return validation.vector(name, item, length=shape[0])
    return validation.matrix(name, item, rows=shape[0], cols=shape[1])


LISTED = 6  # most names in a message


def pair_rows(about: Snapshot, x: Any, u: Any, x_next: Any) -> Floats:
    """Check pairs or runs of a stream, and return their rows."""
    n, m = about.n, about.m
    if isinstance(x, Trajectories):
        if u is not None or x_next is not None:
            raise InputError("`u` and `x_next` must be left out with Trajectories")
        _refuse_runs(about, x)
        order = order_of("x", Labels(x.state_names, x.input_names), about.labels)
        before, inputs, after = x.pairs()
        before, after = order.of_states(before), order.of_states(after)
        inputs = order.of_inputs(inputs)
    elif u is None or x_next is None:
        raise InputError("`u` and `x_next` must be given with `x`")
    elif validation.array("x", x, ndim=(1, 2)).ndim == 1:
        before = validation.vector("x", x, length=n)[None]
        inputs = validation.vector("u", u, length=m)[None]
        after = validation.vector("x_next", x_next, length=n)[None]
    else:
        before = validation.matrix("x", x, cols=n)
        inputs = validation.matrix("u", u, rows=len(before), cols=m)
        after = validation.matrix("x_next", x_next, rows=len(before), cols=n)
    running.need("the pairs", 8 * len(before) * len(about.triangle))
    return np.hstack([before, inputs, np.ones((len(before), int(about.intercept))), after])


def _refuse_runs(about: Snapshot, runs: Trajectories) -> None:
    """Refuse runs of another system."""
    if runs.outputs:
        raise InputError("`x` must be runs of states, got outputs: see identify")
    if (runs.n, runs.m) != (about.n, about.m):
        raise InputError(
            f"`x` must be runs with n={about.n} m={about.m}, got n={runs.n} m={runs.m}"
        )
    if runs.dt != about.dt:
        raise InputError(
            f"`x` must be runs with dt={about.dt}, got dt={runs.dt}: pass dt={runs.dt} to "
            "ModelStream"
        )
    names = about.state_names, about.input_names
    theirs = runs.state_names, runs.input_names
    if any(sorted(mine) != sorted(its) for mine, its in zip(names, theirs, strict=True)):
        named = names != checked_names(about.n, about.m, None, None)
        pass_on, to = (names, "the runs") if named else (theirs, "ModelStream")
        raise InputError(
            f"`x` must be runs with the names of the stream, {_listed(names)}, got "
            f"{_listed(theirs)}: pass state_names=[{_words(pass_on[0])}], "
            f"input_names=[{_words(pass_on[1])}] to {to}"
        )
    if about.assumptions.design == "independent" and not runs.single:
        raise InputError(
            "`x` must be single pairs for design='independent', got runs of several steps, "
            "whose states contain earlier noise; use last_pairs()"
        )


def _listed(names: tuple[Sequence[str], Sequence[str]]) -> str:
    return f"states {_words(names[0])} and inputs {_words(names[1])}"


def _words(names: Sequence[str]) -> str:
    more = ["..."] if len(names) > LISTED else []
    return ", ".join([*(repr(name[:30]) for name in names[:LISTED]), *more])
