"""What a plan shows of itself: where it is expected to end, and what it was made from."""

from __future__ import annotations

from math import hypot, sqrt
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .._base import html
from .._base.numbers import norm
from ..exceptions import StochensError
from ..theory.exact import best_control

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from ..theory.records import Reachability
    from .basis import Basis

    Floats: TypeAlias = NDArray[np.float64]

_EPS = float(np.finfo(np.float64).eps)
# operations that a line of text may cost: some 20 ms
_CHEAP = 1e7


def expectation(
    reach: Reachability,
    basis: Basis | None,
    end: Floats,
    steps: int | None,
    covariance: Callable[[], Floats],
) -> str:
    """Describe how far the model is from reaching its target, and the system from the true one.

    The model ends at `end`. `covariance` is that of the plan: of the control for one step
    (`steps` is None), of the last state for several.
    """
    text = reach_text(reach)
    if basis is None or basis.xf.estimate is None:
        return text
    exact = all(entity.kind == "exact" for entity in basis.entities)
    text += (
        f"; {'' if exact else 'with the estimates: '}ends {norm(basis.xf.estimate - end):.2g} from "
        f"{'' if basis.xf.kind == 'exact' else 'the estimated '}xf"
    )
    rms = _expected(basis, steps, covariance)
    return text if rms is None else f"{text}; true system: about {rms:.2g} from xf (rms)"


def _expected(basis: Basis, steps: int | None, covariance: Callable[[], Floats]) -> float | None:
    """Root mean square distance from xf over the draws; None unknown, without draws, or costly.

    Exact over one step, to leading order in 1 / N over several.
    """
    kinds = {entity.kind for entity in basis.entities}
    (n, m), K = basis.B.shape, steps or 1
    if kinds == {"exact"} or n**4 + K * n * (n * n + K * m) > _CHEAP:
        return None
    try:
        C = covariance()
        if steps is None:
            x0, xf, A = (entity.values for entity in basis.entities)
            assert x0 is not None
            assert xf is not None
            assert A is not None
            missed = norm(best_control(A, basis.B, x0, xf).missed)
            return hypot(sqrt(max(0.0, float(np.trace(basis.B @ C @ basis.B.T)))), missed)
        return sqrt(max(0.0, float(np.trace(C))))
    except StochensError:
        return None


def reach_text(reach: Reachability) -> str:
    """In a few words, for the one line that shows a plan."""
    if not reach.reachable:
        return f"out of reach {100 * reach.relative:.3g} %"
    certain = reach.relative * reach.relative <= _EPS
    return "reachable" if certain else "reachable up to rounding"


def made_from(u: Floats, info: dict[str, Any]) -> Iterator[tuple[str, object]]:
    """How large the control is, and the realizations behind each entity."""
    yield html.largest(u)
    for name in ("x0", "xf", "A"):
        one = info.get(name)
        if one is not None:
            size = "" if one.get("size") is None else f", {html.grouped(one['size'])} realizations"
            yield name, f"{one['method']}{size}"
