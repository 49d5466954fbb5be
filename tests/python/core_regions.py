"""Regions of the core from least squares of a twin, and the errors of several steps."""

from __future__ import annotations

import numpy as np

from stochens_rs import _core


def core_region(fitted, S, *, spectral=1.0, frobenius=np.inf, noise=False, offset=False):
    """The region of one part around `fitted` with these radii of Gamma."""
    n, d = fitted.H.shape
    given = (fitted.white, np.linalg.pinv(fitted.white).T, fitted.missing)
    part = _core.RegionPart(
        np.arange(n),
        np.arange(d),
        *map(np.ascontiguousarray, given),
        fitted.ratio,
        np.ascontiguousarray(S),
        spectral**2,
    )
    centre = np.ascontiguousarray(fitted.H)
    return _core.Region(centre, d - n - offset, (part,), frobenius, noise), part


def white(V):
    """W with ``W V W' = I``."""
    return np.ascontiguousarray(np.linalg.inv(np.linalg.cholesky(V)))


def ball(centre, V, S, rho=1.0, m=1, *, by_rows=False, frobenius=None):
    """The region ``(Theta - C) V (Theta - C)' <= rho^2 S``, all rows at once or each alone."""
    centre = np.ascontiguousarray(np.atleast_2d(centre), dtype=float)
    n, d = centre.shape
    root = np.ascontiguousarray(np.linalg.cholesky(V).T)
    rows = [[i] for i in range(n)] if by_rows else [list(range(n))]
    parts = tuple(
        _core.RegionPart(
            np.array(one), np.arange(d), white(V), root, np.zeros((d, 0)), 1.0,
            np.ascontiguousarray(S[np.ix_(one, one)]), rho**2,
        )
        for one in rows
    )  # fmt: skip
    return _core.Region(centre, m, parts, frobenius, False)


def region_errors(region, x0, u, *, rho0=0.0, to_come=None):
    """The errors of a trajectory of the centre of a `Region` of the package."""
    return region.core.errors(x0, np.ascontiguousarray(u), rho0, to_come)


def share(region, Theta):
    """The part of its radius that the error of Theta takes: above 1 Theta is outside.

    A count of failures of so few data sets sees no region that is somewhat too small; this does.
    """
    off, found = Theta - region.centre, []
    for part in region.parts:
        rows, columns = np.asarray(part.rows), np.asarray(part.columns)
        X = np.linalg.solve(np.linalg.cholesky(part.S), off[np.ix_(rows, columns)] @ part.root.T)
        found.append(np.linalg.norm(X, 2) / np.sqrt(part.factor))
    return max(found)
