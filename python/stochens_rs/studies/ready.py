"""Functions for studies: what is compared most often."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._base import validation
from .._base.numbers import norm
from .._base.records import Record
from .._base.types import Floats
from ..ensembles.sampling import sample
from ..exceptions import InputError
from ..fusion.fusing import Method
from ..fusion.paths import fuse_path
from ..rng import Key
from ..system import System
from ..theory.dynamics import checked_ends
from ..theory.exact import Best, best_control
from .units import PURE


def error(system: Any, x0: ArrayLike, xf: ArrayLike, *, tol: float = 1e-9) -> SamplingError:
    """Return the function of a study of the errors that sampling causes, against the sample size.

    Parameters
    ----------
    system : System or (A, B)
        The exact system, with n states and m inputs.
    x0, xf : array_like, shape (n,)
        Initial state and target.
    tol : float, default 1e-9
        Tolerance of ALSE weights.

    Returns
    -------
    SamplingError
        ``function(key, size, method)``, for a grid of "size" (nested) and "method" (as in `fuse`;
        shared, so that all methods see the same samples).

    Raises
    ------
    InputError, InputTypeError
        If the arguments do not fit together, or an error would be relative to 0.

    Examples
    --------
    >>> import stochens_rs as se
    >>> function = se.studies.error(([[0.9, 0.2], [0.0, 0.8]], [[0.0], [1.0]]), [1, 1], [0.5, 0])
    >>> grid = {"size": [10, 100, 1000], "method": ["uniform", "alse"]}
    >>> study = se.Study(function, grid, replicates=5, rng=1, nested="size", shared=["method"])
    >>> sorted(study.run().values)
    ['A', 'control', 'state', 'x0', 'xf']
    """
    known, start, goal = checked_ends(system, x0, xf)
    made = SamplingError(known, start, goal, validation.positive("tol", tol))
    if not made.norms():
        raise InputError("one of `system`, `x0` and `xf` must not be 0: errors are relative")
    return made


@dataclass(frozen=True, eq=False)
class SamplingError(Record, listed=False):
    """Errors of estimates from samples, and of the control that is computed with them.

    Calling it with ``(key, size, method)`` samples x0, xf and A, ``size[-1]`` realizations each,
    fuses every prefix, and computes ``u = B^+ (xf_hat - A_hat x0_hat)``. It returns the errors
    relative to the norms of the exact values, (k,) each, of "x0", "xf", "A", "control" (from the
    exact one, v) and "state" (of ``B u`` from ``B v``, relative to the state that v reaches). Where
    the exact value is 0, they are left out.

    Attributes
    ----------
    system : System
    x0, xf : ndarray, shape (n,)
    tol : float
    """

    system: System
    x0: Floats
    xf: Floats
    tol: float

    @property
    def units(self) -> dict[str, str]:
        """Of its numbers."""
        return dict.fromkeys((*self.norms(), "size"), PURE)

    @cached_property
    def _best(self) -> Best:
        return best_control(self.system.A, self.system.B, self.x0, self.xf)

    def norms(self) -> dict[str, float]:
        """What the errors are relative to.

        Returns
        -------
        dict of str to float
        """
        exact = {"x0": self.x0, "xf": self.xf, "A": self.system.A}
        values = {**exact, "control": self._best.u, "state": self._best.reached}
        found = {name: norm(value) for name, value in values.items()}
        return {name: value for name, value in found.items() if value}

    def __call__(self, key: Key, size: ArrayLike, method: Method) -> dict[str, Floats]:
        """Return the relative errors of one replicate."""
        sizes = np.atleast_1d(np.asarray(size))
        estimates: dict[str, Floats] = {}
        errors: dict[str, Floats] = {}
        for name, target in (("x0", self.x0), ("xf", self.xf), ("A", self.system.A)):
            drawn = sample(target, int(sizes[-1]), rng=key.child(name))
            path = fuse_path(drawn, sizes, method, target=target, tol=self.tol, estimates=True)
            assert path.estimates is not None  # estimates=True
            estimates[name], errors[name] = path.estimates, path.errors
        # u = B^+ (xf_hat - A_hat x0_hat)
        drift = np.einsum("kij,kj->ki", estimates["A"], estimates["x0"])
        off = (estimates["xf"] - drift) @ self._best.factors.inverse.T - self._best.u
        errors["control"] = np.linalg.norm(off, axis=1)
        errors["state"] = np.linalg.norm(off @ self.system.B.T, axis=1)
        return {name: errors[name] / norm for name, norm in self.norms().items()}
