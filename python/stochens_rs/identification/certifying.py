"""Which region a model has: the assumptions on one side, what is asked for on the other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np

from .._base import validation
from ..exceptions import InputError, ShapeError
from ..rng import Key
from ..theory.exact import EPS
from . import levels
from .assumptions import Assumptions
from .least_squares import Fitted, fit, null_space, restricted
from .part import Part
from .signs import SignTest, chance_of_infinity, sizes

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from .._base.types import Floats

    Indices: TypeAlias = NDArray[np.int64]

Method: TypeAlias = Literal["auto", "mixture", "universal"]
METHODS: tuple[Method, ...] = ("auto", "mixture", "universal")


class Block(NamedTuple):
    """Least squares for some rows and columns of Theta."""

    rows: Indices
    columns: Indices
    fitted: Fitted


class Wish(NamedTuple):
    """What is asked of a region; `Model.region` says what each means."""

    delta: float
    components: bool = False
    directions: Floats | None = None
    future: int = 0
    frobenius: bool = False
    method: Method = "auto"
    anytime: bool = False


def blocks(R: Floats, d: int, N: int, known: Floats | None, by_rows: bool) -> list[Block]:
    """Least squares for all rows at once, or row by row; `known` (n, d) is nan where free."""
    n = len(R) - d
    free = np.ones((n, d), dtype=bool) if known is None else np.isnan(known)
    Theta0 = np.zeros((n, d)) if known is None else np.where(free, 0.0, known)
    all_rows = np.arange(n)
    sets = (
        [all_rows] if not by_rows and (free == free[0]).all() else [all_rows[[i]] for i in range(n)]
    )
    found = []
    for rows in sets:
        columns = np.flatnonzero(free[rows[0]])
        part = restricted(R, d, rows, columns, Theta0) if known is not None or by_rows else R
        found.append(Block(rows, columns, fit(part, len(columns), N)))
    return found


def assembled(found: list[Block], known: Floats | None, n: int, d: int) -> Floats:
    """Theta from its blocks and the known entries."""
    Theta = np.zeros((n, d)) if known is None else np.nan_to_num(known)
    for block in found:
        Theta[np.ix_(block.rows, block.columns)] = block.fitted.H
    return Theta


def parts(
    found: list[Block], noise: Assumptions, wish: Wish, scale: Floats, n: int
) -> tuple[tuple[Part, ...], float | None, Floats | None]:
    """The parts of the region, and the Frobenius radius and the bound of the noise if there are."""
    made = []
    frobenius, bound = None, noise.known
    for block in found:
        rows, columns, f = block
        delta = wish.delta
        if len(rows) < n:  # one row each: together by the union, or independent of each other
            apart = noise.covariance in ("diagonal", "scalar") and noise.design == "independent"
            apart = apart and noise.noise == "gaussian" and wish.components and len(columns) > 0
            # 1 - (1 - delta)^(1/n)
            delta = -float(np.expm1(np.log1p(-delta) / n)) if apart else delta / n
        known = None if noise.known is None else noise.known[np.ix_(rows, rows)]
        if noise.design == "independent" and noise.noise == "gaussian":
            Q = None if wish.directions is None else wish.directions[columns]
            f, rank = _directed(f, Q)
            if wish.frobenius and noise.covariance == "full" and len(rows) == n:
                spectral, frobenius = levels.joint_radii(n, rank + wish.future, f.nu, delta)
                made.append(Part.of(f, rows, columns, f.S, spectral**2))
                continue
            factor, S, _ = levels.independent(f, noise, known, rank + wish.future, delta)
        else:
            options = scale[columns], scale[rows], delta, wish.method, wish.anytime
            factor, S, own = levels.adaptive(f, noise, known, *options)
            bound = own if len(found) == 1 else bound
        made.append(Part.of(f, rows, columns, S, float(factor)))
        if wish.frobenius and len(found) == 1:  # ||G||_F <= sqrt(min(n, d)) ||G||
            frobenius = float(np.sqrt(factor * min(len(rows), f.rank + wish.future)))
    return tuple(made), frobenius, bound


def _directed(f: Fitted, Q: Floats | None) -> tuple[Fitted, int]:
    """The same for z in the span of `Q` alone: there only as many columns of G count."""
    if Q is None:
        return f, f.rank
    # in units in which the columns of the data have length 1, as for their own rank
    D = np.linalg.norm(f.R11, axis=0)
    D = np.where(D == 0.0, 1.0, D)
    scaled = Q / D[:, None]
    sizes = np.linalg.norm(scaled, axis=0)
    U, s, _ = np.linalg.svd(scaled / np.where(sizes == 0.0, 1.0, sizes))
    rank, off = null_space(U.T, s, max(Q.shape) * EPS)
    rows = f.white * D
    rows /= np.linalg.norm(rows, axis=1)[:, None]  # orthonormal: cosines decide, not sizes
    seen = int(np.linalg.matrix_rank(rows @ U[:, :rank])) if rank and len(rows) else 0
    return f._replace(missing=np.hstack([off / D[:, None], f.missing])), seen


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


def sign_region(
    block: Block, Theta: Floats, Z: Floats, Y: Floats, delta: float, key: Key
) -> tuple[tuple[Part, ...], SignTest, str]:
    """A ball around least squares with the exact set of sign-perturbed sums in it, and that set."""
    m, q = sizes(delta)
    f, n = block.fitted, Y.shape[1]
    test = SignTest(Z, Y, Z[:, block.columns] @ f.white.T, m, q, key)
    factor = test.radius(Theta) ** 2
    chance = chance_of_infinity(f.N, f.rank)
    text = f"; {q} of {m} sign vectors, each without a bound with probability {chance:.2g}"
    return (Part.of(f, block.rows, block.columns, np.eye(n), factor),), test, text


def refuse(noise: Assumptions, wish: Wish, instruments: bool, by_rows: bool) -> None:
    """Refuse a region that the assumptions do not have."""
    if noise.noisy_states and not instruments:
        raise InputError(
            "no region is known: `state_noise` says that the states are measured with error, which "
            "biases the model; pass `instruments` to identify, or use set points as states and "
            "declare state_noise='none'"
        )
    plain = noise.design == "independent" and noise.noise == "gaussian" and not instruments
    for name, asked in (
        ("directions", wish.directions is not None),
        ("future", wish.future > 0),
    ):
        if asked and (not plain or by_rows or wish.components):
            raise InputError(
                f"`{name}` needs a region of all rows at once for design='independent', "
                "noise='gaussian', without instruments and without `components`"
            )
    one_level = plain or instruments or noise.noise == "symmetric" or noise.known is not None
    if one_level and (wish.method != "auto" or (wish.anytime and noise.design == "independent")):
        raise InputError(
            "`method` and `anytime` are for Gaussian noise of unknown covariance with "
            "design='adaptive'"
        )
    if (instruments or noise.noise == "symmetric") and (wish.components or wish.frobenius):
        raise InputError(
            "`components` and `frobenius` must be False with instruments and for noise='symmetric'"
        )
    if wish.frobenius and (by_rows or wish.components or wish.directions is not None):
        raise InputError("`frobenius` needs one region for all rows and directions")


def said(noise: Assumptions, wish: Wish | None, instruments: bool) -> str:
    """The assumptions in words."""
    if instruments:
        return (
            "Gaussian noise of process and readings, white, of one covariance each; instruments "
            "independent of both"
        )
    text = noise.text
    if noise.noise == "symmetric" or (noise.noise == "gaussian" and noise.design == "independent"):
        text += ", independent of all states and inputs"
    elif noise.known is not None or (wish is not None and wish.anytime):
        text += ", any design, valid for all N at once"
    else:
        text += ", any design, for a number of pairs fixed beforehand"
    if noise.noisy_states:
        return text + "; states measured with error"
    if wish is not None and wish.directions is not None:
        text += "; states and inputs in a span fixed before the outcomes"
    return text
