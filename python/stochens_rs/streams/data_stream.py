"""The sequential algorithm on realizations that come from elsewhere, with or without a target."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .. import _core
from .._base import gate, html, memory
from .._base.threads import interruptible
from ..ensembles.ensemble import Ensemble
from ..exceptions import InputError, InputTypeError, ShapeError
from .durable import Durable
from .records import Confidence, mean_radius

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats: TypeAlias = NDArray[np.float64]
    FeedLike: TypeAlias = ArrayLike | Ensemble | Iterable[ArrayLike]

_NAMES = ("x0", "xf", "A")
_BLOCK = 2**18  # entries that are handed over at a time


class DataStream(Durable):
    """The control from realizations that are handed in, one by one or in batches.

    Without a target an entity is averaged, with weights 1/N; nothing needs to be known, and
    `confidence` says how far the control can be off. With a target it is fused towards it by one
    exact line search per realization: ``t = clip(<T - F, E - F> / ||E - F||^2, 0, 1)``,
    ``F <- (1 - t) F + t E``. The control is ``v = B^+ (Ff - FA F0)`` at any time.

    Parameters
    ----------
    B : array_like, shape (n, m)
        Input matrix, known.
    x0, xf : array_like, shape (n,), optional
        Targets, such as a nominal model or a held-out estimate.
    A : array_like, shape (n, n), optional
        Target for the system matrix.
    ranges : mapping of str to float, optional
        For "x0", "xf", "A": a bound R on ``||E - E'||`` for any two realizations (2-norm;
        Frobenius for A). 0 says that all realizations are the same. `confidence` needs it for
        radii that hold for any number of realizations.
    sizes : mapping of str to int, optional
        For "x0", "xf", "A": the number of realizations, fixed before any is seen, at which
        `confidence` is to be tightest (about 0.65 of the radius without it). Its radii hold at
        all other numbers too, but far from this one they are wider.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.

    Notes
    -----
    Taking in a realization costs as much as reading it; `u` costs O(n^2 + n m). One by one or in
    batches gives the same numbers, bit for bit. Threads and signal handlers: as for `Stream`.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0, 0.0], [0.5, 1.0]])
    >>> stream = DataStream(B, ranges={"xf": 0.0})
    >>> stream.update(x0=se.sample([1.0, 2.0], 5000, rng=1), xf=[0.0, 0.0])
    >>> stream.update(A=se.sample(A, 5000, rng=2))
    >>> stream.counts
    {'x0': 5000, 'xf': 1, 'A': 5000}
    >>> bool(np.linalg.norm(B @ stream.u + A @ [1.0, 2.0]) < 0.1)
    True
    """

    _kind = "means"

    def __init__(
        self,
        B: ArrayLike,
        *,
        x0: ArrayLike | None = None,
        xf: ArrayLike | None = None,
        A: ArrayLike | None = None,
        ranges: Mapping[str, float] | None = None,
        sizes: Mapping[str, int] | None = None,
    ) -> None:
        inputs = gate.matrix("B", B)
        n, m = inputs.shape
        start = None if x0 is None else gate.vector("x0", x0, length=n)
        goal = None if xf is None else gate.vector("xf", xf, length=n)
        matrix = None if A is None else gate.matrix("A", A, rows=n, cols=n)
        self._ranges, self._sizes = _checked_ranges(ranges), _checked_sizes(sizes)
        memory.need("a stream", 48 * n * n + 40 * n * m)
        self._shape = (n, m)
        self._targets = tuple(value is not None for value in (start, goal, matrix))
        self._core = _core.DataStream(inputs, start, goal, matrix)

    def update(
        self,
        *,
        x0: FeedLike | None = None,
        xf: FeedLike | None = None,
        A: FeedLike | None = None,
    ) -> None:
        """Take in realizations.

        Parameters
        ----------
        x0, xf : array_like, Ensemble or iterable, optional
            One realization, shape (n,); a batch, shape (k, n); an Ensemble; or an iterator or
            generator of single realizations, which is read to its end.
        A : array_like, Ensemble or iterable, optional
            The same with (n, n) and (k, n, n).

        Raises
        ------
        InputError, InputTypeError
            If a realization cannot be used, or nothing is given. Arrays and ensembles are checked
            before anything is taken in; of an iterator, or if the distance of two realizations
            overflows, those before the faulty one have been taken in. `counts` says how many.
        KeyboardInterrupt
            On Ctrl-C, between two realizations.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> one, many = DataStream([[1.0]]), DataStream([[1.0]])
        >>> many.update(x0=[[1.0], [2.0], [4.0]], xf=[0.0], A=[[2.0]])
        >>> one.update(x0=([float(v)] for v in (1, 2, 4)), xf=[0.0], A=[[2.0]])
        >>> bool(one.u == many.u)
        True
        """
        given = [(k, v) for k, v in enumerate((x0, xf, A)) if v is not None]
        if not given:
            raise InputError("`x0`, `xf` or `A` must be given: there is nothing to take in")
        blocks = [(entity, self._blocks(_NAMES[entity], value)) for entity, value in given]
        for entity, rows in blocks:
            for block in rows:
                self._core.update(entity, block)

    def _blocks(self, name: str, value: Any) -> Iterable[Floats]:
        """The realizations as rows, some at a time; arrays and ensembles are checked at once."""
        n = self._shape[0]
        shape = (n, n) if name == "A" else (n,)
        entries = n ** len(shape)
        rows = max(1, _BLOCK // entries)
        if isinstance(value, Ensemble):
            if value.shape != shape:
                raise ShapeError(f"`{name}` must have shape {shape}, got {value.shape}")
            return (block.reshape(-1, entries) for block in value._dense_blocks(rows))
        if isinstance(value, Iterator):
            return _gathered(name, value, shape, rows)
        array = gate.array(name, value, ndim=(len(shape), len(shape) + 1))
        if array.shape[-len(shape) :] != shape:
            raise ShapeError(
                f"`{name}` must have shape {shape} or (k, {', '.join(map(str, shape))}), "
                f"got {array.shape}"
            )
        return [array.reshape(-1, entries)]

    @property
    def counts(self) -> dict[str, int]:
        """Realizations taken in so far, for "x0", "xf" and "A"."""
        return dict(zip(_NAMES, self._core.statistics()[0], strict=True))

    @property
    def u(self) -> Floats:
        """The control v, shape (m,); it needs a realization of each entity."""
        self._seen("u")
        return self._core.control()

    @property
    def estimates(self) -> dict[str, Floats]:
        """The estimates of "x0" (n,), "xf" (n,) and "A" (n, n) that have realizations."""
        found = zip(_NAMES, self._core.estimates(), strict=True)
        return {name: value for name, value in found if self.counts[name] > 0}

    @property
    def residuals(self) -> dict[str, float]:
        """``||F - target||`` of the entities that have a target and a realization."""
        found = dict(zip(_NAMES, self._core.statistics()[3], strict=True))
        known = dict(zip(_NAMES, self._targets, strict=True))
        return {k: v for k, v in found.items() if known[k] and self.counts[k] > 0}

    @property
    def certificate(self) -> float | None:
        """``||P [(Ff - xf) - A (F0 - x0)]|| + ||FA - A|| ||F0||`` with the targets.

        It bounds the error against the control that the targets give; None unless all three
        entities have one.
        """
        self._seen("certificate")
        found = self._core.certificate()
        return None if found is None else found[0]

    @property
    def error(self) -> float | None:
        """``||B (v - v*)||`` for the targets' control v*; None unless all three have one."""
        self._seen("error")
        found = self._core.certificate()
        return None if found is None else found[1]

    def confidence(self, delta: float = 0.05) -> Confidence:
        """Say how far the control can be from the one that the true means give.

        Parameters
        ----------
        delta : float, default 0.05
            Probability of error, 0 < delta < 1.

        Returns
        -------
        Confidence
            Radii for the entities and for the state.

        Raises
        ------
        InputError, InputTypeError
            If `delta` cannot be used, an entity has no realization, or one has a target: what is
            fitted to a target says nothing about the mean. If the realizations show that two of
            them are farther apart than `ranges` says.

        Notes
        -----
        *What holds*, if `ranges` is true for all three entities and the realizations are
        independent with one law each: with probability at least 1 - delta, for **all** numbers
        of realizations at once - so one may look as often as one likes, and stop when it is
        good enough -, ``||F - E|| <= r`` for each entity and ``||B (v - v*)|| <= r_f +
        (||FA|| + r_A) r_0 + r_A ||F0||``, where E are the means of the laws and v* is their
        control. Realizations that are biased have another mean than what they are to estimate;
        that difference is not covered.

        *The radius* is Bernstein's inequality for vectors, dimension-free, with a bound on the
        variance from the data: with ``D^2 = sum ||E_i - mean||^2`` and delta_E = delta / (number of
        entities whose range is not 0), ``x = ||mean - E|| <= R l / (3 N) + w sqrt(2 l V / N)`` with
        ``l = log(2 / (0.75 delta_k))``, and ``sqrt(V) <= b + sqrt(b^2 + D^2 / N + x^2)`` with
        ``b = w R sqrt(log(4 / delta_k) / (2 N))``. Without `sizes`, the numbers
        ``4^k <= N < 4^(k + 1)`` share ``delta_k = delta_E / (k (k + 1))`` and w < 1.07. With a size
        m, ``delta_k = delta_E`` and ``w = (sqrt(N / m) + sqrt(m / N)) / 2``, which is 1 at N = m.

        `ranges` is refuted by a distance from the first realization, by the range of an entry, or
        by ``D^2 > (N - 1) R^2 / 2``; other violations cannot be seen. Without a range, twice the
        largest observed distance from the first realization takes its place. That is an estimate
        (``finite_sample=False``): values that are rare may not have been seen yet.

        References
        ----------
        I. Pinelis, "Optimum bounds for the distributions of martingales in Banach spaces" (1994).
        S. Howard, A. Ramdas, J. McAuliffe, J. Sekhon, "Time-uniform, nonparametric, nonasymptotic
        confidence sequences" (2021), for the epochs.
        J.-Y. Audibert, R. Munos, C. Szepesvari, "Exploration-exploitation tradeoff using variance
        estimates in multi-armed bandits" (2009), for the variance from the data.

        Examples
        --------
        >>> import numpy as np
        >>> data = np.random.default_rng(1).uniform(0.9, 1.1, (10_000, 1))
        >>> stream = DataStream([[1.0]], ranges={"x0": 0.2, "xf": 0.0, "A": 0.0})
        >>> stream.update(x0=data, xf=[0.0], A=[[2.0]])
        >>> found = stream.confidence()
        >>> found.finite_sample, abs(stream.u[0] + 2.0) <= found.state < 0.006
        (True, True)
        """
        delta = float(gate.probability("delta", delta))
        self._seen("confidence")
        if any(self._targets):
            named = [n for n, known in zip(_NAMES, self._targets, strict=True) if known]
            raise InputError(
                f"`confidence` needs running means, but {named[0]} is fitted to a target, which "
                "says nothing about its mean"
            )
        counts, deviations, spreads, _ = self._core.statistics()
        apart, rounding = self._core.evidence()
        uncertain = sum(self._ranges.get(name, np.inf) > 0.0 for name in _NAMES)
        radii, bounds = [], {}
        for k, name in enumerate(_NAMES):
            given, size = self._ranges.get(name), self._sizes.get(name)
            if given is not None and apart[k] > given:
                raise InputError(
                    f"`ranges['{name}']` must bound the distance of any two realizations: there "
                    f"are two at least {apart[k]:.6g} apart, got {given:.6g}"
                )
            observed = 2.0 * spreads[k] if counts[k] > 1 else np.inf
            diameter = observed if given is None else given
            radius = mean_radius(
                counts[k], deviations[k], diameter, delta / max(uncertain, 1), size
            )
            bounds[name] = _bound(radius, diameter, given, size)
            radii.append(radius + 2.0 * rounding[k])  # of the mean, and through the deviation
        x0, _, A = self._core.estimates()
        r0, rf, rA = radii
        # inf * 0 is no bound: a radius of infinity stays one
        norm = interruptible(lambda: float(np.linalg.norm(A, 2)))
        parts = [(norm + rA, r0), (rA, float(np.linalg.norm(x0)))]
        state = rf + sum(a * b if a != 0.0 and b != 0.0 else 0.0 for a, b in parts)
        single = [name for name, r in zip(_NAMES, radii, strict=True) if not np.isfinite(r)]
        reason = None
        if single:
            reason = (
                f"one realization of {', '.join(single)} and no `ranges` for it: its spread is "
                "unknown"
            )
        elif not np.isfinite(state):
            state, reason = np.inf, "the radius of the state overflows"
        complete = len(self._ranges) == len(_NAMES)
        return Confidence(state, r0, rf, rA, delta, complete, bounds, reason)

    def _repr_html_(self) -> str:
        counts = self.counts
        known = all(counts.values())
        rows = [
            ("realizations", html.counts(counts)),
            ("control u", html.vector(self.u) if known else "none: an entity has no realization"),
            ("certified", self.certificate if known else None),
        ]
        return html.card(self, rows)

    def _seen(self, what: str) -> None:
        missing = [name for name, count in self.counts.items() if count == 0]
        if missing:
            raise InputError(f"`{what}` needs at least one realization of {', '.join(missing)}")

    def _to_sections(self) -> dict[str, Any]:
        """Return the state as named arrays of counters and numbers."""
        ranges = np.array([self._ranges.get(name, -1.0) for name in _NAMES])
        sizes = np.array([self._sizes.get(name, 0) for name in _NAMES], dtype=np.uint64)
        return {"ranges": ranges, "sizes": sizes} | dict(self._core.to_sections())

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> DataStream:
        """Make a stream of what `_to_sections` returned, after checking that it can be one."""
        state = dict(sections)
        ranges = np.asarray(state.pop("ranges", ()), dtype=np.float64)
        possible = np.isfinite(ranges) & ((ranges >= 0.0) | (ranges == -1.0))
        if ranges.shape != (3,) or not possible.all():
            raise InputError("`state` must have three ranges, finite or -1 for none, got others")
        sizes = np.asarray(state.pop("sizes", ()))
        if sizes.shape != (3,) or sizes.dtype != np.uint64 or (sizes > gate.EXACT).any():
            raise InputError("`state` must have three sizes, 0 for none, got others")
        made = cls.__new__(cls)
        made._core = _core.DataStream.from_sections(list(state.items()))
        known = zip(_NAMES, ranges.tolist(), strict=True)
        made._ranges = {name: value for name, value in known if value >= 0.0}
        planned = zip(_NAMES, sizes.tolist(), strict=True)
        made._sizes = {name: size for name, size in planned if size > 0}
        _, n, m, *targets = (int(v) for v in state["format"])
        made._shape, made._targets = (n, m), tuple(bool(v) for v in targets)
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return DataStream._from_sections, (self._to_sections(),)

    def __repr__(self) -> str:
        n, m = self._shape
        seen = ", ".join(f"{count} of {name}" for name, count in self.counts.items())
        return f"<DataStream: n={n}, m={m}, {seen}>"


