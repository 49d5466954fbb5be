"""`fuse_path`: the errors of the fusion of prefixes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import memory, validation
from .._base.types import Floats, Status
from ..ensembles.ensemble import Ensemble
from . import alse
from .alse import WeightSet
from .fits import Path
from .fusing import Method, checked_ensemble, checked_goal

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def fuse_path(
    ensemble: Ensemble,
    sizes: ArrayLike,
    method: Method = "uniform",
    *,
    target: ArrayLike,
    weight_set: WeightSet = "simplex",
    tol: float = 1e-9,
    time_limit: float | None = None,
    max_iter: int | None = None,
    estimates: bool = False,
) -> Path:
    """Compute the error of the fusion of the first k realizations, for several k.

    Parameters
    ----------
    ensemble : Ensemble
        N realizations.
    sizes : array_like of int, shape (k,)
        Strictly increasing, from 1 to N.
    method, weight_set, tol, max_iter
        As in `fuse`; `max_iter` is per size.
    time_limit : float, optional
        As in `fuse`, for all sizes together [s]. The sizes after the limit keep the weights of
        the last solved size (dense ensembles: of a solve without iterations) and have status
        "user_limit"; after Ctrl-C, "interrupted".
    target : array_like, shape of a realization
        The vector or matrix that the errors are measured against and the least-squares methods
        fit to.
    estimates : bool, default False
        Whether to keep the estimates.

    Returns
    -------
    Path
        Errors, statuses and gaps, and the estimates if ``estimates=True``.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    SolverError
        If the solver cannot solve a problem.

    Notes
    -----
    All but ALSE of matrices and of dense ensembles take one pass over the realizations. ALSE of
    matrices is solved for every size, starting from the last solution where that is faster; that of
    dense ensembles is solved for every size separately.

    Examples
    --------
    >>> import stochens_rs as se
    >>> A = [[0.9, 0.2], [-0.1, 0.8]]
    >>> path = se.fuse_path(se.sample(A, 1000, rng=1), [10, 100, 1000], "slse", target=A)
    >>> bool(path.errors[0] > path.errors[2])
    True
    """
    ensemble, name = checked_ensemble(ensemble, method)
    options = alse.checked_options(ensemble, name, weight_set, tol, time_limit, max_iter)
    grid = validation.sizes("sizes", sizes, maximum=ensemble.size)
    goal = checked_goal(ensemble, target, name)
    estimates = validation.flag("estimates", estimates)
    if estimates:
        # as the core returns them, transposed, and in the shape of the target
        memory.need("the estimates of a path", 3 * grid.size * goal.nbytes)
    counts: list[int] = grid.tolist()
    draws, gaps = ensemble._draws, None
    completed: Status = "completed"
    statuses = (completed,) * grid.size
    if name != "alse":
        _, _, errors, stack = _core.fuse_path(
            ensemble._core_realizations(), ensemble._lines_of(goal), name, counts, estimates
        )
    elif draws is not None:
        errors, gaps, statuses, stack = alse.path(ensemble, draws, goal, options, counts, estimates)
    else:
        errors, gaps, statuses, stack = _one_by_one(ensemble, goal, options, counts)
    kept = ensemble._stack_from_core(stack) if estimates else None
    return Path(grid, errors, name, statuses, gaps, kept)


def _one_by_one(
    ensemble: Ensemble, goal: Floats, options: alse.AlseOptions, sizes: list[int]
) -> tuple[Floats, Floats, tuple[Status, ...], Floats]:
    """ALSE of every prefix separately, all within one time limit."""
    clock, interrupted = alse.Clock(options), False
    fits = []
    for k in sizes:
        fit = alse.solve(ensemble.prefix(k), goal, clock.left())
        if interrupted and fit.status == "user_limit":
            fit = replace(fit, status="interrupted")
        elif fit.status == "interrupted":
            interrupted = True
            clock.end()
        fits.append(fit)
    errors, gaps = (np.array([getattr(fit, name) for fit in fits]) for name in ("error", "gap"))
    stack = np.stack([fit.estimate.ravel() for fit in fits])
    return errors, gaps, tuple(fit.status for fit in fits), stack
