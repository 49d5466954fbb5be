"""Faults of logs that the residuals of a model show: each test with its name, words and cure.

The statistics are of the core (`rust/identify/battery`); a test that fails makes every certificate
infinite, unless its name is in `accept` of `identify`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .. import _core
from .._base import show
from .._base.running import get_num_threads
from .assumptions import FAULTS
from .checks import spanned
from .window import FAR

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._base.types import Floats
    from ..data import Trajectories
    from .assumptions import Assumptions
    from .checks import Range

LEVEL = 5e-4  # of each test: together below 0.01
FEW = 5  # runs that end beyond one limit, from which it ended them
CLEAR = 100.0  # times what rounding may change: residuals that are noise
LARGE = 0.2  # share that late inputs explain at least, and that a good window leaves at most
NO_EFFECT = 1e-3  # p-value from which an input has no effect that is seen
# Of which law each test asks more than a mean of 0.
OF_GAUSSIAN = ("outliers", "variance", "noise shape")


TEXTS = {
    "equal rows": "{count} pairs are equal to others to the last digit: data that count twice; "
    "pass them once",
    "spikes": "readings jump there and back, at pairs {rows}: cut them, or pass them as missing "
    "(nan)",
    "wrap": "{state} jumps by {jump}, and else by less than half of it: it wraps; unwrap it",
    "outliers": "pairs {rows} are no Gaussian noise, and move the model by more than noise does: "
    "cut them, or pass them as missing (nan)",
    "clipped": "residuals depend on whether a reading is at its largest or least value{most}: the "
    "end of the range of a sensor; cut these rows",
    "late rows": "inputs of the next row explain {share}, more than by a feedback: rows hold "
    "the state after their action; read them with delay=-1",
    "dead time": "inputs {steps} earlier explain {share}: a dead time; "
    "pass Window(delay={lag}){longer}",
    "delay": "inputs {steps} earlier explain {share}: the delay is shorter; "
    "pass Window(delay={lag})",
    "offset": "a constant explains {share}, as of a force that always acts, or of an operating "
    "point other than 0: pass intercept=True",
    "ends": "the last pairs of the runs have a model of their own: runs that ended for what was "
    "read; use all pairs, or fix the lengths beforehand",
    "starts": "starts follow from the noise of the run before: pieces of one log are no independent"
    " runs; use all pairs, without `pilot`",
    "memory": "one step earlier, states and inputs explain {share}{most}: a state that is missing, "
    "or read with error, smoothed or differenced, or noise that lasts: pass what was read"
    " as outputs=",
    "nonlinear": "squares, products, cubes or signs of {signals} explain {share}: the plant is "
    "not linear there (dead zone, saturation, friction); use a smaller range",
    "change": "{part}: use what belongs together",
    "drift": "the model changes over each run ({share} explained), as of what warms up or wears: "
    "use a part of the runs, or measure more states",
    "variance": "the size of the residuals depends on states, inputs, time or run: one covariance "
    "is assumed; declare Noise('sub-gaussian', sigma=) with the largest sigma",
}


class Tested(NamedTuple):
    """The p-value of a test, what it is of, and the share of the variance that is explained."""

    p_value: float
    share: float
    at: NDArray[np.int64]
    each: Floats


NONE = Tested(1.0, 0.0, np.zeros(0, dtype=np.int64), np.zeros(0))  # of a test that is not made


def tested(model: Any) -> dict[str, Tested]:
    """The tests that the pairs of a model allow, of each name the one with the smallest p-value."""
    f, span = _above_rounding(*model._residuals)
    data, n, window = model.data, model.n_outputs, model.window
    rows = np.hstack(model._pairs())
    raw, at, beyond, extra = data, np.arange(data.size), (1, 1, 0), None
    if window is not None:
        at, beyond, extra = window._beyond(data, model.first)
    elif data._whole is not None:
        raw = data._whole
        at = np.cumsum(raw.lengths) - 1
    pieces, runs = raw._pieces.places(), raw._pieces.runs()
    basis = np.zeros((n, span.basis.shape[1]))
    basis[span.rows] = span.basis
    of = n if window is None else window.count * n, model.intercept
    given = rows, f, basis, raw._rows, at, pieces, runs[at], of, beyond, extra
    found = _smallest(_core.battery(*given, None))
    found |= _smallest(noise_tested(f, model.assumptions, span.rows))
    if "spikes" in found:
        found |= _wraps(raw, found["spikes"])
    late = found.pop("late rows", NONE)
    if late.p_value <= LEVEL:
        if window is None and _no_effect(found):
            found["late rows"] = _late(model, late)
        elif window is not None and late.share > LARGE and _follow(raw, at, rows):
            found["late rows"] = late
    if data._whole is not None:
        found |= _before_last(model, raw, found)
    if model.pilot is not None or data._whole is not None:
        found |= _starts(raw, model)
    return found


def _above_rounding(f: _core.Fitted, span: Range) -> tuple[_core.Fitted, Range]:
    """What the residuals of rows span that are far above rounding, which is no noise of one law."""
    rows = _noisy(f, span.rows)
    return f, span if len(rows) == len(span.rows) else spanned(f, rows)


def _noisy(f: _core.Fitted, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """The rows of which residuals are far above rounding."""
    return rows[np.sqrt(np.diag(f.S))[rows] > CLEAR * f.rounding[rows]]


def noise_tested(
    f: _core.Fitted, assumed: Assumptions, rows: NDArray[np.int64]
) -> list[tuple[str, float, float, NDArray[np.int64], Floats]]:
    """The tests of what was declared of the noise, of the sum of squares of some rows."""
    word = assumed.covariance
    if not len(rows) or word == "full":
        return []
    known = None
    if assumed.known is not None:
        word, known = assumed.noise, np.ascontiguousarray(assumed.known[np.ix_(rows, rows)])  # type: ignore[assignment]
    S = np.ascontiguousarray(f.S[np.ix_(rows, rows)])
    found = _core.noise_tests(S, f.N, f.nu, word, known)
    return [(name, p, share, rows[at], each) for name, p, share, at, each in found]


def noise_doubts(f: _core.Fitted, assumed: Assumptions, rows: NDArray[np.int64]) -> tuple[str, ...]:
    """Sentences on noise that is not as declared, at any of a hundred looks."""
    found = _smallest(noise_tested(f, assumed, _noisy(f, rows)))
    names = [name for name in failed(found, assumed, 100.0) if name not in assumed.accept]
    return tuple(_of_noise(name, found[name], assumed, "") for name in names)


def _of_noise(name: str, test: Tested, assumed: Assumptions, state: str) -> str:
    if name == "noise size":
        of = f"of {state} " if state else ""
        what = "noise" if assumed.noise == "gaussian" else "bound of the noise"
        text = (
            f"residuals {of}are {show.two(test.share)} times as large as the declared {what}: "
            "declare what it is, or leave `sigma` or `covariance` out"
        )
    else:
        text = (
            f"the residuals are not of a '{assumed.covariance}' covariance "
            f"(p = {test.p_value:.1g}): leave `covariance` out"
        )
    return f"{text} (or accept={name!r})"


def failed(found: dict[str, Tested], assumed: Assumptions, looks: float = 1.0) -> list[str]:
    """The names of the tests that fail, in the order in which they are named."""
    gaussian = assumed.noise == "gaussian"
    names = [
        name
        for name in FAULTS
        if name in found
        and found[name].p_value <= LEVEL / looks
        and (gaussian or name not in OF_GAUSSIAN)
        and not _in_tail(name, found[name], assumed.tail)
    ]
    if {"dead time", "memory"} <= set(names) and found["dead time"].share < 0.7 * found[
        "memory"
    ].share:
        names.remove("dead time")
        names.insert(names.index("memory") + 1, "dead time")
    return names


def sentence(name: str, test: Tested, model: Any) -> str:
    """A failed test in words, with its cure."""
    names, window = model.outputs, model.window
    first = int(test.at[0]) if len(test.at) else 0
    state = names[first] if len(test.at) and first < len(names) else ""
    if name in ("noise size", "noise shape"):
        return _of_noise(name, test, model.assumptions, state)
    signals = ""
    if name == "nonlinear":
        signals = show.listed([model._regressors[i] for i in test.at.tolist()])
    values = {
        "share": f"{show.two(100 * test.share)} % of the variance",
        "most": _of(test, names),
        "rows": _listed(test.at),
        "count": str(len(test.at)),
        "state": state,
        "jump": f"{test.share:.4g}",
        "lag": str(first),
        "steps": show.number_of(first, "step"),
        "longer": f", or a longer window: Window(lags={first + 1})" if window is not None else "",
        "signals": signals,
        "part": _part(test) if name == "change" else "",
    }
    if name == "memory" and window is not None:
        text = window._short(test.share)
    else:
        early = name == "dead time" and window is not None and first < window.delay
        text = TEXTS["delay" if early else name].format(**values)
    return f"{text} (p = {test.p_value:.1g}; or accept={name!r})"


def _part(test: Tested) -> str:
    """Which part of the data has a model of its own."""
    if not len(test.at):
        return "the halves of the data have models of their own"
    at = test.at.tolist()
    which = f"run {at[0]}" if len(at) == 1 else f"part {at[0] + 1} of {at[1]}"
    return f"{which} has a model of its own"


def accepted_text(assumed: Assumptions) -> str:
    """What stands behind the assumption of a region where failed tests were accepted."""
    return f"; accepted by name: {', '.join(assumed.accept)}" if assumed.accept else ""


def _smallest(
    found: list[tuple[str, float, float, NDArray[np.int64], Floats]],
) -> dict[str, Tested]:
    kept: dict[str, Tested] = {}
    for name, p_value, share, at, each in found:
        one = Tested(p_value, share, at, each)
        key = f"effect {one.at[0]}" if name == "effect" else name
        if key not in kept or one.p_value < kept[key].p_value:
            kept[key] = one
    return kept


def _in_tail(name: str, test: Tested, tail: float) -> bool:
    """Whether a declared tail may explain as much, in deviations of the noise."""
    return (
        tail > 0.0
        and name in ("memory", "dead time")
        and np.sqrt(-np.log1p(-min(test.share, 0.999))) <= 1.5 * tail
    )


def _listed(at: NDArray[np.int64]) -> str:
    return ", ".join(map(str, at[:5].tolist())) + (
        f" and {len(at) - 5} more" if len(at) > 5 else ""
    )


def _of(test: Tested, names: Sequence[str]) -> str:
    """The states of which most is explained."""
    if not len(test.each) or not test.each.max() > 0.0:
        return ""
    most = np.flatnonzero(test.each >= 0.5 * test.each.max()).tolist()
    return f" of {show.listed([names[i] for i in most])}"


def _explained(z: Floats, y: Floats, extra: Floats) -> dict[str, Tested]:
    """What `extra` columns explain of y beside z, as the test "memory"."""
    size, p = y.shape
    rows = np.ascontiguousarray(np.hstack([z, y]))
    f = _core.fit(rows, z.shape[1], size, 1)
    live = np.diag(f.S) > (10.0 * f.rounding) ** 2
    if size <= z.shape[1] + p + extra.shape[1] or not live.all():
        return {}
    order = np.arange(size)
    given = (
        np.eye(p),
        np.zeros((size, 2 * p)),
        order,
        0 * order,
        order,
        (z.shape[1], False),
        (FAR, FAR, 0),
    )
    return _smallest(_core.battery(rows, f, *given, np.ascontiguousarray(extra), None))


def _wraps(raw: Trajectories, spikes: Tested) -> dict[str, Tested]:
    """The test "wrap" of jumps of one size, of which few are undone in the next step, as spikes."""
    x, _, y = raw.pairs()
    step = np.abs(y - x)
    jump = step.max(axis=0)
    large = step > 0.5 * jump
    alike = (jump > 0.5 * np.ptp(y, axis=0)) & (~large | (step > 0.8 * jump)).all(axis=0)
    at = np.flatnonzero(alike & (large.sum(axis=0) > 2.5 * len(spikes.at)))[:1]
    wrap = spikes._replace(at=at, share=jump[at].sum())
    return {"spikes": NONE, "wrap": wrap} if len(at) else {}


def _no_effect(found: dict[str, Tested]) -> bool:
    effects = [test.p_value for name, test in found.items() if name.startswith("effect")]
    return bool(effects) and min(effects) > NO_EFFECT


def _follow(raw: Trajectories, at: NDArray[np.int64], rows: Floats) -> bool:
    """Whether readings follow the inputs of the next row: these do not depend on the window.

    Those of a feedback do, as far as the window predicts the readings.
    """
    n = raw.n
    later = np.flatnonzero(np.append(raw._pieces.places()[1:], 0)[at])
    z, y, u = rows[later, :-n], rows[later, -n:], raw._rows[at[later] + 1, n:-n]
    one, none = np.ones((len(u), 1)), NONE._replace(p_value=0.0)
    window, inputs = (_explained(one, of, z).get("memory", none) for of in (y, u))
    return min(window.each, default=0.0) > 1.0 - LARGE and inputs.p_value > NO_EFFECT


def _late(model: Any, test: Tested) -> Tested:
    """The test of late rows, where inputs have no effect and the next ones explain.

    With u = K x + d of a feedback the next input explains too, through the next state; but then
    u(k) depends on x(k) alone, in rows that hold the state after their action on the one before.
    """
    data = model.data
    later = np.flatnonzero(data._pieces.places() > 0)
    x, u, _ = data.pairs()
    z = np.hstack([x[later], np.ones((len(later), 1))])
    found = _explained(z, u[later], np.hstack([x[later - 1], u[later - 1]])).get("memory")
    return test._replace(p_value=1.0 if found is None else max(found.p_value, test.p_value))


def _of_runs(model: Any, raw: Trajectories, marked: NDArray[np.int64] | None) -> dict[str, Tested]:
    """The tests of all pairs of these runs; of `marked` ones whether they have their own model."""
    x, u, y = raw.pairs()
    rows = np.hstack([x, u, np.ones((len(x), int(model.intercept))), y])
    f = _core.fit(rows, rows.shape[1] - raw.n, len(rows), get_num_threads())
    span = _above_rounding(f, spanned(f, model._residuals[1].rows))[1]
    basis = np.zeros((raw.n, span.basis.shape[1]))
    basis[span.rows] = span.basis
    at, places, runs = np.arange(len(rows)), raw._pieces.places(), raw._pieces.runs()
    of = raw.n, model.intercept
    found = _core.battery(rows, f, basis, raw._rows, at, places, runs, of, (1, 1, 0), None, marked)
    return _smallest(found)


def _before_last(model: Any, raw: Trajectories, found: dict[str, Tested]) -> dict[str, Tested]:
    """What the rows before the last pairs say: of dead time and hidden states, and of the ends."""
    whole = _of_runs(model, raw, None)
    kept = {}
    for name in ("memory", "dead time"):
        tests = [some[name] for some in (whole, found) if name in some]
        if tests:
            least = min(tests, key=lambda test: test.p_value)
            kept[name] = least._replace(p_value=min(1.0, 2.0 * least.p_value))
    if len(set(raw.lengths.tolist())) == 1:
        return kept
    last = np.zeros(raw.size, dtype=np.int64)
    last[np.cumsum(raw.lengths) - 1] = 1
    kept |= _of_runs(model, raw, last)
    if _switched(raw):
        kept["ends"] = NONE._replace(p_value=0.0, share=1.0)
    return kept


def _switched(raw: Trajectories) -> bool:
    """Whether one limit of a reading parts the ends of all runs but the longest from the rest.

    The first readings are left out: a start beyond the limit ends nothing.
    """
    y = raw.pairs()[2]
    ends = np.cumsum(raw.lengths) - 1
    short = raw.lengths < raw.lengths.max()
    if short.sum() < FEW:
        return False
    ended, x = y[ends[short]], np.delete(y, ends, axis=0)
    ways = [(ended, x), (-ended, -x), (np.abs(ended), np.abs(x))]
    return any(bool((a.min(axis=0) > b.max(axis=0)).any()) for a, b in ways)


def _starts(raw: Trajectories, model: Any) -> dict[str, Tested]:
    """Whether starts depend on the noise of the run before, as those of pieces of one log do.

    ``eta = sum A^(T-1-k) e(k)`` is the part of noise in the end of a run: beside a constant and the
    rest of that end, which may be by plan, it must not explain the next start.
    """
    starts = raw._pieces.starts()
    if len(starts) < 2 * raw.n + 6 or len(raw._pieces.gaps):
        return {}
    x, u, y = raw.pairs()
    z = np.hstack([x, u, np.ones((len(x), int(model.intercept)))])
    H = _core.fit(np.hstack([z, y]), z.shape[1], len(z), get_num_threads()).H
    e, A = y - z @ H.T, H[:, : raw.n]
    if not np.abs(np.linalg.eigvals(A)).max() < 1.5:
        return {}
    eta = np.zeros((len(starts), raw.n))
    for k in range(int(raw.lengths.max())):
        running = raw.lengths > k
        eta[running] = eta[running] @ A.T + e[starts[running] + k]
    ends = y[starts + raw.lengths - 1]
    begun = x[starts[1:]]
    moving = np.ptp(begun, axis=0) > 0.0
    if not moving.any() or not np.isfinite(eta).all():
        return {}
    given = np.hstack([np.ones((len(begun), 1)), (ends - eta)[:-1]])
    found = _explained(given, np.ascontiguousarray(begun[:, moving]), eta[:-1])
    return {"starts": found["memory"]} if "memory" in found else {}