def _checked_ranges(ranges: object) -> dict[str, float]:
    checked = {}
    for key, value in _named("ranges", ranges):
        zero = isinstance(value, (int, float)) and value == 0 and not isinstance(value, bool)
        checked[key] = 0.0 if zero else gate.positive(f"ranges['{key}']", value)
    return checked


def _checked_sizes(sizes: object) -> dict[str, int]:
    return {key: gate.size(f"sizes['{key}']", value) for key, value in _named("sizes", sizes)}


def _named(argument: str, values: object) -> Iterable[tuple[str, Any]]:
    if values is None:
        return []
    if not isinstance(values, Mapping):
        raise InputTypeError(f"`{argument}` must be a mapping of names, got {gate.show(values)}")
    return [(gate.choice(argument, name, _NAMES), value) for name, value in values.items()]


def _bound(radius: float, diameter: float, given: float | None, size: int | None) -> str:
    """Which bound a radius comes from."""
    if diameter == np.inf:
        return "none"
    source = "observed range, an estimate" if given is None else "given range"
    if radius >= diameter:
        return source
    where = "epochs of sizes" if size is None else f"tightest at {size}"
    return f"empirical Bernstein for all sizes, {where}; {source}"


def _gathered(
    name: str, items: Iterator[Any], shape: tuple[int, ...], rows: int
) -> Iterator[Floats]:
    """Single realizations as blocks of rows."""
    pending: list[Floats] = []
    try:
        for item in items:
            pending.append(_one(name, item, shape).ravel())
            if len(pending) == rows:
                yield np.stack(pending)
                pending = []
    except GeneratorExit:  # the core refused what it got
        raise
    except BaseException:  # what came before the fault, or before Ctrl-C, counts
        if pending:
            yield np.stack(pending)
        raise
    if pending:
        yield np.stack(pending)


def _one(name: str, item: object, shape: tuple[int, ...]) -> Floats:
    if len(shape) == 1:
        return gate.vector(name, item, length=shape[0])
    return gate.matrix(name, item, rows=shape[0], cols=shape[1])
