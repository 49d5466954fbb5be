"""A study of the errors that sampling causes, against the sample size."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..._base import validation
from ..._base.numbers import norm
from ..._base.types import Floats
from ...ensembles.sampling import sample
from ...exceptions import InputError
from ...fusion.fusing import Method, fuse_path
from ...rng import Key
from ...theory.dynamics import checked_ends
from ...theory.exact import best_control
from .template import Template, template


def error(system: Any, x0: ArrayLike, xf: ArrayLike, *, tol: float = 1e-9) -> Template:
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
    Template
        ``function(key, size, method)``, for a grid of "size" (nested) and "method" (as in `fuse`;
        shared, so that all methods see the same samples). It samples x0, xf and A, ``size[-1]``
        realizations each, fuses every prefix, and computes ``u = B^+ (xf_hat - A_hat x0_hat)``. It
        returns the errors relative to the norms of the exact values, (k,) each, of "x0", "xf", "A",
        "control" (from the exact one, v) and "state" (of ``B u`` from ``B v``, relative to the
        state that v reaches). Where the exact value is 0, they are left out.

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
    tol = validation.positive("tol", tol)
    best = best_control(known.A, known.B, start, goal)
    exact = {"x0": start, "xf": goal, "A": known.A, "control": best.u, "state": best.reached}
    # what the errors are relative to
    norms = {name: size for name, value in exact.items() if (size := norm(value))}
    if not norms:
        raise InputError("one of `system`, `x0` and `xf` must not be 0: errors are relative")
    return template(
        _numbers,
        ("size", "method"),
        (*norms, "size"),
        {},
        B=known.B,
        inverse=best.factors.inverse,
        exact=exact,
        norms=norms,
        tol=tol,
    )


def _numbers(
    key: Key,
    *,
    size: ArrayLike,
    method: Method,
    B: Floats,
    inverse: Floats,
    exact: dict[str, Floats],
    norms: dict[str, float],
    tol: float,
) -> dict[str, Floats]:
    sizes = np.atleast_1d(np.asarray(size))
    estimates: dict[str, Floats] = {}
    errors: dict[str, Floats] = {}
    for name in ("x0", "xf", "A"):
        target = exact[name]
        drawn = sample(target, int(sizes[-1]), rng=key.child(name))
        path = fuse_path(drawn, sizes, method, target=target, tol=tol, estimates=True)
        assert path.estimates is not None  # estimates=True
        estimates[name], errors[name] = path.estimates, path.errors
    # u = B^+ (xf_hat - A_hat x0_hat)
    drift = np.einsum("kij,kj->ki", estimates["A"], estimates["x0"])
    off = (estimates["xf"] - drift) @ inverse.T - exact["control"]
    errors["control"] = np.linalg.norm(off, axis=1)
    errors["state"] = np.linalg.norm(off @ B.T, axis=1)
    return {name: errors[name] / norm for name, norm in norms.items()}
