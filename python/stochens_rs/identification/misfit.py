"""`Misfit`: what the plant has and the linear model leaves out, as it is declared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.names import Labels
from .._base.records import FromZero, NotNegative, Options, Positive
from .._base.types import ArrayLike, Floats
from ..exceptions import InputError


@dataclass(frozen=True, eq=False, repr=False)
class Misfit(Options):
    """A term ``f(z, k)`` in ``x(k+1) = A x(k) + B u(k) + f + w(k)`` that no linear model has.

    It may be nonlinear, change from step to step and depend on the past, but not on noise to come.
    You declare its size, of one step of the model. A law in continuous time is spread over all
    states by sampling, and mixes in the inputs: ``on`` all states, ``of`` both, is then the safe
    choice.

    Attributes
    ----------
    on : str, sequence of str, or array_like of shape (n,)
        The states that it is added to; or the direction of one number in all states, such as
        ``(0, 0, -0.17, 1)`` for gravity in the speed and rate of a pendulum on a cart.
    of : str or sequence of str
        z: the states and inputs that it is a function of.
    at_most : float
        ``||f|| <= at_most ||z||^power`` for ``||z|| <= within``, in the units of the data.
    power : float, default 1
        At least 1; 3 for what a sine or a spring leaves out: ``|sin z - z| <= |z|^3 / 6``.
    within : float, default inf
        Where that is true. Certificates are then of motions that stay there, which they prove.
    cut : float, optional
        Pairs with ``||z||`` above this are left out of the data: a rule on what came before the
        step. Fix it beforehand. Default: `within`.

    Raises
    ------
    InputError, InputTypeError
        If a value cannot be used.

    Notes
    -----
    With ``phi^2`` the sum of the bounds of ``||f||^2`` over the pairs the error of least squares
    grows to ``(1 + t) rho^2 S + (1 + 1/t) phi^2 E E'``, E the direction, for known noise; t is the
    best of the sum of both in units of S. In use f is a block beside the region. See "How much can
    go wrong?".

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.Misfit(on="rate", of="angle", at_most=0.2, power=3, within=0.5)
    Misfit(on='rate', of='angle', at_most=0.2, power=3.0, within=0.5)
    """

    on: str | tuple[str, ...] | Floats
    of: str | tuple[str, ...]
    at_most: NotNegative
    power: Positive = 1.0
    within: FromZero = np.inf
    cut: FromZero | None = None

    def __post_init__(self) -> None:
        for name in ("on", "of"):
            value = getattr(self, name)
            if isinstance(value, (list, tuple)) and all(isinstance(one, str) for one in value):
                self._keep(**{name: tuple(value)})
            elif name == "on" and not isinstance(value, str):
                self._keep(on=validation.vector("on", value))
        super().__post_init__()
        if self.power < 1.0 or (self.power > 1.0 and self.within == np.inf):
            raise InputError("`power` must be at least 1, and with one above 1 `within` be finite")
        if not self.gamma <= 1e100:
            raise InputError("`at_most` and `power` must give a term of size below 1e100 ||z||")
        if self.cut is not None and self.cut > self.within:
            raise InputError("`cut` must be at most `within`, where the bound is true")

    @property
    def limit(self) -> float:
        """The size of z above which pairs are left out."""
        return self.within if self.cut is None else self.cut

    @property
    def gamma(self) -> float:
        """``||f|| <= gamma ||z||`` for all z up to `within`."""
        far = self.within if self.power > 1.0 else 1.0
        with np.errstate(over="ignore", invalid="ignore"):
            return float(self.at_most * np.float64(far) ** (self.power - 1.0))

    @property
    def text(self) -> str:
        """The declaration in words."""
        of = show.listed([self.of] if isinstance(self.of, str) else self.of)
        on = (
            f"direction {show.vector(self.on)}"
            if isinstance(self.on, np.ndarray)
            else (self.on if isinstance(self.on, str) else show.listed(self.on))
        )
        size = f"{self.at_most:g} ||z||{f'^{self.power:g}' if self.power > 1.0 else ''}"
        zone = f" for ||z|| <= {self.within:g}" if self.within < np.inf else ""
        return f"a term of size up to {size}, z = ({of}), in {on}{zone}, in the data and in use"


def block_of(misfit: Misfit, labels: Labels) -> tuple[Floats, Floats, float]:
    """Its direction (n, k), z as rows of (x, u), and `gamma`."""
    direction, signals = directions_of("on", misfit.on, labels), signals_of("of", misfit.of, labels)
    return direction, signals, misfit.gamma


def sizes_of(misfit: Misfit, z: Floats, labels: Labels) -> Floats:
    """``||z||`` in rows of (x, u)."""
    rows = signals_of("of", misfit.of, labels)
    return np.asarray(np.linalg.norm(z[:, : rows.shape[1]] @ rows.T, axis=1))


def grown(misfit: Misfit, part: _core.RegionPart, z: Floats, labels: Labels) -> _core.RegionPart:
    """The part of a region for data with the misfit, z (N, d)."""
    each = misfit.at_most * sizes_of(misfit, z, labels) ** misfit.power
    lengths = np.linalg.norm(z[:, part.columns] @ part.white.T, axis=1)
    phi = min(float(np.linalg.norm(each)), float(each @ lengths)) * (1.0 + 1e-9)
    E = directions_of("on", misfit.on, labels)
    S, more = part.factor * part.S, phi**2 * (E @ E.T)
    if phi > 0.0:
        share = float(np.sqrt(np.trace(np.linalg.solve(S, more)) / len(S)))
        S = (1.0 + share) * S + (1.0 + 1.0 / share) * more
    fields = part.__reduce__()[1]
    return _core.RegionPart(*fields[:-2], np.ascontiguousarray((S + S.T) / 2.0), 1.0)  # type: ignore[call-arg,arg-type]


def signals_of(name: str, of: str | Sequence[str], labels: Labels) -> Floats:
    """The rows of (x, u) with these names, (l, n + m)."""
    known = (*labels.states, *labels.inputs)
    asked = [of] if isinstance(of, str) else validation.items(name, of)
    places = [known.index(validation.choice(name, one, known)) for one in asked]
    if not places or len(set(places)) < len(places):
        raise InputError(f"`{name}` must name states or inputs, each once, got {of!r}")
    return np.eye(len(known))[places]


def directions_of(name: str, on: ArrayLike | str | Sequence[str], labels: Labels) -> Floats:
    """Columns of states: units of those with these names, or one direction, (n, k)."""
    named = [on] if isinstance(on, str) else on
    if isinstance(named, (list, tuple)) and all(isinstance(one, str) for one in named):
        chosen = signals_of(name, named, Labels(labels.states, ()))
        return np.ascontiguousarray(chosen.T)
    direction = validation.vector(name, on, length=len(labels.states), labels=labels.states)
    if not direction.any():
        raise InputError(f"`{name}` must have an entry other than 0")
    return direction[:, None].copy()
