"""Gaussian systems of a given size and spectral radius."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._base import memory, validation
from .._base.threads import interruptible
from ..rng import RngLike, as_key
from ..system import System

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["random_system"]


def random_system(
    n: int,
    m: int,
    rng: RngLike = None,
    *,
    spectral_radius: float = 1.0,
) -> System:
    """Draw a Gaussian ``A`` with a given spectral radius and a Gaussian ``B``.

    Parameters
    ----------
    n : int
        Number of states.
    m : int
        Number of inputs. With ``m < n`` a random target is not reachable in one step.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness.
    spectral_radius : float, default 1.0
        Largest modulus of an eigenvalue of ``A``, positive.

    Returns
    -------
    System
        ``A`` (n, n) is ``G * spectral_radius / rho(G)`` and ``B`` (n, m), with the entries of
        ``G``, then those of ``B``, independent standard normal in row-major order. ``dt`` is True
        (discrete time, no unit).

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    ResourceError
        If the matrices do not fit into the memory this process may use.

    Notes
    -----
    The normal variates are NumPy's (``Generator(Philox).standard_normal``). Another version of
    NumPy may give another system for the same ``rng``; save ``A`` and ``B`` to keep them.

    Examples
    --------
    >>> import numpy as np
    >>> from stochens_rs.cases import random_system
    >>> system = random_system(4, 2, rng=7, spectral_radius=0.9)
    >>> bool(np.isclose(np.abs(np.linalg.eigvals(system.A)).max(), 0.9))
    True
    """
    n = validation.size("n", n)
    m = validation.size("m", m)
    spectral_radius = validation.positive("spectral_radius", spectral_radius)
    # A, its copy in the eigenvalue routine, the scaled A, and B
    memory.need("the random system", 8 * (3 * n * n + n * m))
    normal = as_key(rng).child("random_system").generator()

    def matrices() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        G = normal.standard_normal((n, n))
        B = normal.standard_normal((n, m))
        return G * (spectral_radius / float(np.abs(np.linalg.eigvals(G)).max())), B

    A, B = interruptible(matrices)
    return System(A, B, dt=True, name=f"random ({n} x {n}, spectral radius {spectral_radius:g})")
