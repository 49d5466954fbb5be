"""Small exact counterexamples to statements of the paper, computed with the library itself.

Each is short enough to check by hand. They stand beside the experiments because the report quotes
them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._base.numbers import ROUNDING
from ...ensembles.ensemble import Ensemble
from ...ensembles.sampling import sample
from ...fusion.fusing import fuse, fuse_path
from ...rng import Key


def counterexamples() -> dict[str, Any]:
    """Lemma 4.4 (the closed form's scale) and Lemma 4.5 (its second inequality), in numbers.

    Returns
    -------
    dict
        "closed_form": ``w = (3, 4)``, each atom drawn once. The printed weights ``|w_k| / n_k``
        sum to 7 and give ``||S y - w||^2 = 900``; the weights ``|w_k| / (gamma n_k)`` give 0.
        "one_sample": ``w = (1, 1)``, one draw. Weights on the simplex cannot do better than 2;
        the proof's minimum, the sum over unseen components, is 1. "ordering": three realizations
        of ``[[1, 1], [2, 2]]`` whose plain mean is exact while SLSE, which looks at them one by
        one, ends at the squared error 1/5.

    Examples
    --------
    >>> from stochens_rs.paper import counterexamples
    >>> round(counterexamples()["closed_form"]["printed"])
    900
    """
    w = np.array([3.0, 4.0])
    S = np.array([[7.0, 0.0], [0.0, 7.0]])  # row s is the sample s: gamma = 7
    printed = np.abs(w)  # n_k = 1
    closed = fuse(Ensemble.from_samples(S), "alse", target=w)

    ones = np.array([1.0, 1.0])
    one = fuse(Ensemble.from_samples(np.array([[2.0, 0.0]])), "alse", target=ones)

    A = np.array([[1.0, 1.0], [2.0, 2.0]])
    three = Ensemble.from_samples(
        np.array([[[0.0, 0.0], [3.0, 3.0]], [[3.0, 0.0], [0.0, 3.0]], [[0.0, 3.0], [3.0, 0.0]]])
    )
    ordered = {
        method: _square(fuse(three, method, target=A).error)
        for method in ("uniform", "slse", "slse-safeguarded", "alse")
    }
    return {
        "closed_form": {
            "printed_sum": float(printed.sum()),
            "printed": float(np.sum((printed @ S - w) ** 2)),
            "corrected": _square(closed.error),
        },
        "one_sample": {"claimed": 1.0, "true": _square(one.error)},
        "ordering": ordered,
    }


def printed_stopping_rule(x0: NDArray[np.float64], keys: list[Key], steps: int) -> dict[str, Any]:
    """Where Algorithm 1's printed test would stop while it refines x0, and how far off it is then.

    The printed ``error = ||(w1 - 1) v + w2 v'||`` is the length of the last change. A sample that
    does not help gets weight 0, the change is 0, and the loop ends for every positive error
    bound. For each key the SLSE estimate of x0 is followed until its first step without a change.

    Parameters
    ----------
    x0 : (n,) array
        The vector that is refined.
    keys : list of Key
        One run per key; samples of x0 are drawn from it.
    steps : int
        Longest run.

    Returns
    -------
    dict
        "median_stop" (number of samples), "median_relative_error" at that moment, "stopped"
        (share of the runs that met such a step within `steps` samples).
    """
    sizes = np.arange(1, steps + 1)
    norm = float(np.linalg.norm(x0))
    stops, errors = [], []
    for key in keys:
        path = fuse_path(sample(x0, steps, rng=key), sizes, "slse", target=x0, estimates=True)
        assert path.estimates is not None  # estimates=True
        change = np.linalg.norm(np.diff(path.estimates, axis=0), axis=1)
        still = np.flatnonzero(change <= ROUNDING * norm)
        if still.size:
            stop = int(still[0]) + 1  # index of the size whose step changed nothing
            stops.append(int(sizes[stop]))
            errors.append(float(path.errors[stop]) / norm)
    return {
        "stopped": len(stops) / len(keys),
        "median_stop": float(np.median(stops)) if stops else None,
        "median_relative_error": float(np.median(errors)) if errors else None,
    }


def _square(error: float | None) -> float:
    assert error is not None  # a target was given
    return error**2
