"""`Limits`, `Forecast`, `Cost`, `Uncertain`: what is allowed, forecast, wanted and not known."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

from .._base import validation
from .._base.reading import aligned, labels_along, shown_labels
from .._base.records import NotNegative, Record, SavedRecord
from .._base.types import Floats, NDArray, Self
from ..exceptions import InputError, InputTypeError, NonFiniteError, ShapeError


class Named(Record):
    """An array with names along its last axis."""

    values: Floats
    names: tuple[str, ...]

    @property
    def index(self) -> tuple[str, ...] | None:
        """The names of a vector, as pandas has them."""
        return self.names if self.values.ndim == 1 else None

    @property
    def columns(self) -> tuple[str, ...] | None:
        """The names of the columns of a matrix, as pandas has them."""
        return None if self.values.ndim == 1 else self.names

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype)


Entries: TypeAlias = float | Floats | Named | None


class Asked(SavedRecord, listed=False):
    """Numbers, arrays and arrays with names, which a system brings into its order."""

    @property
    def given(self) -> dict[str, Any]:
        """What was given, by name."""
        return {name: one for name, one in vars(self).items() if one is not None}

    def only(self, *names: str) -> Self:
        """Refuse what is not among `names`, where a function has no use for it."""
        for name, one in self.given.items():
            if name not in names:
                kind, known = type(self).__name__.lower(), " and ".join(names)
                raise InputError(f"`{kind}` must have {known} only here, got {name}={_shown(one)}")
        return self

    def __repr__(self) -> str:
        shown = (f"{name}={_shown(one)}" for name, one in self.given.items())
        return f"{type(self).__name__}({', '.join(shown)})"


def pair_of(name: str, value: Any) -> Any:
    """A pair (low, high) of `entries`, or None; from pairs by name two arrays with these names."""
    if value is None:
        return None
    if isinstance(value, Mapping):
        return _sides_by_name(name, value)
    pair = validation.items(name, value, "a pair (low, high)")
    if len(pair) != 2:
        raise InputError(f"`{name}` must be a pair (low, high), got {len(pair)} items")
    return tuple(entries(f"{name}[{k}]", side) for k, side in enumerate(pair))


def _sides_by_name(name: str, value: Mapping[Any, Any]) -> tuple[Named, Named]:
    """``{"force": (-8, 8)}`` as (low, high), each of these names."""
    names = tuple(value)
    if not names or not all(isinstance(one, str) for one in names):
        raise InputTypeError(f"`{name}` must name what has limits by texts, got {names!s:.60}")
    rows = []
    for one in names:
        of = f"{name}[{one!r:.30}]"
        low, high = pair_of(of, value[one]) or (None, None)
        for end in (low, high):
            if not (end is None or isinstance(end, float)):
                raise InputTypeError(f"`{of}` must be two numbers, got {validation.show(end)}")
        rows.append([-np.inf if low is None else low, np.inf if high is None else high])
    lows, highs = np.array(rows).T
    return Named(lows.copy(), names), Named(highs.copy(), names)


def rows_by_name(name: str, value: Any) -> Named:
    """Numbers or rows of steps by name, ``{"outdoor": [4.0, 3.5]}``, as (h, names)."""
    if isinstance(value, Named):
        return value
    if not isinstance(value, Mapping):
        raise InputTypeError(f"`{name}` must be numbers by name, got {validation.show(value)}")
    names = tuple(value)
    if not names or not all(isinstance(one, str) for one in names):
        raise InputTypeError(f"`{name}` must have texts as names, got {names!s:.60}")
    each = [
        np.atleast_1d(validation.array(f"{name}[{one!r:.30}]", value[one], ndim=(0, 1)))
        for one in names
    ]
    if len({one.size for one in each} - {1}) > 1:
        raise ShapeError(f"`{name}` must have as many steps for each of {', '.join(names)}")
    return Named(np.column_stack(np.broadcast_arrays(*each)), names)


def steps_ahead(rows: Floats, K: int) -> Floats:
    """The rows of the next K steps; the last stays."""
    return rows.take(np.arange(K), axis=0, mode="clip")


def entries(name: str, value: Any, *, square: bool = False) -> Any:
    """A number as it is, numbers as an array, and with the labels of a table.

    A `square` table has the same names along both axes, and is kept in the order of its columns.
    """
    if value is None or isinstance(value, (str, Named)):
        return value
    found = _named(name, value, square)
    given = validation.read(name, value) if found is None else found.values
    if given.dtype.kind not in "iuf":
        raise InputTypeError(f"`{name}` must be numbers, got {validation.show(value)}")
    if np.isnan(given).any():
        raise NonFiniteError(f"`{name}` has nan: leave out what is not known, or pass None")
    if found is not None:
        return found
    return float(given) if given.ndim == 0 else given.astype(np.float64)


def numbers_of_inputs(name: str, value: Any) -> Any:
    """A number or numbers as by `entries`, or some by name; None among them is infinite."""
    names = None
    if isinstance(value, Mapping):
        names, value = tuple(value), list(value.values())
        if not names or not all(isinstance(one, str) for one in names):
            raise InputTypeError(f"`{name}` must have texts as names, got {names!s:.60}")
    if isinstance(value, (list, tuple)):
        value = [np.inf if one is None else one for one in value]
    found = entries(name, value)
    if names is None:
        return found
    return Named(validation.array(name, found, ndim=(1,), finite=False), names)


def _named(name: str, value: Any, square: bool) -> Named | None:
    """A table with names along its last axis, or None for anything else."""
    along = labels_along(value)
    if not along or not along[-1] or not all(isinstance(label, str) for label in along[-1]):
        return None
    names = tuple(map(str, along[-1]))
    found = aligned(name, value, names, square=square)
    if found is value:  # rows that are no times: `read` says what is wrong
        return None
    return Named(np.asarray(found, dtype=np.float64), names)


def _shown(value: Any) -> str:
    """A number as it is, an array by its entries where they are few, else by its shape."""
    if isinstance(value, Named):
        return f"{_shown(value.values)} of {shown_labels(value.names)}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_shown, value))})"
    if not isinstance(value, np.ndarray):
        return repr(value)
    return f"array {value.shape}" if value.size > 6 else str(value.tolist())


class Forecast(Asked):
    """What inputs will be that are measured and not chosen, as the weather or a load.

    Parameters
    ----------
    values : mapping
        By name of the input a number, or (h,), one for each step from now on; the last stays.
    error : float or mapping, default 0
        How far the input may be from it in each step, whatever it reacts to: a number for all, or
        by name as `values`. Bounds of a plan hold for all such inputs.

    Raises
    ------
    InputError, InputTypeError, ShapeError
        If an argument cannot be used, or names have different numbers of steps.

    Examples
    --------
    >>> import stochens_rs as se
    >>> limits = se.Limits({"heating": (0.0, 5.0)}, forecast=se.Forecast({"outdoor": [4.0, 3.0]}))
    >>> system = se.System([[0.9]], [[0.1, 0.1]], inputs=("heating", "outdoor"))
    >>> se.control(system, [20.0], [20.0], steps=3, limits=limits).u[:, 1]
    array([4., 3., 3.])
    """

    values: Named
    error: float | Named = 0.0

    def __post_init__(self) -> None:
        self._keep(values=rows_by_name("values", self.values))
        if isinstance(self.error, Mapping):
            self._keep(error=rows_by_name("error", self.error))
        of = self.error.values if isinstance(self.error, Named) else self.error
        validation.array("error", of, ndim=(0, 2))
        if np.min(of) < 0.0:
            raise InputError(f"`error` must be >= 0, got {np.min(of):.4g}")
        super().__post_init__()

    @property
    def exact(self) -> bool:
        """Whether the inputs will be what is forecast."""
        return not np.asarray(self.error).any()


class Limits(Asked):
    """Limits of inputs, of their changes and of states.

    Parameters
    ----------
    u : tuple (low, high) or mapping, optional
        Limits of the inputs, each a number, (m,) or (K, m), infinite or None where there is none;
        equal ones fix an input. Or ``{"force": (-8, 8)}``, numbers for some of the names: the
        others have none.
    rate, previous : float, array_like or mapping, optional
        ``|u(k) - u(k-1)| <= rate`` with ``u(-1) = previous``, the input that is applied now; a plan
        from a `record` takes its last one. A number, one for each input, one for each that is
        chosen where others are measured, or by name; inf, None and no name are no rate.
    x : tuple (low, high) or mapping, optional
        Limits of the states x(1), ..., x(K), each a number, (n,) or (K, n), or None; or by name. Of
        a model of outputs limits of the readings that it predicts, soft but with `Keep`.
    soft : float or bool, optional
        The weight of the squares of what is beyond `x`; default: 1000 times the largest entry of
        Q and Qf. False: hard limits, with status "infeasible" if they cannot be kept; with a model
        from data the true system keeps them with probability 95 %, that of its looks for a
        `ModelStream`, without noise to come. For a fleet they are hard, and False must be given.
    forecast : Forecast or mapping, optional
        Inputs that are measured and not chosen, with what they will be.

    Raises
    ------
    InputError, InputTypeError
        If an argument is no number, no array and no pair of such; or labels differ.

    Examples
    --------
    >>> import stochens_rs as se
    >>> limits = se.Limits(u=(-1.0, 1.0), rate=0.2, previous=0.0)
    >>> plan = se.control(([[1.0]], [[1.0]]), [1.0], [0.0], steps=3, limits=limits)
    >>> plan.u.ravel().round(2)
    array([-0.2, -0.4, -0.4])
    """

    u: tuple[Entries, Entries] | None = None
    rate: Entries = None
    previous: Entries = None
    x: tuple[Entries, Entries] | None = None
    soft: float | bool | None = None
    forecast: Forecast | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.forecast, Forecast | None):
            self._keep(forecast=Forecast(self.forecast))  # type: ignore[unreachable]
        self._keep(
            u=pair_of("limits", self.u),
            rate=numbers_of_inputs("rate", self.rate),
            previous=numbers_of_inputs("previous", self.previous),
            x=pair_of("limits.x", self.x),
        )
        super().__post_init__()


LimitsLike: TypeAlias = "Limits | tuple[Any, Any] | Mapping[str, tuple[Any, Any]] | None"


def as_limits(value: Any) -> Limits:
    """`value` itself, or the limits of inputs for a pair or pairs by name, or none for None."""
    if value is None:
        return NO_LIMITS
    return value if isinstance(value, Limits) else Limits(u=value)


class Cost(Asked):
    """Weights of states and inputs, and the wanted states.

    ``J(u) = sum_k ||x(k) - r(k)||^2_Q + ||u(k-1)||^2_R`` over k = 1, ..., K, with Qf at K.

    Parameters
    ----------
    Q, Qf : float or array_like, shape (n,) or (n, n), optional
        Weights of the states x(1), ..., x(K-1), and of x(K): numbers, diagonals or matrices, >= 0.
        Default: Q is 0, and Qf is Q, or I without Q; in `regulate` with Q and R the cost of all
        that follows, by the gain of `gain`. Of a model of outputs a number, or what has
        the shape of the outputs, weighs the readings now, or their first filters. Tables with the
        names of the states, of a matrix along both axes, may be in any order; so may R with the
        names of the inputs.
    R : "auto", float or array_like, shape (m,) or (m, m), optional
        Weight of each input, or of those that are chosen where others are measured. "auto", the
        default with limits or other weights:
        ``1e-8 tr(G'QG) / (m K)``, G from inputs to states.
    reference : array_like, shape (K + 1, n), optional
        The states wanted at the times 0, ..., K, instead of a target xf at all of them.

    Raises
    ------
    InputError, InputTypeError
        If an argument is no number and no array; or labels differ.

    Examples
    --------
    >>> import stochens_rs as se
    >>> cost = se.Cost(Q=1.0, R=0.5)
    >>> se.control(([[1.0]], [[1.0]]), [1.0], [0.0], steps=2, cost=cost).u.ravel().round(3)
    array([-0.727, -0.182])
    """

    Q: Entries = None
    Qf: Entries = None
    R: Entries | str = None
    reference: Floats | Named | None = None

    def __post_init__(self) -> None:
        if isinstance(self.R, str):
            validation.choice("R", self.R, ("auto",))
        for name, value in self.given.items():
            self._keep(**{name: entries(name, value, square=name != "reference")})
        super().__post_init__()


def as_cost(value: Any) -> Cost:
    """`value` itself, or no weights for None."""
    return NO_WEIGHTS if value is None else validation.instance("cost", value, Cost)


NO_LIMITS, NO_WEIGHTS = Limits(), Cost()


class Uncertain(SavedRecord):
    """An initial state that is known up to a distance, for plans of a model from data.

    Parameters
    ----------
    values : array_like, shape (n,)
        The state, as far as it is known.
    radius : float
        The true state is within this distance of `values`, in the 2-norm; 0 or more.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used.

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.Uncertain([1.0, 2.0], 0.1)
    Uncertain([1.0, 2.0], 0.1)
    """

    values: Entries
    radius: NotNegative

    def __post_init__(self) -> None:
        given: object = self.values
        if given is None or isinstance(given, str):
            raise InputTypeError(f"`values` must be a state, got {validation.show(given)}")
        self._keep(values=entries("values", self.values))
        if not np.isfinite(self.values).all():  # type: ignore[arg-type]
            raise NonFiniteError(f"`values` is {np.asarray(self.values)!s:.60}: it must be finite")
        super().__post_init__()

    def __repr__(self) -> str:
        return f"Uncertain({np.asarray(self.values).tolist()}, {self.radius:.6g})"
