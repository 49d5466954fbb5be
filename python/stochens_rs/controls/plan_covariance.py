"""The covariance of a plan, over draws of the realizations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._base import validation
from .._base.types import QUANTITIES, Floats
from ..exceptions import InputError
from ..theory import moments
from .provenance import Basis

if TYPE_CHECKING:
    from .._base.types import Fusion, Quantity


def plan_covariance(basis: Basis, steps: int, fusion: Fusion, quantity: Quantity) -> Floats:
    """Compute the covariance of the last state or of the control (see `Plan.covariance`)."""
    of_control = validation.choice("quantity", quantity, QUANTITIES) == "control"
    for entity in basis.entities:
        if entity.kind == "fitted":
            raise InputError(
                f"no formula is known for the covariance: the weights of `{entity.name}` depend "
                "on the realizations"
            )
    schemes = {entity.kind for entity in basis.entities} - {"exact"}
    if len(schemes) > 1:
        raise InputError(
            "no formula is known for the covariance of iid and systematic samples together"
        )
    x0, xf, A = basis.values
    if steps == 1:
        covariance = moments.control_covariance if of_control else moments.state_covariance
        return covariance(
            (A, basis.B),
            x0,
            xf,
            basis.sizes,
            fusion=fusion,
            axis=basis.A.axis,
            scheme="systematic" if "systematic" in schemes else "iid",
        )
    if of_control:
        raise InputError(
            f"`quantity` must be 'state' over {steps} steps, got 'control': the control is not "
            "linear in A, and no formula is known for its covariance"
        )
    if "systematic" in schemes:
        raise InputError(
            f"no formula is known for the covariance over {steps} steps of systematic samples"
        )
    return moments.final_state_covariance(
        (A, basis.B), x0, xf, steps, basis.sizes, axis=basis.A.axis
    )
