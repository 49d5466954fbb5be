r"""Exact errors of tracking a reference with a fresh estimate of ``A`` in every step.

With ``P = B B^+``, the reference ``r(k)``, ``e = x - r`` and ``D_k = A_hat_k - A``, where
``A_hat_k`` averages N realizations drawn for step k alone:

- feedback, ``u(k) = B^+ (r(k+1) - A_hat_k x(k))``:
  ``e(k+1) = (I - P) A e(k) + d(k) - P D_k x(k)``;
- no feedback, ``u(k) = B^+ (r(k+1) - A_hat_k r(k))``, section 5.2 of the paper:
  ``e(k+1) = A e(k) + d(k) - P D_k r(k)``.

``d(k) = (I - P)(A r(k) - r(k+1))`` is what no control can do; it is 0 for a *feasible* reference.
With feedback an error is forgotten as far as the controls reach; without, it is carried on by
``A``, so that errors accumulate. Means and second moments of both are exact recursions.
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
