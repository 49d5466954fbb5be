"""Section 5 of the paper: what its figures show, checked by repeated experiments."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from stochens_rs import Key, System, control
from stochens_rs.cases import ieee14, random_system
from stochens_rs.theory.moments import state_rms

from ..experiments.power import power
from ..experiments.tracking import tracking
from ..repeating import HERE, Where
from . import section_5_2
from .records import Claim, claim, outcome

if TYPE_CHECKING:
    from ..experiment import Experiment


def section_5(
    key: Key, replicates: int, samples: int, where: Where = HERE
) -> list[Callable[[], Claim]]:
    """One call for each statement; the first that needs one of the two experiments runs it."""

    @cache
    def small() -> Experiment:
        own = key.child("power")
        return power(rng=own, replicates=replicates, samples=samples, **where.of("power"))

    @cache
    def large() -> Experiment:
        own, half, at = key.child("tracking"), max(2, replicates // 2), where.of("tracking")
        return tracking(rng=own, replicates=half, samples=samples, n=40, m=32, **at)

    return [
        lambda: _estimates(small()),
        lambda: _controls(small()),
        lambda: section_5_2.one_step_only(key.child("one step"), where),
        lambda: _states(key.child("states"), large()),
        lambda: section_5_2.ordering(large()),
        section_5_2.computed_states,
    ]


def _estimates(small: Experiment) -> Claim:
    errors = {
        name: [_last(small, name, method) for method in ("alse", "slse", "uniform")]
        for name in ("1a", "1b")
    }
    slse = small.facts["smallest_slse_error"]["1a"]
    N = small.settings["samples"]
    panel = small.panel("1a")
    alse = panel.zero_label if errors["1a"][0] <= panel.zero_level else f"{errors['1a'][0]:.2g}"
    ordered = all(a <= s <= u for a, s, u in errors.values())
    return claim(
        "Figure 1",
        outcome(
            ordered and slse > panel.zero_level,
            small=small,
            N=N,
            alse=alse,
            x0=errors["1a"][1:],
            A=errors["1b"],
            slse=slse,
        ),
    )


def _controls(small: Experiment) -> Claim:
    reach = small.facts["reachability"]
    order = small.facts["ordering"]
    curves = [small.panel(panel).curve("uniform") for panel in ("2a", "2b")]
    factors = [float(curve.median[0] / curve.median[-1]) for curve in curves]
    share = order["2a"]["alse_above_slse"], order["2b"]["alse_above_slse"]
    confirms = reach["relative"] > 1e-6 and max(share) > 0.0 and min(factors) > 1.0
    return claim(
        "Figure 2",
        outcome(
            confirms,
            reach=reach,
            small=small,
            missed=100 * reach["relative"],
            controls=100 * share[0],
            states=100 * share[1],
            last=small.sizes[-1],
            factors=factors,
        ),
    )


def _states(key: Key, large: Experiment) -> Claim:
    small = [_exact_error(ieee14(), 0.1, key.child(f"small {k}")) for k in range(20)]
    big, alike = [], []  # of the same kind, so that only the dimension differs
    for k in range(3):
        system = random_system(100, 80, rng=key.child(f"large {k}"))
        big.append(_exact_error(system, 1.0, key.child(f"states {k}")))
    for k in range(20):
        system = random_system(10, 8, rng=key.child(f"alike {k}"))
        alike.append(_exact_error(system, 1.0, key.child(f"alike states {k}")))
    middle = float(np.median(alike))
    needed = large.facts["samples_for_ten_percent"]
    theory = large.facts["theory"]["largest_abs_z"]
    return claim(
        "Figure 3",
        outcome(
            min(big) > 2.0 * max(*small, middle),
            low=min(big),
            high=max(big),
            small_low=min(small),
            small_high=max(small),
            middle=middle,
        ),
        outcome(theory <= 5.0, large=large, theory=theory, needed=needed),
    )


def _exact_error(system: System, spread: float, key: Key) -> float:
    """Relative rms error of the state after 1000 paired realizations; the network goes to 0."""
    gen = key.generator()
    x0 = spread * gen.standard_normal(system.n)
    xf = gen.standard_normal(system.n) if spread == 1.0 else np.zeros(system.n)
    rms = state_rms(system, x0, xf, 1000, fusion="diagonal")
    reached = system.A @ x0 + system.B @ control(system, x0, xf).u[0]
    return rms / float(np.linalg.norm(reached))


def _last(experiment: Experiment, panel: str, method: str) -> float:
    return float(experiment.panel(panel).curve(method).median[-1])
