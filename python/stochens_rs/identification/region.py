"""`Region`: models that contain the true one, and what is asked of one."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from .. import _core
from .._base import fields, show, validation
from .._base.names import weight
from .._base.records import (
    Count,
    FromZero,
    Index,
    Probability,
    SavedRecord,
    cached_property,
    trusted,
)
from .._base.running import get_num_threads
from .._base.types import ArrayLike, Axes, Floats, NDArray
from ..exceptions import InputError, NonFiniteError, ShapeError
from ..plots.certificates import draw_region
from .assumptions import Assumptions, Misfit

fields.enter(
    _core.RegionPart,
    rows=NDArray[np.int64],
    columns=NDArray[np.int64],
    **dict.fromkeys(("white", "root", "missing"), Floats),
    ratio=float,
    shape=Floats,
    factor=float,
)


class Region(SavedRecord):
    """Models ``[A B c]`` that contain the true one with probability at least ``1 - delta``.

    Made by `Model.region`.

    Attributes
    ----------
    centre : ndarray, shape (n, n + m) or (n, n + m + 1)
        ``[A B]`` or ``[A B c]`` in the middle of the region, which `bound` refers to. That of the
        model; but for any design without `scale` least squares of the pairs after the first ones.
    m : int
        The number of inputs.
    delta : float
        The true model lies outside with at most this probability.
    assumption : str
        What the statement rests on, in words.
    missing : tuple of str
        The directions ``z = (x, u)`` that the data do not determine, in the names of the data: for
        a z with a part in them, `bound` is infinite.
    parts : tuple
        The region itself: one part for all rows of ``[A B c]``, or one for each row, that says
        ``(Theta - centre) V (Theta - centre)' <= factor S`` for its `rows` and `columns`. With
        ``V^+ = white' white`` and ``V = root' root``; columns of `missing` are what the data do not
        determine, and `ratio` is the smallest over the largest singular value of the scaled data.
    future : int
        How many columns of noise to come are covered, see `bound`.
    frobenius : float or None
        ``||S^-1/2 (Theta - C) V^1/2||_F`` is at most this, in the same event; None where only the
        spectral norm is bounded.
    noise : ndarray, shape (n, n), or None
        The covariance of Gaussian noise is at most this, in the same event; None where no bound is
        known.
    misfit : Misfit or None
        What the true system has beside the model, as declared: the region is of its linear part.
    """

    centre: Annotated[Floats, "row column"]
    m: Count
    delta: Probability
    assumption: str
    missing: tuple[str, ...]
    parts: tuple[_core.RegionPart, ...]
    future: Index = 0
    frobenius: FromZero | None = None
    noise: Annotated[Floats, "row row"] | None = None
    misfit: Misfit | None = None

    def _check(self) -> None:
        n, d = self.centre.shape
        if d not in (n + self.m, n + self.m + 1):
            raise ShapeError(f"`centre` must have {n + self.m} columns, or one more, got {d}")
        if self.noise is not None:
            weight("noise", self.noise, n, matrix=True)
        for part in self.parts:
            _require_one_set(part)

    @property
    def core(self) -> _core.Region:
        """The region of the core, for what is proved of linear systems only."""
        if self.misfit is not None:
            raise InputError(
                "a model with a misfit has certificates of a feedback only: gain(model).certificate"
            )
        return self.linear

    @cached_property
    def linear(self) -> _core.Region:
        """The region of the core, of the linear part of the system."""
        centre = np.ascontiguousarray(self.centre)
        return _core.Region(centre, self.m, self.parts, self.frobenius, self.future > 0)

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self.centre)

    @property
    def radius(self) -> float:
        """The bound for a z of length 1: ``sqrt(factor ||S||)``.

        Lengths are those of V^-1, in which the data make ``||z||`` about ``|z| / sqrt(N)``. With
        one part for each row, the root of the sum of squares.
        """
        return self.linear.radius

    @property
    def bounded(self) -> bool:
        """Whether `bound` is finite for all x and u."""
        return np.isfinite(self.radius) and not self.missing

    def contains(
        self, A: ArrayLike, B: ArrayLike | None = None, c: ArrayLike | None = None
    ) -> bool:
        """Whether a model is in the region.

        Parameters
        ----------
        A : array_like, shape (n, n)
            Its state matrix; or without `B` all its coefficients, in the shape of `centre`, as for
            a model of readings, which has no A and B: those of its window (`Model.window`).
        B : array_like, shape (n, m), optional
            Its input matrix.
        c : array_like, shape (n,), optional
            Its offset, for a model with intercept; the default is 0.

        Returns
        -------
        bool
            False also where it differs from an entry that was declared as known.

        Raises
        ------
        InputError, InputTypeError
            If the shapes do not fit, or a `c` other than 0 is given without intercept.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 20, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
        >>> region = se.identify(data, noise=0.1).region(0.05)
        >>> region.contains([[0.5]], [[1.0]]), region.contains([[0.9]], [[1.0]])
        (True, False)
        """
        n, d = self.centre.shape
        if B is None:
            if c is not None:
                raise InputError("`c` must be left out without `B`: `A` is then the whole model")
            return self.linear.contains(validation.matrix("A", A, rows=n, cols=d))
        blocks = [
            validation.matrix("A", A, rows=n, cols=n),
            validation.matrix("B", B, rows=n, cols=self.m),
        ]
        offset = np.zeros(n) if c is None else validation.vector("c", c, length=n)
        if d == n + self.m and offset.any():
            raise InputError("`c` must be left out: the model has no intercept")
        blocks.append(offset[:, None])
        return self.linear.contains(np.hstack(blocks if d > n + self.m else blocks[:2]))

    def bound(self, x: ArrayLike, u: ArrayLike, *, noise: bool = False) -> float:
        """Bound how far one step of the true system is from that of the `centre`.

        Parameters
        ----------
        x : array_like, shape (n,)
            The state; may be chosen after the data, as may `u`.
        u : array_like, shape (m,)
            The input.
        noise : bool, default False
            Whether the noise of that step is included; the region must have been made with
            ``future=1`` or more.

        Returns
        -------
        float
            ``||(Theta - C) z||_2`` is at most this for all x and u at once, with
            ``z = (x, u, 1)``; infinite where the data do not determine it.

        Raises
        ------
        InputError, InputTypeError
            If the shapes do not fit, or the region has no noise to come.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 20, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
        >>> region = se.identify(data, noise=0.1).region(0.05)
        >>> region.bound([0.0], [0.0]), region.bound([1.0], [0.0]) < 0.3
        (0.0, True)
        """
        z = self._z(x, u)
        if validation.flag("noise", noise) and not self.future:
            raise InputError("`noise` needs a region of noise to come: region(delta, future=1)")
        return self.core.bound(z, noise)

    def component_bounds(self, x: ArrayLike, u: ArrayLike) -> Floats:
        """Bound every component of one step: ``|((Theta - C) z)_i|``.

        Parameters
        ----------
        x, u
            As in `bound`.

        Returns
        -------
        ndarray, shape (n,)
            All of them hold at once. ``region(delta, components=True)`` has sharper ones.

        Raises
        ------
        InputError, InputTypeError
            If the shapes do not fit.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 20, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
        >>> se.identify(data, noise=0.1).region(0.05).component_bounds([0.0], [0.0])
        array([0.])
        """
        return self.core.component_bounds(self._z(x, u))

    @property
    def entry_bounds(self) -> Floats:
        """Bounds of the entries of ``Theta - centre``, all at once, of the shape of `centre`.

        ``|e_i' (Theta - C) e_j| <= sqrt(factor S_ii) ||e_j||`` in the norm of V^-1; 0 where an
        entry is known, infinite where the data do not determine it.
        """
        return self.linear.entry_bounds()

    def plot(
        self,
        across: tuple[int, int] = (0, 0),
        up: tuple[int, int] = (0, 1),
        *,
        label: str | None = None,
        ax: Axes | None = None,
    ) -> Axes:
        """Draw which pairs of two coefficients are in the region, whatever the others are.

        Parameters
        ----------
        across, up : (int, int), default (0, 0) and (0, 1)
            Row and column in ``[A B c]`` of the coefficients.
        label : str, optional
            What the region is called; the default is its probability.
        ax : matplotlib Axes, optional
            Where to draw. Each further region gets the next colour.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        InputError, InputTypeError
            If there is no such coefficient, it is known, or the data do not determine it.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 20, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
        >>> ax = se.identify(data, noise=0.1).region(0.05).plot()
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('A[0, 0]', 'B[0, 0]')
        """
        one, other = self._entry("across", across), self._entry("up", up)
        if one == other:
            raise InputError(f"`up` must differ from `across`, got {other} twice")
        corners = self.linear.projection(one, other)
        if corners is None:
            raise InputError("the data do not determine these coefficients: there is no edge")
        centre = np.array([self.centre[one], self.centre[other]])
        said = show.percent(self.delta) if label is None else validation.text("label", label)
        return draw_region(
            centre, corners + centre, said, self._entry_name(*one), self._entry_name(*other), ax
        )

    def _entry(self, argument: str, entry: object) -> tuple[int, int]:
        """Row and column of a coefficient that is not known."""
        pair = validation.items(argument, entry)
        if len(pair) != 2:
            raise ShapeError(f"`{argument}` must be (row, column), got {len(pair)} items")
        i, j = (
            validation.size(argument, one, minimum=0, maximum=most - 1)
            for one, most in zip(pair, self.centre.shape, strict=True)
        )
        if not any(i in part.rows and j in part.columns for part in self.parts):
            raise InputError(f"`{argument}` must be estimated, {self._entry_name(i, j)} is known")
        return i, j

    def _entry_name(self, i: int, j: int) -> str:
        n, m = self.n, self.m
        return f"A[{i}, {j}]" if j < n else f"B[{i}, {j - n}]" if j < n + m else f"c[{i}]"

    def _but(self, **fields: Any) -> Region:
        """The same with other fields."""
        kept = {name: value for name, value in vars(self).items() if name != "linear"}
        return trusted(Region, **{**kept, **fields})

    def _z(self, x: ArrayLike, u: ArrayLike) -> Floats:
        """``z = (x, u)``, with 1 behind it for a model with intercept."""
        n, d = self.centre.shape
        given = validation.vector("x", x, length=n), validation.vector("u", u, length=self.m)
        return np.concatenate([*given, np.ones(d - n - self.m)])

    def __repr__(self) -> str:
        what = f"radius {self.radius:.4g}" if np.isfinite(self.radius) else "unbounded"
        off = f", infinite along {', '.join(self.missing[:3])}" if self.missing else ""
        return f"<Region: {show.percent(self.delta)}, {what}{off}>"


def withheld(region: Region, doubts: tuple[str, ...]) -> Region:
    """The same without a bound, where a test of the data refuses them."""
    if not doubts:
        return region
    fields = (part.__reduce__()[1] for part in region.parts)
    parts = tuple(_core.RegionPart(*own[:-1], np.inf) for own in fields)  # type: ignore[call-arg,arg-type]
    wide = None if region.frobenius is None else np.inf
    said = f"{region.assumption}; but {doubts[0]}"
    return region._but(frobenius=wide, parts=parts, assumption=said)


def entered(region: Region, matrix: Floats, J: Floats, G: Floats, m: int) -> Region:
    """The region of ``[A B c] = matrix + G (Theta - centre) J`` in the same event."""
    covariance = None if region.noise is None else np.ascontiguousarray(region.noise)
    found, noise = _core.entered_region(region.linear, (matrix, J, G, m), covariance)
    noise = None if noise is None else validation.frozen(noise)
    centre, parts = validation.frozen(found.centre), found.parts
    return region._but(centre=centre, m=m, parts=parts, future=0, noise=noise)


def _require_one_set(part: _core.RegionPart) -> None:
    """Refuse matrices that describe no set, or not the same one."""
    for name in ("white", "root", "missing"):
        if not np.isfinite(getattr(part, name)).all():
            raise NonFiniteError(f"`parts.{name}` must be finite")
    weight("parts.S", part.S, len(part.rows), matrix=True)
    # V^+ = white' white and V = root' root of the same directions
    both = part.white @ part.root.T
    if not np.allclose(both, np.eye(len(part.white)), atol=1e-6):
        raise InputError("`parts.root` must be the inverse of `parts.white` in its directions")
    if not 0.0 <= part.ratio <= 1.0:
        raise InputError(f"`parts.ratio` must be in [0, 1], got {part.ratio:.3g}")


Method: TypeAlias = Literal["auto", "mixture", "universal"]
METHODS: tuple[Method, ...] = get_args(Method)


class Wish(NamedTuple):
    """What is asked of a region; `Model.region` says what each means."""

    delta: float
    components: bool = False
    directions: Floats | None = None
    future: int = 0
    frobenius: bool = False
    method: Method = "auto"
    anytime: bool = False


def region_of(
    estimate: _core.Estimate, noise: Assumptions, wish: Wish, units: Floats | _core.Estimate
) -> _core.Region:
    """The region of the core; `units`: a scale, or the estimate of the first pairs."""
    known = None if noise.known is None else np.ascontiguousarray(noise.known)
    law = noise.design, noise.noise, noise.covariance, known
    return estimate.region(law, units, *wish, get_num_threads(), noise.tail)


def of_core(
    made: _core.Region, noise: Assumptions, wish: Wish, m: int, said: str, missing: tuple[str, ...]
) -> Region:
    """The record of a region of the core."""
    known = made.noise if noise.noise == "gaussian" else None
    bound = None if known is None else validation.frozen(known)
    about = validation.frozen(made.centre), m, wish.delta, said, missing, made.parts
    return trusted(Region, *about, wish.future, made.frobenius, bound)


def directions(
    d: int, n: int, m: int, x0: ArrayLike | None, given: ArrayLike | None
) -> Floats | None:
    """The columns that span all z asked for: given, or those of one x0 and every u."""
    if x0 is None and given is None:
        return None
    if x0 is None:
        Q = validation.matrix("directions", given)
        if len(Q) != d:
            raise ShapeError(
                f"`directions` must have {d} rows, (x, u{', 1' if d > n + m else ''}), got {len(Q)}"
            )
    else:
        if given is not None:
            raise InputError("`x0` and `directions` must not be given both")
        start = validation.vector("x0", x0, length=n)
        largest = max(1.0, float(np.abs(start).max()))
        fixed = np.concatenate([start / largest, np.zeros(m), np.ones(d - n - m) / largest])
        Q = np.column_stack([fixed, np.eye(d)[:, n : n + m]])
    if not Q.any():
        raise InputError("`directions` must have an entry other than 0")
    sizes = np.abs(Q).max(axis=0)
    return Q / np.where(sizes == 0.0, 1.0, sizes)


def refuse(noise: Assumptions, wish: Wish, by_rows: bool) -> None:
    """Refuse a region that the assumptions do not have."""
    plain = noise.design == "independent" and noise.noise == "gaussian"
    for name, asked in (("directions", wish.directions is not None), ("future", wish.future > 0)):
        if asked and (not plain or by_rows or wish.components):
            raise InputError(
                f"`{name}` needs a region of all rows at once for design='independent', "
                "noise='gaussian', without `components`"
            )
    one_level = plain or noise.known is not None
    if one_level and (wish.method != "auto" or (wish.anytime and noise.design == "independent")):
        raise InputError(
            "`method` and `anytime` are for Gaussian noise of unknown covariance, any design"
        )
    if wish.frobenius and (by_rows or wish.components or wish.directions is not None):
        raise InputError("`frobenius` needs one region for all rows and directions")


def said(noise: Assumptions, wish: Wish | None, first: int = 0) -> str:
    """The assumptions in words; the `first` pairs tell the scale."""
    text = noise.text
    if noise.noise == "gaussian" and noise.design == "independent":
        text += ", independent of all states and inputs"
    elif first:
        text += (
            ", any design, for a number of pairs fixed beforehand and in the order of time, of "
            f"which the first {first} tell the scale"
        )
    elif noise.known is not None or (wish is not None and wish.anytime):
        text += ", any design, valid for all N at once"
    else:
        text += ", any design, for a number of pairs fixed beforehand"
    if noise.tail:
        text += f", beside it a declared tail of {noise.tail:g} deviations"
    if wish is not None and wish.directions is not None:
        text += "; states and inputs in a span fixed before the outcomes"
    return text
