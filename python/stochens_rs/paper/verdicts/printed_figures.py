"""Section 5 of the paper: what its figures show, checked by repeated experiments."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from ...cases import ieee14, random_system
from ...rng import Key
from ...system import System
from ...theory.exact import best_control
from ...theory.moments import state_rms
from ..experiments.power import power
from ..experiments.tracking import tracking
from ..repeating import HERE, Where
from . import section_5_2
from .records import Claim, claim

if TYPE_CHECKING:
    from ...studies import Experiment


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
    text = (
        f"IEEE 14 buses, {small.replicates} replicates, N = {N}: median relative errors of ALSE, "
        f"SLSE, uniform: x0 {alse}, {_list(errors['1a'][1:])}; A {_list(errors['1b'])}. The "
        f"smallest error of SLSE for x0 is {slse:.1e}, not 0."
    )
    ordered = all(a <= s <= u for a, s, u in errors.values())
    return claim("Figure 1", ("experiment", text, ordered and slse > panel.zero_level))


def _controls(small: Experiment) -> Claim:
    reach = small.facts["reachability"]
    order = small.facts["ordering"]
    curves = [small.panel(panel).curve("uniform") for panel in ("2a", "2b")]
    factors = [float(curve.median[0] / curve.median[-1]) for curve in curves]
    share = order["2a"]["alse_above_slse"], order["2b"]["alse_above_slse"]
    text = (
        f"B has rank {reach['rank']} in dimension {small.settings['n']}: "
        f"{100 * reach['relative']:.3g} % of xf - A x0 is out of reach in one step. ALSE is above "
        f"SLSE in {100 * share[0]:.2g} % (control) and {100 * share[1]:.2g} % (state) of all pairs "
        f"of a replicate and a size. From N = {small.sizes[0]} to {small.sizes[-1]} the "
        f"medians of uniform weights fall by the factors {_list(factors)}."
    )
    confirms = reach["relative"] > 1e-6 and max(share) > 0.0 and min(factors) > 1.0
    return claim("Figure 2", ("experiment", text, confirms))


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
    texts = (
        f"Exact relative root mean square error of the state at N = 1000, paired realizations: "
        f"{min(big):.2g} to {max(big):.2g} for three random systems with n = 100, m = 80; "
        f"{min(small):.2g} to {max(small):.2g} for 20 initial states of the network, {middle:.2g} "
        "in the median of 20 random systems with n = 10, m = 8.",
        f"n = {large.settings['n']}, m = {large.settings['m']}, {large.replicates} replicates: the "
        f"mean squares are at most {theory:.1f} standard errors from the exact ones. For 10 % it "
        f"takes {needed['diagonal']} realizations with paired and {needed['product']} with product "
        "weights.",
    )
    return claim(
        "Figure 3",
        ("exact", texts[0], min(big) > 2.0 * max(*small, middle)),
        ("experiment", texts[1], theory <= 5.0),
    )


def _exact_error(system: System, spread: float, key: Key) -> float:
    """Relative rms error of the state after 1000 paired realizations; the network goes to 0."""
    gen = key.generator()
    x0 = spread * gen.standard_normal(system.n)
    xf = gen.standard_normal(system.n) if spread == 1.0 else np.zeros(system.n)
    rms = state_rms(system, x0, xf, 1000, fusion="diagonal")
    return rms / float(np.linalg.norm(best_control(system.A, system.B, x0, xf).reached))


def _last(experiment: Experiment, panel: str, method: str) -> float:
    return float(experiment.panel(panel).curve(method).median[-1])


def _list(values: list[float]) -> str:
    return ", ".join(f"{value:.2g}" for value in values)
