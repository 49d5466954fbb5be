"""`Changes`: what new pairs say against the region of a model, and what a model never saw."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.records import Count, FromZero, Index, Probability, SavedRecord, trusted
from .._base.running import get_num_threads
from .._base.types import Floats
from ..data import Trajectories
from ..exceptions import InputError
from .assumptions import Design, NoiseLaw
from .identified import Identified
from .region import Region, entered
from .window import Loop, Regressors, of_names, rows_of

ChangeStatus: TypeAlias = Literal["refuted", "not refuted", "too few pairs"]
LITTLE = "little excited, the sign of its effect is not determined"
SHARE = 0.01  # of the probability, for a bound of a covariance that the region does not have


class Predictor(SavedRecord):
    """What an alarm needs of a model: its region in terms of its regressors, and the noise.

    Attributes
    ----------
    region : Region
        Of the coefficients of the regressors.
    noise : ndarray, shape (n_outputs, n_outputs), or None
        A bound of the covariance of the noise, or its proxy; None where none is known.
    window : Regressors
        What the model predicts from; one lag of the states where all are measured.
    law : {"gaussian", "sub-gaussian", "bounded"}
        The law of the noise that was declared.
    pairs : int
        How many pairs the region is from.
    bias : ndarray, shape (n_outputs, n_outputs), or None
        The gain of a bias that the loop learns, which is then a part of its states.
    spent : float
        The probability that `noise` is no bound, beside that of the region.
    """

    region: Region
    noise: Annotated[Floats, "output output"] | None
    window: Regressors
    law: NoiseLaw
    pairs: Count
    bias: Annotated[Floats, "output output"] | None = None
    spent: float = 0.0

    @property
    def groups(self) -> dict[str, list[int]]:
        """The columns of each signal by its name."""
        own, found = self.window, {}
        p, m, past = len(own.outputs), len(own.inputs), own.count * len(own.outputs)
        for i, name in enumerate(own.outputs):
            found[name] = list(range(i, past, p))
        for j, name in enumerate(own.inputs):
            found[name] = list(range(past + j, past + own.count * m, m))
        return {**found, "1": [own.length - 1]} if own.intercept else found

    @property
    def sizes(self) -> Floats:
        """The rms of each regressor in the data of the region; nan where no one part says so."""
        part, found = self.region.parts[0], np.full(self.window.length, np.nan)
        found[part.columns] = np.linalg.norm(part.root, axis=0) / np.sqrt(self.pairs)
        return found

    def watch(
        self, law: str = "variance", moving: bool = False, promise: float = 1e5
    ) -> _core.Watch:
        """The alarm of the core; refuses a source without noise, or without a bounded region."""
        if self.noise is None:
            raise InputError(
                "`accepts` and `watch` need a model with a bound of the noise: declare `sigma` or "
                "`covariance`, no `tail`"
            )
        if not np.isfinite(self.region.radius):
            raise InputError(
                "`accepts` and `watch` need a model of which something is certain, got one with "
                f"{self.region.assumption}"
            )
        about = np.ascontiguousarray(self.noise), self.window.core, (law, moving), promise
        return _core.Watch(self.region.core, *about, self.pairs)

    def changes(self, watch: _core.Watch, level: float, exact: Any = (None, None)) -> Changes:
        """What the pairs after an alarm say."""
        found = watch.look(level, list(self.groups.values()))
        (estimate, *radii), violations, gains, (white, root, factor) = found
        estimate = np.where(np.isnan(estimate), self.region.centre, estimate)
        gains[0] = np.where(np.isnan(gains[0]), 1.0, gains[0])
        (n, d), region, k = estimate.shape, None, 1 + len(self.groups)
        if np.isfinite(factor):
            all_of = np.arange(n), np.arange(d), white, root, np.zeros((d, 0)), 1.0
            part = _core.RegionPart(*all_of, np.ascontiguousarray(self.noise), factor)
            text = f"pairs after a stopping time, {self.law} noise within the same bound"
            about = self.region.m, level, text, (), (part,), 0, None, self.region.noise
            region = trusted(Region, validation.frozen(estimate.copy()), *about)
        tables = estimate, self.region.centre, *radii, violations[1:k], violations[k:], *gains
        frozen: Any = [validation.frozen(np.ascontiguousarray(one)) for one in tables]
        names = self.window.outputs, self.window.regressor_names, tuple(self.groups)
        numbers = level, self.region.delta + self.spent, int(watch.now[1]), float(violations[0])
        fields: Any = [*names, *numbers, *frozen, *exact, region]
        return Changes(*fields)

    def entered(self, region: Region) -> Region:
        """The same region in the states of the loop."""
        own = self.window.count, self.window.pole, self.window.delay
        if own == (1, None, 0) and self.bias is None:
            return region
        J, ABc, G = self._loop(region.centre)
        return entered(region, ABc, J, G, len(self.window.inputs))

    def recorder(self) -> tuple[Floats, Floats]:
        """N and G of ``c+ = N (c, v) + G y``, the states of a loop that reads y and asks for v."""
        known = self._loop(np.zeros_like(self.region.centre))
        (n, p), m, N = known.G.shape, len(self.window.inputs), known.ABc.copy()
        if self.bias is not None:  # learned from what the model predicts
            N[n - p :] -= self.bias @ self.region.centre @ known.J
        return np.ascontiguousarray(N[:, : n + m]), known.G

    def _loop(self, Theta: Floats) -> Loop:
        """The linear system of the window, and the bias behind its states."""
        J, ABc, G = self.window.loop(Theta)
        if self.bias is None:
            return Loop(J, ABc, G)
        n, p = G.shape
        J, ABc = (np.insert(M, [n] * p, 0.0, axis=1) for M in (J, ABc))
        below = np.zeros((p, ABc.shape[1]))
        below[:, n : n + p] = np.eye(p) - self.bias
        return Loop(np.ascontiguousarray(J), np.vstack([ABc, below]), np.vstack([G, self.bias]))


def source_of(
    model: Identified, region: Region, bias: Floats | None = None, share: float = SHARE
) -> Predictor:
    """What an alarm needs, for a region of the coefficients of a model."""
    own: Any = getattr(model, "least_squares", model)
    given, noise, spent = own.assumptions, region.noise, 0.0
    noise = given.known if noise is None else noise
    if noise is None and given.design == "independent" and len(own.blocks) == 1:
        nu, S = own.blocks[0].nu, own.blocks[0].S
        if nu >= len(S):  # S >= a Sigma but with this probability
            noise = S / _core.smallest_quantile(len(S), nu, share, get_num_threads())
            spent = share
    if given.tail:  # what the window leaves is no noise given the past
        noise = None
    window = model.window or of_names(model.outputs, model.input_names, model.c is not None)
    kept = None if noise is None else validation.frozen(np.array(noise))
    frozen = None if bias is None else validation.frozen(bias.copy())
    return Predictor(region, kept, window, given.noise, max(1, own.size), frozen, spent)


class Changes(SavedRecord):
    """What new pairs say against a region: what changed, by how much, and what they cannot say.

    Made by `Model.accepts` and `Watch.changes`. All statements hold together with probability
    ``1 - level - delta`` for Gaussian or sub-Gaussian noise, for any feedback, however often it is
    looked; `estimate` within `radius` does not need the region.

    Attributes
    ----------
    outputs, regressors, signals : tuple of str
        The rows and columns of the tables, and the signals that the columns belong to.
    level, delta : float
        The probability of error of the new pairs, and that of the region.
    pairs : int
        How many new pairs there were.
    outside : float
        The largest violation of the region that was found; above 1 it is proved that the plant is
        outside.
    estimate, centre : ndarray, shape (row, column)
        The coefficients of the new pairs, and the old ones, which stand where these are not known.
    radius, allowed : ndarray, shape (row, column)
        `estimate` is within `radius` of the plant; a plant of the region differs by `allowed`.
    by_others, by_other_rows : ndarray, shapes (signal,) and (row,)
        The largest violation without the columns of a signal, and without a row: above 1 it is
        proved that this signal, or row, alone does not explain the change.
    gain, gain_radius, gain_allowed : ndarray, shape (column,)
        What the effect of each column is now, in parts of the old one, and how far that is off.
    statistic, limit : float or None
        Of the exact test of two logs in open loop, which then decides.
    region : Region or None
        The plants that the new pairs alone allow; None while they do not determine all of them.
    """

    outputs: tuple[str, ...]
    regressors: tuple[str, ...]
    signals: tuple[str, ...]
    level: Probability
    delta: Probability
    pairs: Index
    outside: FromZero
    estimate: Annotated[Floats, "row column", "infinite"]
    centre: Annotated[Floats, "row column"]
    radius: Annotated[Floats, "row column", "infinite"]
    allowed: Annotated[Floats, "row column", "infinite"]
    by_others: Annotated[Floats, "signal", "infinite"]
    by_other_rows: Annotated[Floats, "row", "infinite"]
    gain: Annotated[Floats, "column", "infinite"]
    gain_radius: Annotated[Floats, "column", "infinite"]
    gain_allowed: Annotated[Floats, "column", "infinite"]
    statistic: float | None = None
    limit: float | None = None
    region: Region | None = None

    @property
    def status(self) -> ChangeStatus:
        """Whether the model is refuted, which is proved; else see `detectable`."""
        if self.statistic is not None and self.limit is not None:
            return "refuted" if self.statistic > self.limit else "not refuted"
        if self.outside > 1.0:
            return "refuted"
        return "not refuted" if np.isfinite(self.radius).any() else "too few pairs"

    @property
    def explanations(self) -> tuple[str, ...]:
        """What alone may have changed: signals, and rows as ``name(k+1)``; () if nothing did.

        The true one is among them if it is one of these.
        """
        if self.status != "refuted":
            return ()
        # where only the exact test refutes, no bound excludes any of them
        named = [*self.signals, *(f"{name}(k+1)" for name in self.outputs)]
        values = [*self.by_others, *self.by_other_rows]
        return tuple(name for name, value in zip(named, values, strict=True) if value <= 1.0)

    @property
    def entries(self) -> dict[tuple[str, str], tuple[float, float]]:
        """The coefficients (row, column) that certainly changed, and between what they are now."""
        with np.errstate(invalid="ignore"):
            off = np.abs(self.estimate - self.centre) > self.radius + self.allowed
        found = {}
        for i, j in np.argwhere(off).tolist():
            now, size = float(self.estimate[i, j]), float(self.radius[i, j])
            found[self.outputs[i], self.regressors[j]] = (now - size, now + size)
        return found

    @property
    def detectable(self) -> dict[str, float]:
        """The relative change of each effect that is found with ``1 - level - delta``.

        Twice both radii; infinite where the pairs cannot see it.
        """
        with np.errstate(invalid="ignore"):
            sizes = (2.0 * (self.gain_radius + self.gain_allowed)).tolist()
        return dict(zip(self.regressors, sizes, strict=True))

    @property
    def unseen(self) -> tuple[str, ...]:
        """What the new pairs do not say, one sentence each, by the names of the columns."""
        found, size = [], np.abs(self.estimate)
        for j, name in enumerate(self.regressors):
            if not np.isfinite(self.radius[:, j]).any():
                found.append(f"{name}: not excited, its effect cannot be seen")
            elif (size[:, j] <= self.radius[:, j]).all():
                found.append(f"{name}: {LITTLE}")
        return tuple(found)

    def __repr__(self) -> str:
        pairs = show.number_of(self.pairs, "pair")
        parts = [f"{self.status}, {pairs}" if "few" in self.status else f"{self.status} by {pairs}"]
        if self.outside > 1.0:
            names = ("a constant" if name == "1" else name for name in self.explanations)
            alone = ", ".join(names) or "no single signal or row"
            parts.append(f"a change of one alone: {alone}")
        seen = {name: v for name, v in self.detectable.items() if np.isfinite(v)}
        if self.status == "not refuted" and seen:
            name = min(seen, key=lambda name: seen[name])
            shows = f"a change of {name} by {seen[name]:.0%} would have shown"
            nothing = "these pairs tell nothing of single effects: none that died would have shown"
            parts.append(shows if seen[name] <= 1.0 else nothing)
        return f"<Changes: {'; '.join(parts)}{show.careful(self.unseen)}>"


def accepted(model: Any, runs: Trajectories, level: float, design: Design) -> Changes:
    """What `Model.accepts` returns."""
    alpha = validation.probability("level", level) / 2.0
    source = source_of(model, model.region(alpha), share=alpha / 2.0)
    alpha -= source.spent
    names, found = (runs.state_names, runs.input_names), source.window
    if names != (found.outputs, found.inputs):
        raise InputError(
            f"`runs` must have the names {found.outputs + found.inputs}, got {sum(names, ())}"
        )
    rows = np.ascontiguousarray(rows_of(found, runs)[1])
    exact: tuple[float | None, float | None] = (None, None)
    if validation.choice("design", design, ("adaptive", "independent")) == "independent":
        if (model.design, model.noise, model.known) != ("independent", "gaussian", None):
            raise InputError(
                "`design` must be 'adaptive' but for a model with Noise(design='independent')"
            )
        threads = get_num_threads()
        other = _core.fit(_core.triangle(rows, threads), found.length, len(rows), threads)
        exact = _core.test_of_two_logs(model.blocks[0], other, level, threads)
    watch = source.watch()
    watch.take(rows)
    return source.changes(watch, alpha, exact)


def unexcited(model: Any) -> tuple[str, ...]:
    """What `Model.excitation` returns."""
    names, d = model.regressors.regressor_names, model.regressors.length
    Z, missing, region = model.rows[:, :d], model.core.plain.missing != 0.0, model.region()
    found, done = [], set()
    for j in np.flatnonzero(missing.any(axis=1)).tolist():
        group = {j}
        for _ in range(d):
            group |= set(np.flatnonzero((missing & missing[list(group)].any(axis=0)).any(axis=1)))
        if j not in done:
            own = sorted(int(k) for k in group)
            still = [k for k in own if names[k] != "1" and np.ptp(Z[:, k]) == 0.0]
            why = "; ".join(f"{names[k]} was always {Z[0, k]:.4g}" for k in still)
            who = show.listed(["the offset" if names[k] == "1" else names[k] for k in own])
            its, apart = ("its effect is", "") if len(own) == 1 else ("their effects are", " apart")
            found.append(f"{who}: {its} not determined{apart}{f' ({why})' if why else ''}")
        done |= group
    weak = (np.abs(region.centre) <= region.entry_bounds).all(axis=0)
    also = [names[j] for j in np.flatnonzero(weak).tolist() if j not in done]
    return (*found, *(f"{name}: {LITTLE}" for name in also))
