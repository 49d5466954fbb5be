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


def region_errors(region, x0, u, *, rho0=0.0, to_come=None):
    """The errors of a trajectory of the centre of a `Region` of the package."""
    return region.core.errors(x0, np.ascontiguousarray(u), rho0, to_come)
