"""Tests of residuals and logs: exact relations, p-values by simulation, and named faults of logs.

The statistics are of the core (`rust/identify`, `rust/window/log_tests.rs`). A fault that a test
finds makes every certificate infinite, unless its name is in `accept` of `identify`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.records import Count, Record, trusted
from .._base.types import Floats, NDArray
from ..exceptions import InputError
from ..rng import as_key
from .assumptions import FAULTS, Assumptions


def tested_rows(assumed: Assumptions, known: Floats | None, n: int) -> list[int]:
    """The states that are not declared as exact, by `exact` or as rows of a known A."""
    rows = [i for i in range(n) if i not in assumed.exact]
    return [i for i in rows if known is None or np.isnan(known[i, :n]).any()]


def exact_relations(
    f: _core.Fitted, tested: list[int], names: Sequence[str], states: bool = True
) -> tuple[str, ...]:
    """What is said of residuals that are 0, or tied to each other, where pairs are left to see it.

    The columns after "declare" leave others that are independent; readings are no exact states.
    """
    spanned = f.span(tested)
    if f.nu <= len(f.S) or not any(spanned):
        return ()
    said = []
    zero, tied, last = ([names[i] for i in some] for some in spanned)
    if zero:
        said.append(
            f"{show.listed(zero)} {'have' if len(zero) > 1 else 'has'} no residual: computed from "
            "the other columns, or without noise. If that is how the plant is, declare "
            f"Noise(exact={_short(zero)})"
        )
    if tied:
        said.append(
            f"the residuals of {show.listed(tied)} are tied exactly: a column was computed "
            "from others, as a finite difference or a filter; then leave it out"
            + states
            * ", and pass the others as outputs=. If all are exact states, and the noise "
            f"has fewer sources than states, declare Noise(exact={_short(last)})"
        )
    return tuple(said)


def _short(names: list[str]) -> str:
    return repr(names) if len(names) <= 4 else f"[{', '.join(map(repr, names[:3]))}, ...]"


NAMES = ("correlation in time", "correlation at lag 1", "tails", "heteroscedasticity", "change")
HINTS = (
    "noise that lasts, states measured with error, or a window of readings that is too short",
    "states measured with error, noise that lasts, or a window of readings that is too short",
    "noise that is not Gaussian; alone it does little harm",
    "noise that grows with the states or inputs: regions are too small",
    "a system or a noise that changed between the halves of the data",
)
DRAWS = 499
LEVEL = 0.01  # of a warning, over all tests together
WORK = 1.6e8  # normal variates that `identify` draws at most, about three seconds of one core
KEY = as_key(20_020_101).child("residual tests")  # fixed, so that p-values repeat


class Checks(Record):
    """Tests of the residuals of a model, each with its p-value.

    Attributes
    ----------
    p_values : dict of str to float
        "correlation in time" (lags 1 to 5), "correlation at lag 1", "tails" (Mardia's kurtosis),
        "heteroscedasticity" (squared residuals against leverages), "change" (the two halves of
        the data). Small where an assumption fails.
    distances : dict of str to float
        How far each statistic is from the mean of the simulated ones, in their standard deviations:
        what tells p-values at their least apart.
    draws : int
        The number of simulated data sets; no p-value is below ``1 / (draws + 1)``.
    exact : bool
        Whether the p-values are exact under Gaussian noise; False for runs, where they are
        approximate.
    """

    p_values: dict[str, float]
    distances: dict[str, float]
    draws: Count
    exact: bool

    def _check(self) -> None:
        for name in NAMES:
            validation.positive(name, self.p_values.get(name), maximum=1.0)
            if not np.isfinite(self.distances.get(name, np.nan)):
                raise InputError(f"`distances` must have a number for {name}")

    def failed(self, level: float = LEVEL) -> tuple[str, ...]:
        """Name the tests that reject.

        Parameters
        ----------
        level : float, default 0.01
            Probability of any false alarm: each of the five tests has a fifth of it.

        Returns
        -------
        tuple of str
            Their names; empty if no assumption is seen to fail, which proves none of them.

        Raises
        ------
        InputError, InputTypeError
            If `level` is not a number between 0 and 1.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> z = np.random.default_rng(1).standard_normal((40, 3))
        >>> data = se.Trajectories.from_pairs(z[:, :1], z[:, 1:2], z[:, :1] + z[:, 2:])
        >>> se.identify(data).checks.failed()
        ()
        """
        share = validation.probability("level", level) / len(NAMES)
        return tuple(name for name in NAMES if self.p_values[name] <= share * (1.0 + 1e-9))

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence for each test that rejects at the default level."""
        return tuple(
            f"{name} in the residuals ({self._said(name)}): {HINTS[NAMES.index(name)]}"
            for name in self.failed()
        )

    def _said(self, name: str) -> str:
        """The p-value; where none is smaller, how far off the statistic is."""
        p = self.p_values[name]
        if p > 1.0 / (self.draws + 1) * (1.0 + 1e-9):
            return f"p = {p:.2g}"
        away = f"{show.two(self.distances[name])} standard deviations off"
        return f"p <= {p:.2g}, beyond all {self.draws} simulated, {away}"

    def __repr__(self) -> str:
        name = min(NAMES, key=lambda one: (self.p_values[one], -self.distances[one]))
        kind = "exact" if self.exact else "approximate"
        return f"<Checks: smallest of 5 {kind} p-values: {name}, {self._said(name)}>"

    def _repr_html_(self) -> str:
        return show.card(self, [(name, self._said(name)) for name in NAMES])


def checks_of(found: tuple[Floats, Floats] | None, draws: int, design: str) -> Checks | None:
    """The record of the tests of the core."""
    if found is None:
        return None
    p_values, distances = (dict(zip(NAMES, one.tolist(), strict=True)) for one in found)
    return trusted(Checks, p_values, distances, draws, design == "independent")


def too_many(pairs: int, n: int) -> bool:
    """Whether the residuals of so many pairs are tested only where that is asked for."""
    return pairs * n * DRAWS > WORK


FAULT = 5e-4  # level of each test of a log: together below 0.01
# Of which law each test asks more than a mean of 0.
OF_GAUSSIAN = ("outliers", "variance", "noise shape")
OF_ROWS = ("spikes", "outliers")  # their places are pairs
OF_MISFIT = ("nonlinear", "outliers", "noise size", "variance")  # a declared term shows so, too
TEXTS = {
    "equal rows": "{count} pairs are equal to others to the last digit: pass them once",
    "spikes": "readings jump there and back, or cells are far from all others, at {rows}: cut "
    "these rows, or pass nan in their place (of a CSV file: empty the cell)",
    "wrap": "{state} jumps by {jump}, and else by less than half of it: it wraps; unwrap it",
    "outliers": "what follows {rows} is no Gaussian noise, and moves the model by more than it: "
    "cut them, or pass them as missing (nan)",
    "clipped": "residuals depend on whether a reading is at its largest or least value{most}: the "
    "end of the range of a sensor; cut these rows",
    "late rows": "inputs of the next row explain {share}, more than by a feedback: rows hold "
    "the state after their action; read them with delay=-1",
    "dead time": "inputs {steps} earlier explain {share}: a dead time; "
    "pass Window(delay={lag}){or_longer}",
    "reach": "inputs {steps} earlier explain {share}: the window is too short; pass {longer}",
    "delay": "inputs {steps} earlier explain {share}: the delay is shorter, Window(delay={lag})",
    "offset": "a constant explains {share}, as of a force that always acts, or of an operating "
    "point other than 0: pass intercept=True",
    "ends": "the last pairs of the runs have a model of their own: runs that ended for what was "
    "read; use all pairs, or fix the lengths beforehand",
    "starts": "starts follow from the noise of the run before: pieces of one log are no independent"
    " runs; use all pairs, without `pilot`",
    "memory": "one step earlier, states and inputs explain {share}{most}: a state that is missing, "
    "or read with error, smoothed, differenced, or noise lasts: pass what was read as outputs=",
    "short": "a window of {next} explains {percent} % more: certificates assume that {own} "
    "suffice; {take}more {what}, {faster}or declare Window(tail=)",
    "nonlinear": "squares, products, cubes or signs of {signals} explain {share}: the plant is "
    "not linear there (dead zone, saturation, friction); use a smaller range{slow}",
    "change": "{part}: use what belongs together{slow}",
    "drift": "the model changes over each run ({share} explained), as of what warms up or wears: "
    "use a part of the runs, or measure more states{slow}",
    "noise size": "residuals {of}are {two} times as large as the declared {law}: declare what it "
    "is, or leave `sigma` or `covariance` out",
    "noise shape": "residuals are of no '{covariance}' covariance: leave it out",
    "variance": "the size of the residuals depends on states, inputs, time or run: one covariance "
    "is assumed; {dead}declare Noise('sub-gaussian', sigma=) with the largest sigma",
}


class Tested(NamedTuple):
    """The p-value of a test, what it is of, and the share of the variance that is explained."""

    p_value: float
    share: float
    at: NDArray[np.int64]
    each: Floats


def by_name(found: Iterable[Any]) -> dict[str, Tested]:
    """The tests of the core by their names."""
    return {name: Tested(*test) for name, *test in found}


def noise_doubts(model: Any, tested: list[int]) -> tuple[str, ...]:
    """Sentences on noise that is not as declared, at any of a hundred looks."""
    assumed = model.assumptions
    found = by_name(_core.noise_tests(model.blocks[0], tested, assumed.declared))
    names = [name for name in failed(found, assumed, 100.0) if name not in assumed.accept]
    return tuple(sentence(name, found[name], model) for name in names)


def failed(found: dict[str, Tested], assumed: Assumptions, looks: float = 1.0) -> list[str]:
    """The names of the tests that fail, in the order in which they are named."""
    small = {name for name, test in found.items() if test.p_value <= FAULT / looks}
    if assumed.noise != "gaussian":
        small.difference_update(OF_GAUSSIAN)
    small -= {name for name in small if _in_tail(name, found[name], assumed.tail)}
    names = [name for name in FAULTS if name in small]
    both = {"dead time", "memory"} <= small
    if both and found["dead time"].share < 0.7 * found["memory"].share:
        names.remove("dead time")
        names.insert(names.index("memory") + 1, "dead time")
    return names


def _in_tail(name: str, test: Tested, tail: float) -> bool:
    """Whether a declared tail may explain as much, in deviations of the noise."""
    most = np.sqrt(-np.log1p(-min(test.share, 0.999)))
    return tail > 0.0 and name in ("memory", "dead time") and bool(most <= 1.5 * tail)


def _dead(data: Any) -> str:
    """Which runs never change, as of a rig that was off, in words."""
    runs = data.layout.runs()
    begins = np.flatnonzero(np.diff(runs, prepend=-1))
    least, most = (one.reduceat(data.rows, begins) for one in (np.minimum, np.maximum))
    places = runs[begins[(least == most).all(axis=1)]].tolist()
    if not places:
        return ""
    named = show.listed([f"data[{place}]" for place in places])
    return f"{named} never {'change' if len(places) > 1 else 'changes'}: leave such runs out; or "


def _places(data: Any, pairs: list[int], odd: bool, columns: Floats) -> str:
    """Where pairs stand in the log: the time since the first row, the run, and the odd cell."""
    data = data if data.whole is None else data.whole  # of last pairs the pairs of all runs
    runs, skipped, read = data.layout.runs(), data.layout.skipped(), data.rows[:, : data.n]
    names, cells = (*data.state_names, *data.input_names), data.rows[:, : data.n + data.m]
    away = np.abs(read - np.median(read, axis=0)) / np.where(np.ptp(read, axis=0), read.std(0), 1.0)
    found = []
    for k, pair in enumerate(pairs[:5]):
        begin = int(np.searchsorted(runs, runs[pair]))
        lost = int(skipped[begin : pair + 1].sum())  # rows off the grid count as lost steps
        step, most = pair - begin + lost, int(columns[k] if len(columns) else away[pair].argmax())
        when = f"step {step}" if data.dt is None else f"{step * data.dt:.6g} s"
        value = f" ({names[most]} = {cells[pair, most]:.6g})" if odd else ""
        found.append(f"{'about ' if lost else ''}{when} of data[{runs[pair]}]{value}")
    return ", ".join(found) + (f" and {len(pairs) - 5} more" if len(pairs) > 5 else "")


def sentence(name: str, test: Tested, model: Any) -> str:
    """A failed test in words, with its cure."""
    names, window, at = model.outputs, model.window, test.at.tolist()
    first = at[0] if at else 0
    state = names[first] if at and first < len(names) else ""
    words = {"slow": ""} if window is None else window.words
    most = ""
    if name != "spikes" and len(test.each) and test.each.max() > 0.0:
        largest = np.flatnonzero(test.each >= 0.5 * test.each.max()).tolist()
        most = f" of {show.listed([names[i] for i in largest])}"
    part = "the halves of the data have models of their own"
    if at:
        which = f"the run data[{first}]" if len(at) == 1 else f"part {first + 1} of {at[1]}"
        part = f"{which} has a model of its own"
    key, read = name, window is not None and model.data.outputs
    if window is not None and name == "memory":
        key = "short"
    elif window is not None and name == "dead time" and first < window.delay:
        key = "delay"
    elif read and name == "dead time" and not model.core.later:
        key = "reach"
    delay = f", delay={window.delay}" if window is not None and window.delay else ""
    longer = f"Window(lags={first + 1 - (window.delay if window else 0)}{delay})"
    text = TEXTS[key].format(
        share=f"{show.two(100 * test.share)} % of the variance",
        percent=show.two(100 * test.share),
        most=most,
        rows="" if name not in OF_ROWS else _places(model.data, at, name == "spikes", test.each),
        count=len(at),
        state=state,
        jump=f"{test.share:.4g}",
        lag=first,
        steps=show.number_of(first),
        longer=longer,
        or_longer=f", or a longer window: {longer}" if read else "",
        signals=show.listed([model.regressors.regressor_names[i] for i in at])
        if name == "nonlinear"
        else "",
        part=part,
        dead=_dead(model.data) if name == "variance" else "",
        of=f"of {state} " if state else "",
        two=show.two(test.share),
        law="noise" if model.assumptions.noise == "gaussian" else "bound of the noise",
        covariance=model.assumptions.covariance,
        **words,
    )
    if name in OF_MISFIT and getattr(model, "misfit", None) is not None:
        text += "; or it is the declared Misfit: if that covers all of it, accept it by name"
    return f"{text} (p = {test.p_value:.1g}; or accept={name!r})"


# ratio of singular values, about sqrt(EPS), below which a decision on the rank is delicate: the
# directions that the data do not determine are then known to fewer than half of the digits
TRUSTED = 1e-8


def missing_directions(found: Sequence[_core.Fitted], names: Sequence[str]) -> tuple[str, ...]:
    """The directions that the data do not determine in any block, ``x[1] - 0.5 u[0]``."""
    said: dict[str, None] = {}
    for block in found:
        own = [names[j] for j in block.columns]
        said |= dict.fromkeys(_combination(row, own) for row in block.combinations())
    return tuple(said)


def _combination(row: Floats, names: Sequence[str]) -> str:
    text = ""
    for value, name in zip(row, names, strict=True):
        if value == 0.0:
            continue
        number = "" if abs(abs(value) - 1.0) < 5e-4 else f"{abs(value):.3g} "
        sign = ("-" if value < 0.0 else "") if not text else (" - " if value < 0.0 else " + ")
        text += f"{sign}{number}{name}"
    return text


def cautions(found: Sequence[_core.Fitted], missing: tuple[str, ...]) -> list[str]:
    """What to be careful about in the fits of the rows of a model."""
    said = []
    if missing:
        said.append(f"the data do not determine the model along {'; '.join(missing)}")
    ratio = min((one.ratio for one in found if one.rank), default=1.0)
    if ratio < TRUSTED:
        said.append(
            f"the states and inputs are nearly dependent (ratio {ratio:.1e}): bounds are large"
        )
    return said


def warn_of(warnings: Sequence[str], where: str) -> None:
    """Warn of the first, and say how many there are more."""
    if warnings:
        more = len(warnings) - 1
        rest = f"; {show.number_of(more, 'more warning')}: see {where}" if more else ""
        running.warn(warnings[0] + rest)
