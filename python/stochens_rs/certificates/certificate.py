"""How far one quantity can be from another one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from typing import Any, Literal, TypeAlias

import numpy as np

from .._base import show, validation
from .._base.records import Probability, Record, SavedRecord, trusted
from .._base.types import Figure, Floats, SubFigure
from ..exceptions import InputError, ShapeError
from ..plots.certificates import draw_radii


class Radius(Record):
    """A quantity is at most `radius` away from another one; an entry of a `Certificate`.

    Attributes
    ----------
    radius : float or ndarray
        The bound, in the units of the quantity. Of several entries, for each step, component or
        both, all hold together.
    distance_from : str
        What it is the distance from.
    probability : float
        It holds with this probability at least; 1 where nothing is random.
    method : str
        What gave it.
    reason : str or None
        Why it is infinite, or larger than what another method gives.
    """

    radius: float | Floats
    distance_from: str
    probability: float
    method: str
    reason: str | None = None

    def _check(self) -> None:
        found = np.asarray(self.radius)
        if found.ndim > 2:
            raise ShapeError(f"`radius` must have at most two dimensions, got {found.ndim}")
        if not (found >= 0.0).all():
            raise InputError(f"`radius` must be >= 0, got {validation.show(self.radius)}")
        if not 0.0 < self.probability <= 1.0:
            raise InputError(f"`probability` must be in (0, 1], got {self.probability:g}")
        if np.isinf(found).any() and not self.reason:
            raise InputError("`reason` must say why `radius` is infinite, got None")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Radius) and self.to_dict() == other.to_dict()

    __hash__ = None  # type: ignore[assignment]

    @property
    def text(self) -> str:
        """The bound in words."""
        if np.ndim(self.radius):
            each = np.asarray(self.radius)  # of a table the largest of all steps
            size = show.vector(each if each.ndim == 1 else each.max(axis=0, initial=0.0))
        else:
            size = show.at_most(float(self.radius))
        if np.isinf(self.radius).all():
            return f"not bounded: {self.reason}"
        because = f"; {self.reason}" if self.reason else ""
        return f"within {size} of {self.distance_from} ({self.method}){because}"

    def __repr__(self) -> str:
        return f"<Radius: {self.text}>"


def radius_at(
    radius: float | Floats, distance_from: str, delta: float, method: str, reason: str | None
) -> Radius:
    """One that holds with probability ``1 - delta``; its `reason` only where it is infinite."""
    because = None if np.isfinite(radius).all() else reason
    return trusted(Radius, radius, distance_from, 1.0 - delta, method, because)


Kind: TypeAlias = Literal["guaranteed", "certain", "estimated"]


class Certificate(SavedRecord, eq=True):
    """How far quantities can be from where they should be, one `Radius` each, by name.

    Made by `Plan.bound`, `DataStream.confidence` and `ModelStream.look`. Radii of one certificate
    are of one kind.

    Attributes
    ----------
    kind : {"guaranteed", "certain", "estimated"}
        "guaranteed": each radius holds with its probability at least, if `assumption` does.
        "certain": nothing is random, each radius holds if `assumption` does. "estimated": something
        that the radii need was estimated, so that they can fail more often.
    delta : float
        The probability of failure that was asked for.
    quantities : dict of str to Radius
        The radii; the first one is the one to look at.
    covers : str
        Which radii hold together, and what the probability is over.
    assumption : str
        What they rest on, in words.
    parts : dict of str to float
        What `target` consists of, by name: it is at most their sum.
    warnings : tuple of str
        What to be careful about, one sentence each.
    """

    kind: Kind
    delta: Probability
    quantities: dict[str, Radius]
    covers: str
    assumption: str
    parts: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def _check(self) -> None:
        if not self.quantities:
            raise InputError("`quantities` must have at least one radius, got none")
        for name, part in self.parts.items():
            if not part >= 0.0:
                raise InputError(f"`parts['{name}']` must be >= 0, got {part:g}")

    def __getitem__(self, name: str) -> Radius:
        if name not in self.quantities:
            known = ", ".join(self.quantities)
            raise InputError(f"this certificate has no {name!r:.40}: it bounds {known}")
        return self.quantities[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.quantities)

    def _scalar(self, name: str) -> float:
        return float(self.quantities[name].radius) if name in self.quantities else np.inf

    @property
    def target(self) -> float:
        """Bound of the distance of the last state from xf; infinite if nothing bounds it."""
        return self._scalar("target")

    @property
    def state(self) -> float:
        """Bound of the distance of the last state from the predicted one or from the best one.

        Infinite if nothing is said of it.
        """
        return self._scalar("state")

    @property
    def control(self) -> float:
        """Bound of the distance of the control from the best one; infinite if nothing bounds it."""
        return self._scalar("control")

    @property
    def components(self) -> Floats:
        """Bounds of ``|x(K) - xf|_i``, (n,), for a model from data."""
        return np.asarray(self["components"].radius)

    @property
    def tube(self) -> Floats:
        """Bounds of ``||x(k) - xh(k)||``, (K + 1,), of a model from data; y for outputs."""
        return np.asarray(self["tube"].radius)

    @property
    def outputs(self) -> Floats:
        """Bounds of ``|y(k) - r|_i``, k = 1, ..., K, (K, n_outputs), for a model of outputs."""
        return np.asarray(self["outputs"].radius)

    @property
    def mean(self) -> Floats:
        """Bounds of ``||E y(k) - yh(k)||``, (K + 1,), for outputs: the `tube` without noise."""
        return np.asarray(self["mean"].radius)

    @property
    def excess(self) -> float | None:
        """Bound of how far ``J(u)`` is above the least J within the limits; None without limits."""
        return self._scalar("excess") if "excess" in self.quantities else None

    @property
    def largest(self) -> str | None:
        """The name of the largest of the `parts`: what to improve first."""
        return max(self.parts, key=lambda name: self.parts[name]) if self.parts else None

    @property
    def holds(self) -> str:
        """The kind of the certificate, its probability, and what is random, in words."""
        share = f"with probability {show.percent(self.delta)} at least"
        how = {
            "guaranteed": f"guaranteed {share}",
            "certain": f"if {self.assumption}",
            "estimated": f"estimated, not guaranteed, to hold {share}",
        }
        return f"{how[self.kind]}; {self.covers}"

    def over(self, other: Certificate) -> Certificate:
        """Return this certificate with the further radii of another one, which holds on its own.

        Parameters
        ----------
        other : Certificate
            Of the same control; each of the two holds with its own probability.

        Returns
        -------
        Certificate

        Raises
        ------
        InputTypeError
            If `other` is no Certificate.

        Examples
        --------
        >>> import stochens_rs as se
        >>> bound = se.steer(([[0.5]], [[1.0]]), [1.0], [0.0], 1000, rng=1).bound()
        >>> bound.over(bound).target == bound.target
        True
        """
        further = validation.instance("other", other, Certificate).quantities
        fields = {**vars(self), "quantities": {**further, **self.quantities}}
        return trusted(Certificate, **{**fields, "covers": f"{self.covers}; others on their own"})

    def plot(self, *, figure: Figure | SubFigure | None = None) -> Figure:
        """Draw the parts of the target, the tube over the steps, and the components.

        Without parts the radii that are single numbers are drawn in their place.

        Parameters
        ----------
        figure : matplotlib Figure or SubFigure, optional
            Where to draw; the default is a new figure.

        Returns
        -------
        matplotlib Figure

        Raises
        ------
        ImportError
            If matplotlib is not installed.

        Examples
        --------
        >>> import stochens_rs as se
        >>> bound = se.steer(([[0.5]], [[1.0]]), [1.0], [0.0], 1000, rng=1).bound()
        >>> len(bound.plot().axes)
        1
        """
        single = [name for name, one in self.quantities.items() if not np.ndim(one.radius)]
        bars = ("radius", {name: self._scalar(name) for name in single})
        if self.parts:
            bars = ("parts of the target", self.parts)
        known = self.quantities
        tube = self.tube if "tube" in known else None
        components = self.components if "components" in known else None
        return draw_radii(*bars, tube, components, self.share, figure)

    @property
    def share(self) -> str:
        """Kind and probability, short: "95 % guaranteed"; what it rests on if nothing is random."""
        if self.kind == "certain":
            return f"if {self.assumption}"
        return f"{show.percent(self.delta)} {self.kind}"

    def __repr__(self) -> str:
        name, first = next(iter(self.quantities.items()))
        shown = name != "last" and self.kind != "certain" and np.isfinite(first.radius).all()
        made = f", mostly {self.largest}" if self.parts and shown else ""
        careful = show.careful(self.warnings)
        return f"<Certificate: {name} {first.text}{made}, {self.share}{careful}>"

    def _repr_html_(self) -> str:
        made = " + ".join(f"{part:.3g} {name}" for name, part in self.parts.items())
        rows = [
            *((name, one.text) for name, one in self.quantities.items()),
            ("target consists of", made or None),
            ("holds", self.holds),
            ("if", self.assumption),
        ]
        if "tube" not in self.quantities:
            return show.card(self, rows)
        drawn = show.states(
            np.arange(len(self.tube)), self.tube[:, None], "radius around the predicted states"
        )
        return show.card(self, rows, drawn)


def certificate_of(
    delta: float, method: str, reason: str | None, quantities: dict[str, Any], **about: Any
) -> Certificate:
    """A guaranteed one, of radii and what each is from; behind them its own method and reason."""
    radii = {
        name: radius_at(radius, distance_from, delta, *(own or (method, reason)))
        for name, (radius, distance_from, *own) in quantities.items()
    }
    fields = {"kind": "guaranteed", "delta": delta, "quantities": radii, **about}
    return trusted(Certificate, **fields)
