r"""Exact second moments of realizations, of their averages and of the controls they give.

Notation. ``w`` (n,) is a vector, ``g = ||w||_1``. One realization is ``w^s = g sign(w_I) e_I``
with ``P(I = i) = |w_i| / g``; it has mean ``w``. A matrix ``A`` (n, m) is sampled line by line,
independently: ``axis="columns"`` (the default) draws one entry of every column ``a_j``, with
``g_j = ||a_j||_1``; ``axis="rows"`` one entry of every row, with ``rho_i = ||row i||_1``. An
estimate is the average of ``size`` independent realizations (or of systematic samples, where a
function says so); ``size`` None (or inf) stands for an entity that is known exactly. A line of
zeros is always exact: its realizations are 0.

Everything follows from two facts, the covariance of one realization of a vector and that of
one column:

``Cv(w) = g diag|w| - w w^T``,
``E[A^s M A^sT] = A M A^T + T_A(diag M)`` with ``T_A(d) = sum_j d_j Cv(a_j)``.

All results are exact for every ``size``, except :func:`final_state_covariance`, the limit for large
N over several steps. Variances are computed from sums of nonnegative terms, hence without
cancellation: ``g - |w_i| = sum_{k != i} |w_k|``, and for the product of a line and a vector x
``sum_{j<k} |a_j| |a_k| (s_j x_j - s_k x_k)^2``, s the signs of a.

These are the exact values of the variances that Lemmas 4.2 and 4.3 of the paper bound.
"""

from .errors import (
    control_covariance,
    control_rms,
    final_state_covariance,
    matrix_covariance,
    matrix_mse,
    product_covariance,
    realization_control_covariance,
    second_moment,
    state_covariance,
    state_rms,
    systematic_covariance,
    systematic_mse,
    transition,
    vector_covariance,
    vector_mse,
)
from .trajectories import trajectory_covariance, trajectory_mean, trajectory_rms

__all__ = [
    "control_covariance",
    "control_rms",
    "final_state_covariance",
    "matrix_covariance",
    "matrix_mse",
    "product_covariance",
    "realization_control_covariance",
    "second_moment",
    "state_covariance",
    "state_rms",
    "systematic_covariance",
    "systematic_mse",
    "trajectory_covariance",
    "trajectory_mean",
    "trajectory_rms",
    "transition",
    "vector_covariance",
    "vector_mse",
]
