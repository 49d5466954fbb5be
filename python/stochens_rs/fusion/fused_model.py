"""`FusedModel`: a mixture of given models and least squares, with regions from the data alone.

Models Theta_i (n, d) that are independent of the data; ``V = R' R`` with R = `root`. With
``S_i = Theta_i R'`` and ``t = H R'``, H least squares,
``||Y - Theta_w Z||^2 = ||sum w_i S_i - t||^2 + tr S``. For z independent of Gaussian noise of
covariance sigma^2 I the noise of t is sigma times a standard normal in p = n rank dimensions, of
which k belong to the affine hull of the S_i.
Known covariances become I by a change of units; of unknown ones the units are the estimated
deviations of the rows.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, NamedTuple

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.names import order_of
from .._base.records import SavedRecord, cached_property
from .._base.types import ROUNDING, Floats, Status
from ..data import Trajectories
from ..ensembles.systems import SystemEnsemble
from ..exceptions import InputError
from ..identification.identified import Identified
from ..identification.model import Model
from ..identification.region import Region

# Least unit of a row, of the size of its outcomes: the weights of rows are then at most 1e6 apart,
# and directions of the hull are seen in all of them (`position` drops those below 1e-10).
_LEAST = 1e-6


class NoiseSize(NamedTuple):
    """``sigma^2``, or None and what estimates it: the residual sum of squares and its degrees.

    `rows` above 1: so many rows have variances of their own, estimated with `degrees` each.
    """

    variance: float | None
    rss: float
    degrees: int
    rows: int = 1


class Hull(NamedTuple):
    """The mixture ``point = sum w_i S_i`` nearest to the data t; P projects on the affine hull.

    `distance2` is ``||t - point||^2``, `off2` is ``||t - P t||^2``, `along` is ``||P t - point||``;
    k and `face` are the dimensions of the affine hull and of the face that `point` lies in, p is
    that of the space; `largest` is the largest norm of t and the S_i.
    """

    point: Floats
    t: Floats
    distance2: float
    off2: float
    along: float
    k: int
    face: int
    p: int
    largest: float


class FusedModel(SavedRecord, Identified):
    """A model ``x(k+1) = A x(k) + B u(k) + c`` mixed from given models and from data.

    Made by `fuse` with ``data=``. With ``Theta = [A B c]``, H least squares and ``F = sum_s
    weights[s] Theta_s``, the model is ``F + share (H - F)``; along directions that the data do not
    determine it is F.

    Attributes
    ----------
    models : SystemEnsemble
        The models that were mixed.
    least_squares : Model
        Least squares of the data, with the assumptions on design and noise.
    weights : ndarray, shape (M,)
        Of the models in their mixture F: nonnegative, with sum 1.
    share : float
        The share of least squares, from 0 to 1. Above 0.5 the data count more than the models.
    gap : float
        No weights of the simplex have a squared distance that is smaller by more than this.
    status : {"optimal", "optimal_inaccurate", "user_limit", "interrupted"}
        How the search for the weights ended, as in `Fit`. Regions hold for any weights.
    """

    models: SystemEnsemble
    least_squares: Model
    weights: Annotated[Floats, "model"]
    share: Annotated[float, validation.nonnegative]
    gap: Annotated[float, validation.nonnegative]
    status: Status

    def _check(self) -> None:
        require_fit("least_squares", self.least_squares, self.models)
        weights = validation.kept("weights", self.weights, shape=(self.models.size,))
        if not (0.0 <= weights.min() <= weights.max() <= 2.0 and abs(weights.sum() - 1.0) <= 1e-6):
            raise InputError("`weights` must be nonnegative with sum 1")
        if self.share > 1.0:
            raise InputError(f"`share` must be in [0, 1], got {self.share:g}")

    @cached_property
    def Theta(self) -> Floats:
        """``[A B c]`` or ``[A B]``, read-only."""
        # F + share (t - F R') white, which is H - F where the data determine the model
        F = np.tensordot(self.weights, stacked(self.models, self.least_squares.intercept), axes=1)
        away = self._fitted.H @ self._fitted.root.T - F @ self._fitted.root.T
        return validation.frozen(F + self.share * away @ self._fitted.white)

    @cached_property
    def _hull(self) -> Hull:
        return position(*coordinates(self.models, self.least_squares), self.weights)

    @property
    def _fitted(self) -> _core.Fitted:
        return self.least_squares.blocks[0]

    @property
    def _noise(self) -> NoiseSize:
        return noise_of(self.least_squares)

    @property
    def largest(self) -> Floats | None:
        """The largest size of each state and input in the data."""
        return self.least_squares.largest

    @property
    def data(self) -> Trajectories:
        """The data that chose the weights."""
        return self.least_squares.data

    @property
    def dt(self) -> float | None:
        """The time between two steps [s]; None if unspecified."""
        return self.data.dt if self.data.dt is not None else self.models.dt

    @property
    def state_names(self) -> tuple[str, ...]:
        """The names of the states."""
        return self.data.state_names

    @property
    def input_names(self) -> tuple[str, ...]:
        """The names of the inputs."""
        return self.data.input_names

    @property
    def distance(self) -> float:
        """``||Sigma^-1/2 (F - H) V^1/2||_F``, how far the mixture of the models is from the data.

        Sigma is the covariance of the noise where that is known, I where it is declared a multiple
        of I, else the diagonal matrix of the estimated variances.
        """
        return float(np.sqrt(self._hull.distance2))

    @property
    def explained(self) -> bool | None:
        """Whether the data are compatible with some weights, of any sign, with sum 1.

        A test of level 0.01 for a design that is independent of the noise, exact where its
        covariance is known but for a factor. None where there is nothing to test.
        """
        noise = self._noise  # that of states without any is rounding
        rounding = ROUNDING * self._hull.largest
        return _core.hull_explained(
            self._hull, noise._replace(rss=max(noise.rss, rounding * rounding))
        )

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why no certificate of a plan from this model is finite: those of `least_squares`."""
        return self.least_squares.doubts

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to be careful about, one sentence each."""
        found, data = [], self.least_squares
        if self.explained is False:
            found.append("no mixture of the models explains the data")
        if data.size <= self._hull.k:
            found.append(
                f"{show.number_of(data.size, 'pair')} for {self._hull.k} free weights: the weights "
                "follow the noise"
            )
        if self._noise.variance is None and self._noise.degrees == 0:
            found.append("there are too few pairs to estimate the noise: declare sigma if known")
        if data.design == "adaptive":
            found.append(
                "design='adaptive': the region is that of least squares, without the models; "
                "declare Noise(sigma=, design='independent') if no input follows from the noise"
            )
        return (*found, *data.warnings)

    def region(self, delta: float = 0.05, *, future: int = 0, frobenius: bool = False) -> Region:
        """Return a set of models that contains the true one.

        Parameters
        ----------
        delta : float, default 0.05
            The probability that it does not, in (0, 1).
        future : int, default 0
            Let the noise of this many steps to come be covered too, in the same event.
        frobenius : bool, default False
            Bound the Frobenius norm as well, in the same event, as errors over several steps need.

        Returns
        -------
        Region
            A ball around this model in the norm of ``V^1/2``, or the region of least squares, whose
            centre is least squares; the assumption says which. Infinite for z that the data do not
            determine.

        Raises
        ------
        InputError, InputTypeError
            If no region is known for what was assumed, or an argument cannot be used.

        Notes
        -----
        For "alse", a design that is independent of the noise, and a covariance that is known or
        declared a multiple of I, two balls hold at once, with delta / 2 each. One is around the
        mixture F, from the data alone: its part off the affine hull of the models is bounded by the
        upper limit of the noncentrality of chi^2_{p-k}, the part in it by chi_k (after Baraud
        2004); it is small if some mixture is near the truth. The other is the region of least
        squares (`Model.region`). For points between, ``||X_s||^2 = (1 - s) ||X_0||^2 + s ||X_1||^2
        - s (1 - s) ||F - H||^2`` gives the smaller of both and less. The result is the smaller of
        that ball and the region of least squares, which `Plan.bound` uses both. Where the ball
        cannot be expected to be smaller, which the numbers of pairs and models decide, not the
        outcomes, and for all other designs, it is the region of least squares with the
        whole delta.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> models = [([[0.9]], [[1.0]]), ([[0.7]], [[1.2]])]
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.8 * x + 1.1 * u + 0.1 * w)
        >>> noise = se.Noise(sigma=0.1, design="independent")
        >>> fused = se.fuse(models, "alse", data=data, noise=noise)
        >>> fused.region(0.05).contains([[0.8]], [[1.1]])
        True
        """
        delta = validation.probability("delta", delta)
        options = {
            "future": validation.size("future", future, minimum=0, maximum=10_000),
            "frobenius": validation.flag("frobenius", frobenius),
        }
        if self._sharper(delta, options["future"]):
            return self.regions(delta, **options)[0]
        return self._own(delta, delta, **options)

    @property
    def _exact(self) -> bool:
        """Whether there is a ball around the mixture from the data alone."""
        data = self.least_squares
        return data.design == "independent" and one_variance(data)

    def _own(self, delta: float, level: float, **options: Any) -> Region:
        """The region of least squares at this level, as one of those that hold with `delta`."""
        found = self.least_squares.region(level, **options)
        text = found.assumption + "; the region of least squares, which is the smaller one"
        return replace(found, delta=delta, assumption=text)

    def _sharper(self, delta: float, future: int) -> bool:
        """Whether the ball is expected to be smaller than least squares with the whole delta.

        For a truth in the hull, at the mean of what the noise leaves off it. Fixed by sizes.
        """
        if not self._exact:
            return False
        noise, k = self._noise, self._hull.k
        usual = noise._replace(rss=float(noise.degrees))
        mean = self._hull._replace(off2=float(self._hull.p - k), along=0.0)
        ball = _core.hull_radius(mean, usual, delta / 2.0, self.least_squares.n * future)
        own = self.least_squares.region(delta, future=future).parts[0]
        return ball < own.factor * (usual.rss if noise.variance is None else 1.0)

    def _in_one_event(self, delta: float, **options: Any) -> tuple[Region, ...]:
        if not self._exact:
            return (self._own(delta, delta, **options),)
        return self._own(delta, delta / 2.0, **options), self._ball(delta, **options)

    def _ball(self, delta: float, *, future: int = 0, frobenius: bool = False) -> Region:
        """A ball around this model, in one event with least squares at delta / 2."""
        data, known = self.least_squares, self.least_squares.assumptions.known
        own = data.region(delta / 2.0, future=future, frobenius=frobenius)
        a = np.sqrt(_core.hull_radius(self._hull, self._noise, delta / 2.0, data.n * future))
        b = np.sqrt(own.parts[0].factor) if own.frobenius is None else own.frobenius
        if known is None and np.isfinite(b):
            b *= np.sqrt(np.linalg.norm(own.parts[0].S, 2))
        away = self._hull.t - self._hull.point
        radius = _core.hull_between(float(b), float(a), away, self.share, frobenius)
        shape = np.eye(data.n) if known is None else known
        return replace(
            own,
            centre=self.Theta,
            delta=delta,
            assumption=own.assumption + "; models independent of the data",
            parts=(_core.RegionPart.around(self._fitted, shape, radius**2),),
            frobenius=radius if frobenius else None,
        )

    def __repr__(self) -> str:
        data = self.least_squares
        return (
            f"<FusedModel: {show.number_of(self.models.size, 'model')}, n={data.n} "
            f"m={data.m}, {show.number_of(data.size, 'pair')}, "
            f"{100 * self.share:.3g} % least squares{show.warned(self.warnings)}>"
        )


def require_fit(name: str, data: Model, models: SystemEnsemble) -> None:
    """Refuse least squares that the models cannot be mixed with."""
    validation.same_sizes(name, (data.n, data.m), (models.n, models.m), "the models")
    if models.c is not None and not data.intercept:
        raise InputError(f"`{name}` must be a model with intercept, as the models have offsets")
    if data.known is not None:
        raise InputError(f"`{name}` must be identified without known entries")


def ensemble_of(name: str, systems: list[Any]) -> SystemEnsemble:
    """One ensemble of systems, pairs (A, B) and models from data, with the offsets of these."""
    made = SystemEnsemble.from_systems(
        [one.system if isinstance(one, Identified) else one for one in systems]
    )
    offsets = [one.c if isinstance(one, Identified) else None for one in systems]
    if all(c is None for c in offsets):
        return made
    rows = np.zeros((made.size, made.n))
    for k, c in enumerate(offsets):
        if c is not None:
            order = order_of(f"{name}[{k}]", systems[k].labels, made.labels)
            rows[k] = order.of_states(c)
    return replace(made, c=rows)


def stacked(models: SystemEnsemble, intercept: bool) -> Floats:
    """``[A_s B_s c_s]``, shape (M, n, d), with ``c_s = 0`` where the models have no offset."""
    parts = [models.A, models.B]
    if intercept:
        offset = np.zeros((models.size, models.n)) if models.c is None else models.c
        parts.append(offset[:, :, None])
    return np.concatenate(parts, axis=2)


def one_variance(data: Model) -> bool:
    """Whether the covariance of the noise is known, or known but for a factor."""
    return data.n == 1 or data.assumptions.covariance in ("known", "scalar")


def units(data: Model) -> Floats:
    """L with ``L L' = Sigma`` where that is known, I where it is a multiple of I.

    Else the estimated deviations of the rows, at least `_LEAST` of the sizes of their outcomes;
    these sizes where there are no residuals.
    """
    fitted, known = data.blocks[0], data.assumptions.known
    if known is not None:
        return np.asarray(np.linalg.cholesky(known))
    if one_variance(data):
        return np.eye(data.n)
    sizes = np.linalg.norm(fitted.H @ fitted.root.T, axis=1) / np.sqrt(fitted.N)
    if fitted.nu:
        sizes = np.maximum(np.sqrt(np.diag(fitted.S) / fitted.nu), _LEAST * sizes)
    return np.diag(np.where(sizes > 0.0, sizes, 1.0))


def noise_of(data: Model) -> NoiseSize:
    """The noise in the `units`: 1 where the covariance is known, else from the residuals."""
    fitted = data.blocks[0]
    if one_variance(data):
        variance = None if data.assumptions.known is None else 1.0
        return NoiseSize(variance, float(np.trace(fitted.S)), data.n * fitted.nu)
    return NoiseSize(None, float(data.n * fitted.nu), fitted.nu, data.n)


def coordinates(models: SystemEnsemble, data: Model) -> tuple[Floats, Floats]:
    """The S_i (M, n, rank) and t (n, rank), each row in `units` L: ``L^-1 Theta R'``."""
    fitted, L = data.blocks[0], units(data)
    given = stacked(models, data.intercept), fitted.H
    S, t = (np.asarray(np.linalg.solve(L, Theta @ fitted.root.T)) for Theta in given)
    return S, t


def position(S: Floats, t: Floats, weights: Floats) -> Hull:
    """What the data t are relative to the S_i, for the best weights."""
    point, numbers = _core.hull_position(S.reshape(len(S), -1), t.ravel(), weights)
    return Hull(point.reshape(t.shape), t, *numbers)
