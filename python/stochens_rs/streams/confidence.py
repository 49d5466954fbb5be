"""Confidence radii of running means that hold for all numbers of realizations at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base.records import trusted
from .._base.threads import interruptible
from ..certificates.certificate import Certificate
from ..certificates.radius import Radius
from ..exceptions import InputError
from ..theory.exact import EPS
from .state import ENTITIES

if TYPE_CHECKING:
    from collections.abc import Mapping


_SUM = "the sum of the errors of the means"


def radii_of_means(
    core: _core.DataStream, ranges: Mapping[str, float], sizes: Mapping[str, int], delta: float
) -> Certificate:
    """Return the radii of the running means and of the state (see `DataStream.confidence`)."""
    counts, deviations, spreads, _ = core.statistics()
    apart, rounding = core.evidence()
    uncertain = sum(ranges.get(name, np.inf) > 0.0 for name in ENTITIES)
    radii, methods = [], []
    for k, name in enumerate(ENTITIES):
        given, size = ranges.get(name), sizes.get(name)
        if given is not None and apart[k] > given:
            raise InputError(
                f"`ranges['{name}']` must bound the distance of any two realizations: there "
                f"are two at least {apart[k]:.6g} apart, got {given:.6g}"
            )
        observed = 2.0 * spreads[k] if counts[k] > 1 else np.inf
        diameter = observed if given is None else given
        share = delta / max(uncertain, 1)
        radius = _core.mean_radius(counts[k], deviations[k], diameter, share, size)
        methods.append(_bound(radius, diameter, given, size))
        radii.append(radius + 2.0 * rounding[k])  # rounding of the mean and of the deviation
    x0, _, A = core.estimates()
    r0, rf, rA = radii
    norm = interruptible(lambda: float(np.linalg.norm(A, 2)))
    # r_f + (||FA|| + r_A) r_0 + r_A ||F0||, where inf * 0 counts as 0
    parts = [(norm + rA, r0), (rA, float(np.linalg.norm(x0)))]
    state = rf + sum(a * b if a != 0.0 and b != 0.0 else 0.0 for a, b in parts)
    # the control in doubles, and rounding of norms and sums
    state += core.control()[1] + len(x0) * 4.0 * EPS * state
    if np.isnan(state):
        state = np.inf
    single = [name for name, r in zip(ENTITIES, radii, strict=True) if not np.isfinite(r)]
    reason = "the radius of the state overflows"
    if single:
        reason = f"only one realization of {', '.join(single)}, and `ranges` does not bound it"
    said = [("state", state, "where the control from the exact means leads", _SUM)]
    means = (f"the mean of the law of {name}" for name in ENTITIES)
    said += zip(ENTITIES, radii, means, methods, strict=True)
    return trusted(
        Certificate,
        kind="guaranteed" if len(ranges) == len(ENTITIES) else "estimated",
        delta=delta,
        quantities={
            name: Radius._at(radius, mean, delta, method, reason)
            for name, radius, mean, method in said
        },
        covers="all together, at all numbers of realizations at once",
        assumption="realizations of each entity independent, of one law, within its range; a bias "
        "of the realizations is not covered",
    )


def _bound(radius: float, diameter: float, given: float | None, size: int | None) -> str:
    """Say which bound gives the radius."""
    if diameter == np.inf:
        return "none"
    source = "observed range, an estimate" if given is None else "given range"
    if radius >= diameter:
        return source
    where = "epochs of sizes" if size is None else f"tightest at {size}"
    return f"empirical Bernstein for all sizes, {where}; {source}"
