r"""Exact errors of tracking a reference with a new estimate of ``A`` in every step.

With ``P = B B^+``, the reference ``r(k)``, ``e = x - r`` and ``D_k = A_hat_k - A``, where
``A_hat_k`` averages N realizations drawn for step k alone:

- feedback, ``u(k) = B^+ (r(k+1) - A_hat_k x(k))``:
  ``e(k+1) = (I - P) A e(k) + d(k) - P D_k x(k)``;
- no feedback, ``u(k) = B^+ (r(k+1) - A_hat_k r(k))``, section 5.2 of the paper:
  ``e(k+1) = A e(k) + d(k) - P D_k r(k)``.

``d(k) = (I - P)(A r(k) - r(k+1))`` is out of reach of any control; it is 0 for a *feasible*
reference. With feedback each step removes the part of the error that the controls reach; without,
errors accumulate by ``A``. Means and second moments of both follow exact recursions.
"""

from .errors import reference_residuals, tracking_bound, tracking_moments, tracking_rms
from .stability import stability_radius, stability_threshold

__all__ = [
    "reference_residuals",
    "stability_radius",
    "stability_threshold",
    "tracking_bound",
    "tracking_moments",
    "tracking_rms",
]
