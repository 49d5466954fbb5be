"""Least squares from one triangle: R with R' R = [Z Y]' [Z Y], the rows of Z being z = (x, u, 1).

Everything that a region needs is a function of R and the number of pairs N. ``V = sum z z'`` is
never formed, since that squares its condition number. Rank is decided on columns of unit length:
the statements do not depend on the units of z.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from ..exceptions import InputError
from ..theory.exact import EPS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._base.types import Floats

    Indices: TypeAlias = NDArray[np.int64]

# times (d + n) EPS of the lengths: rounding of outcomes, triangle and estimate. The largest error
# of exact pairs was 1.5 (d + n) EPS, for 12 to 1e5 pairs and ratios down to 1e-12.
SLACK = 4.0
# ratio of singular values, about sqrt(EPS), below which a decision on the rank is delicate: the
# directions that the data do not determine are then known to fewer than half of the digits
TRUSTED = 1e-8


class Fitted(NamedTuple):
    """Least squares and what its error is measured with.

    `white` (rank, d) has ``white' white = V^+``, `root` (rank, d) has ``root' root = V``. `missing`
    (d, d - rank): ``Theta z`` is determined only if ``missing' z = 0``. `rounding` (n,): what
    rounding may change in each row of ``H V^1/2`` and of the residuals.
    """

    H: Floats
    S: Floats
    N: int
    rank: int
    white: Floats
    root: Floats
    missing: Floats
    ratio: float
    R11: Floats
    rounding: Floats

    @property
    def nu(self) -> int:
        """Degrees of freedom of the residuals."""
        return self.N - self.rank

    def after(self, N: int) -> Fitted:
        """At N pairs, if V and S grow in proportion to their number."""
        if N == self.N:
            return self
        grown = float(np.sqrt(N / self.N))
        return self._replace(
            N=N,
            S=self.S * grown**2,
            white=self.white / grown,
            root=self.root * grown,
            R11=self.R11 * grown,
            rounding=self.rounding * grown,
        )


def r_factor(rows: Floats) -> Floats:
    """The square triangle of few rows, with a diagonal >= 0."""
    R = np.linalg.qr(rows)[1]
    R = np.vstack([R, np.zeros((rows.shape[1] - len(R), rows.shape[1]))])
    signs: Floats = np.where(np.diag(R) < 0.0, -1.0, 1.0)
    return R * signs[:, None]


def fit(R: Floats, d: int, N: int) -> Fitted:
    """Least squares from the triangle, of any rank.

    ``R11 = U diag(s) Q' D`` with the column lengths D: ``H' = D^-1 Q_r s_r^-1 U_r' R12`` and
    ``S = R22' R22 + R12' (I - U_r U_r') R12``, where the second term is what a lower rank leaves.
    """
    R11, R12, R22 = R[:d, :d], R[:d, d:], R[d:, d:]
    D = np.linalg.norm(R11, axis=0)
    D = np.where(D == 0.0, 1.0, D)
    U, s, Qt = np.linalg.svd(R11 / D)
    rank, missing = null_space(Qt, s, max(N, d) * EPS)
    U, s_r, Q_r = U[:, :rank], s[:rank], Qt[:rank]
    white = (Q_r / s_r[:, None]) / D
    left = R12 - U @ (U.T @ R12)
    H = (white.T @ (U.T @ R12)).T
    return Fitted(
        H=H,
        S=R22.T @ R22 + left.T @ left,
        N=N,
        rank=rank,
        white=white,
        root=(s_r[:, None] * Q_r) * D,
        missing=missing / D[:, None],
        ratio=float(s_r[-1] / s_r[0]) if rank else 0.0,
        R11=R11,
        rounding=SLACK * len(R) * EPS * (np.linalg.norm(R[:, d:], axis=0) + np.abs(H) @ D),
    )


def null_space(Qt: Floats, s: Floats, share: float) -> tuple[int, Floats]:
    """The rank of ``M = U diag(s) Qt`` and an orthonormal basis of its null space (columns).

    Singular values up to ``share s_1`` are taken for rounding, and so is a row w of the basis with
    ``||w|| <= share s_1 ||q / s||``, q the other entries of its row i: with the a in the range of
    M' with ``a_i = 1`` and the smallest ``||M a|| = 1 / ||q / s||``, row i of ``basis - a w`` is 0,
    and these columns span the null space of a matrix within ``||M a|| ||w|| <= share s_1`` of M.
    """
    rank = int(np.sum(s > share * np.max(s, initial=0.0)))
    basis = Qt[rank:].T
    known = np.linalg.norm(Qt[:rank].T / s[:rank], axis=1) * (share * np.max(s, initial=0.0))
    return rank, np.where((np.linalg.norm(basis, axis=1) <= known)[:, None], 0.0, basis)


def restricted(R: Floats, d: int, rows: Indices, columns: Indices, known: Floats) -> Floats:
    """The triangle for some rows and columns of Theta, where the other entries are `known`.

    ``[Z_columns, (Y - Z known')_rows]`` is ``[Z Y]`` times a matrix, so that of the triangle is
    enough. `known` (n, d) is 0 in these columns.
    """
    count = len(columns)
    M = np.zeros((len(R), count + len(rows)))
    M[columns, np.arange(count)] = 1.0
    M[:d, count:] = -known[rows].T
    M[d + rows, count + np.arange(len(rows))] = 1.0
    return r_factor(R @ M)


def named(missing: Floats, names: Sequence[str]) -> tuple[str, ...]:
    """The missing directions in words, ``x[1] - 0.5 u[0]``, one for each column of `missing`.

    Columns are combined so that each has a name of its own: Gauss and Jordan with pivots.
    """
    left = (missing / np.linalg.norm(missing, axis=0, keepdims=True)).T.copy()
    done: list[int] = []
    for row in range(len(left)):
        size = np.round(np.abs(left[row:]), 9)  # of equal ones the first, whatever the rounding
        size[:, done] = 0.0
        best, column = np.unravel_index(int(np.argmax(size)), size.shape)
        left[[row, row + int(best)]] = left[[row + int(best), row]]
        left[row] /= left[row, column]
        others = np.arange(len(left)) != row
        left[others] -= np.outer(left[others, column], left[row])
        done.append(int(column))
    return tuple(_combination(row, names) for row in left[np.argsort(done)])


def _combination(row: Floats, names: Sequence[str]) -> str:
    first = row[np.abs(row) > 1e-6 * np.abs(row).max()][0]
    text = ""
    for value, name in zip(row * np.sign(first), names, strict=True):
        if abs(value) < 1e-6 * np.abs(row).max():
            continue
        number = "" if abs(abs(value) - 1.0) < 5e-4 else f"{abs(value):.3g} "
        sign = ("-" if value < 0.0 else "") if not text else (" - " if value < 0.0 else " + ")
        text += f"{sign}{number}{name}"
    return text


def cautions(found: list[Fitted], missing: tuple[str, ...]) -> list[str]:
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


def corrected(R: Floats, d: int, n: int, N: int, covariance: Floats) -> Floats:
    """``Y' Z (Z' Z - N C)^-1``: consistent for states with errors of covariance C."""
    V = R[:d, :d].T @ R[:d, :d]
    V[:n, :n] -= N * covariance
    if np.linalg.eigvalsh(V)[0] <= 0.0:
        raise InputError("`state_noise` is as large as the states themselves: no estimate")
    return np.asarray(np.linalg.solve(V, R[:d, :d].T @ R[:d, d:]).T)
