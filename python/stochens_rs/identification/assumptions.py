"""What is assumed about the noise and the design: declared by the user, never inferred."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np

from .. import _core
from .._base import validation
from .._base.records import Record
from .._base.running import get_num_threads
from ..exceptions import InputError
from ..theory.exact import EPS
from .options import DESIGNS, LARGEST, LAWS, SIZES, SMALLEST, Design, Noise, NoiseLaw

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .._base.types import Floats


Covariance: TypeAlias = Literal["full", "diagonal", "scalar", "known"]

COVARIANCES: tuple[Covariance, ...] = get_args(Covariance)
#: The tests in the order in which they are named: first what explains the others.
FAULTS = (
    "equal rows",
    "spikes",
    "wrap",
    "clipped",
    "late rows",
    "dead time",
    "offset",
    "ends",
    "starts",
    "memory",
    "nonlinear",
    "outliers",
    "change",
    "drift",
    "variance",
    "noise size",
    "noise shape",
)
ACCEPTED = (*FAULTS, "no effect")
_ROUNDING = EPS  # times n^2: least eigenvalues of correlation matrices up to here may be 0


@dataclass(frozen=True, eq=False)
class Assumptions(Record):
    """What is assumed about the data; `identify` says what each word means.

    Attributes
    ----------
    design : {"independent", "adaptive"}
        Whether all z are independent of all noise.
    noise : {"gaussian", "sub-gaussian", "bounded"}
        The law of the noise.
    covariance : {"full", "diagonal", "scalar", "known"}
        What is known of its covariance.
    known : ndarray, shape (n, n), or None
        The covariance, if it is known; for other noise than Gaussian an upper bound.
    exact : tuple of int
        The states without noise of their own: it is 0, or a combination of that of other states.
    tail : float
        What the model leaves out beside the noise, in root mean square and deviations of the noise.
    accept : tuple of str
        The tests of which a failure is accepted, by name.
    """

    design: Design
    noise: NoiseLaw
    covariance: Covariance
    known: Floats | None = None
    exact: tuple[int, ...] = ()
    tail: float = 0.0
    accept: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        validation.choice("design", self.design, DESIGNS)
        validation.choice("noise", self.noise, LAWS)
        validation.choice("covariance", self.covariance, COVARIANCES)
        if (self.covariance == "known") != (self.known is not None):
            raise InputError("`known` must be the covariance where it is known, and only there")
        if self.known is not None:
            _require_covariance("known", self.known)
        if self.known is None and self.noise in SIZES:
            raise InputError(f"`known` must be given for {self.noise} noise")
        if list(self.exact) != sorted({validation.size("exact", i, minimum=0) for i in self.exact}):
            raise InputError("`exact` must be different states in their order")
        exact = self.design != "adaptive"
        if self.tail != 0.0 and (validation.positive("tail", self.tail, maximum=LARGEST) and exact):
            raise InputError("`tail` must be 0 for an independent design")

        if self.accept != checked_accept(self.accept):
            raise InputError("`accept` must be names of tests in their order")

    @property
    def design_text(self) -> str:
        """The assumption on the inputs behind the sizes of a model; "" if there is none."""
        return "" if self.design == "adaptive" else ", independent design"

    @property
    def text(self) -> str:
        """The assumption on the noise in words."""
        kind = {
            "full": "one unknown covariance",
            "diagonal": "one unknown diagonal covariance",
            "scalar": "covariance sigma^2 I, sigma unknown",
            "known": "known covariance" if self.noise == "gaussian" else "a known bound",
        }[self.covariance]
        return f"{'Gaussian' if self.noise == 'gaussian' else self.noise} noise of {kind}"


def checked_assumptions(
    n: int,
    noise: Noise,
    names: Sequence[str] = (),
    singular: bool = False,
    tail: float = 0.0,
    accept: object = (),
) -> Assumptions:
    """What is declared of n states of these names; `singular`: the known covariance may be so."""
    known, word = None, "known"
    if noise.sigma is not None:
        known = noise.sigma**2 * np.eye(n)
    elif isinstance(noise.covariance, str):
        word = noise.covariance
    else:
        known = _positive_definite("covariance", noise.covariance, n, semi=singular)
    exact, found = checked_exact(noise.exact, names), checked_accept(accept)
    return Assumptions(noise.design, noise.law, word, known, exact, tail, found)  # type: ignore[arg-type]


def checked_accept(accept: object) -> tuple[str, ...]:
    """The names of tests in `accept`, in the order of `ACCEPTED`."""
    given = [accept] if isinstance(accept, str) else validation.items("accept", accept)
    names = {validation.choice("accept", one, ACCEPTED) for one in given}
    return tuple(one for one in ACCEPTED if one in names)


def checked_exact(exact: Sequence[str | int], names: Sequence[str]) -> tuple[int, ...]:
    """The numbers of the states in `exact`, which are given by name or number."""
    found = set()
    for one in exact:
        if isinstance(one, str):
            found.add(names.index(validation.choice("exact", one, tuple(names))))
        else:
            found.add(validation.size("exact", one, minimum=0, maximum=len(names) - 1))
    return tuple(sorted(found))


def checked_scale(scale: Any, count: int, offset: bool) -> Floats:
    """The expected sizes of x and u, and 1 for the offset."""
    if validation.is_real(scale):
        sizes = np.full(count, validation.positive("scale", scale))
    else:
        sizes = validation.vector("scale", scale, length=count)
    if sizes.min() < SMALLEST or sizes.max() > LARGEST:
        wrong = sizes.min() if sizes.min() < SMALLEST else sizes.max()
        raise InputError(f"`scale` must be in [{SMALLEST:g}, {LARGEST:g}], got {wrong:g}")
    return np.concatenate([sizes, np.ones(int(offset))])


def _positive_definite(name: str, value: ArrayLike, n: int, *, semi: bool = False) -> Floats:
    given = validation.matrix(name, value, rows=n, cols=n)
    if np.abs(given).max() > LARGEST:
        raise InputError(f"`{name}` must have entries up to {LARGEST:g}")
    if not np.allclose(given, given.T, rtol=1e-9, atol=0.0):
        raise InputError(f"`{name}` must be symmetric")
    least = least_correlation(given)
    if least < (-_ROUNDING if semi else _ROUNDING) * n * n:
        raise InputError(
            f"`{name}` must be positive {'semi' * semi}definite, the least eigenvalue of its "
            f"correlation matrix is {least:.3g}"
        )
    return (given + given.T) / 2.0


def least_correlation(given: Floats) -> float:
    """The least eigenvalue in units in which the diagonal is 1: the same in all units."""
    sizes = np.sqrt(np.abs(np.diag(given)))
    sizes = np.where(sizes == 0.0, 1.0, sizes)
    return float(np.linalg.eigvalsh(given / sizes[:, None] / sizes)[0])


def _require_covariance(name: str, stored: Floats) -> None:
    """Refuse a field that is no covariance, up to the rounding of its eigenvalues."""
    n = len(validation.kept(name, stored, ndim=(2,)))
    validation.kept(name, stored, shape=(n, n))
    if (stored != stored.T).any() or least_correlation(stored) < -_ROUNDING * n * n:
        raise InputError(f"`{name}` must be symmetric and positive definite")


def refuse(assumed: Assumptions, single: bool) -> None:
    """Refuse assumptions that do not go together; `single`: every run is one pair."""
    if assumed.design == "independent" and not single:
        raise InputError(
            "`design` must be 'adaptive' for runs of several steps, whose states contain earlier "
            "noise; for 'independent' use data.last_pairs() or from_pairs"
        )


def require_states(assumed: Assumptions, n: int) -> None:
    """Refuse exact states that a system of n states does not have."""
    if any(state >= n for state in assumed.exact):
        raise InputError(f"`exact` must have numbers of states, below {n}")


def require_sound(scale: Floats | None, known: Floats | None) -> None:
    """Refuse sizes and known entries that `identify` would not take."""
    if scale is not None and not SMALLEST <= scale.min() <= scale.max() <= LARGEST:
        raise InputError(f"`scale` must be in [{SMALLEST:g}, {LARGEST:g}]")
    if known is None:
        return
    free = np.isnan(known)
    if not free.any() or free.all() or not (free | (np.abs(known) <= LARGEST)).all():
        raise InputError(f"`known` must have numbers up to {LARGEST:g}, and nan, and not only nan")


def require_triangle_of(rows: Floats, triangle: Floats) -> None:
    """Refuse a triangle R with another ``R' R`` than that of the rows W.

    Householder's QR has an error of a few (N + w) w EPS of each column (Higham 2002, theorem 19.4).
    """
    if np.tril(triangle, -1).any():
        raise InputError("`triangle` must be upper triangular")
    N, w = rows.shape
    fresh = _core.triangle(rows, get_num_threads())
    sizes = np.abs(fresh).max(axis=0)  # no square overflows
    sizes = np.where(sizes == 0.0, 1.0, sizes)
    with np.errstate(over="ignore", invalid="ignore"):
        mine, theirs = fresh / sizes, triangle / sizes
        far = np.abs(mine.T @ mine - theirs.T @ theirs).max()
    if not far <= 8.0 * (N + w) * w * EPS:
        raise InputError("`triangle` must be that of the data")
