"""The sentences of the report: each takes its numbers from the experiments it is given.

The strings are HTML, where a line break is a space.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from ..._base.numbers import ROUNDING

if TYPE_CHECKING:
    from ...studies import Experiment, Panel

_SHOWN = {
    "1": """Relative error of the estimates (a) of the initial state, (b) of the system matrix
        (Frobenius norm), against the number of samples.""",
    "2": """Relative error (a) of the computed control, (b) of the state it leads to, divided by the
        norm of the state that the exact control leads to. Diagonal fusion averages the controls of
        paired realizations, as in the paper; all other curves fuse each entity first.""",
    "3": """Relative error (a) of the computed x(1), (b) of the computed x(2), against the number of
        samples of each entity and step.""",
}
_MARKS = """Thick lines with markers: medians over the replicates; bands: from the 10 % to the 90 %
    quantile; thin lines: replicate 0 alone. Dashed: exact root mean square error of uniform
    weights,
    crosses: the same over the replicates. The median of a skewed error lies below its root mean
    square, and at few samples a rare large error may have occurred in no replicate yet."""


def number(value: float) -> str:
    """Three significant digits."""
    return f"{value:.3g}"


def percent(share: float) -> str:
    """A share as per cent, two significant digits, never rounded to 0 when it is not."""
    return "less than 0.01 %" if 0 < share < 1e-4 else f"{float(f'{100 * share:.2g}'):g} %"


def caption(experiment: Experiment, figure: str) -> str:
    """What a figure shows."""
    curves = [(p, c) for p in experiment.panels if p.figure == figure for c in p.curves]
    zeros = any((curve.errors <= panel.zero_level).any() for panel, curve in curves)
    strip = "Errors that cannot be told from zero are drawn in the shaded strip." if zeros else ""
    return f"<b>Figure {figure}.</b> {_SHOWN[figure]} {_MARKS} {strip}"


def agreements(experiments: Mapping[str, Experiment]) -> list[str]:
    """What the paper says and these runs show as well."""
    power, tracking = experiments.get("power"), experiments.get("tracking")
    texts = []
    if power is not None:
        texts += [_ordered(power, "1a"), _ordered(power, "1b"), _exact(power), _unordered(power)]
    if power is not None and tracking is not None:
        texts.append(_large(power, tracking))
    return [*texts, *map(_moments, experiments.values())]


def deviations(experiments: Mapping[str, Experiment]) -> list[tuple[str, str]]:
    """What the paper says that cannot hold, as (heading, text), with the numbers of these runs."""
    power, tracking = experiments.get("power"), experiments.get("tracking")
    sections = []
    if power is not None:
        sections += [
            ("The origin is not reachable in one step", _reachability(power)),
            ("Lemma 4.4: the closed form has the wrong scale", _closed_form(power)),
            ("Lemma 4.5: SLSE is not always below uniform weights", _ordering(power)),
            ("SLSE does not reach zero", _never_zero(power)),
            ("Algorithm 1: the stopping rule", _stopping(power)),
        ]
    if tracking is not None:
        sections.append(("Section 5.2: two readings of step two", _two_steps(tracking)))
    return sections


def _ordered(power: Experiment, name: str) -> str:
    """Whether the medians of one panel are ordered as in the paper."""
    panel = power.panel(name)
    alse, slse, uniform = (
        float(panel.curve(method).median[-1]) for method in ("alse", "slse", "uniform")
    )
    is_not = "" if alse <= slse <= uniform else " is not reproduced"
    return f"""<b>The order of the methods{is_not} ({panel.quantity}).</b> Median relative error
        at N = {power.settings["samples"]}: ALSE {_or_zero(alse, panel)}, SLSE
        {_or_zero(slse, panel)}, uniform {number(uniform)}."""


def _exact(power: Experiment) -> str:
    """From which size on ALSE has the vector."""
    size = power.facts["zero_from"]["1a"]
    if size is None:
        return f"""<b>ALSE recovers a vector once every non-zero entry has been drawn.</b> Up to
            N = {power.settings["samples"]} this has not yet happened in every replicate; small
            entries are drawn rarely."""
    return f"""<b>ALSE recovers a vector exactly.</b> In each of the {power.replicates}
        replicates its estimate of the initial state is exact to rounding from N = {size} on: as
        soon as every non-zero entry has been drawn once."""


def _unordered(power: Experiment) -> str:
    """The ordering does not carry over to controls and states."""
    control, state = power.facts["ordering"]["2a"], power.facts["ordering"]["2b"]
    return f"""<b>Controls and states need not follow the order of the estimates.</b> ALSE had a
        larger error than SLSE in {percent(control["alse_above_slse"])} of all pairs (replicate,
        size) for the control and in {percent(state["alse_above_slse"])} for the state; SLSE a
        larger one than uniform weights in {percent(control["slse_above_uniform"])} and
        {percent(state["slse_above_uniform"])}."""


def _large(power: Experiment, tracking: Experiment) -> str:
    """Errors in the large system beside those of the small one."""
    small = float(power.panel("2b").curve("uniform").median[-1])
    large = float(tracking.panel("3a").curve("uniform").median[-1])
    needed = tracking.facts["samples_for_ten_percent"]
    return f"""<b>The errors in dimension {tracking.settings["n"]} are
        {"larger" if large > small else "not larger"}.</b> Median relative state error of uniform
        weights after all samples: {number(small)} in the power network (N =
        {power.settings["samples"]}), {number(large)} for x(1) in tracking (N =
        {tracking.settings["samples"]}). The exact second moments say how many samples it takes:
        a relative root mean square error of 10 % in x(1) needs {_thousands(needed["product"])}
        samples of each entity with product fusion and {_thousands(needed["diagonal"])} with
        diagonal fusion."""


def _moments(experiment: Experiment) -> str:
    """Measured against exact mean squares."""
    theory = experiment.facts["theory"]
    title = experiment.title[0].lower() + experiment.title[1:]
    verdict = "follow" if theory["largest_abs_z"] <= 5 else "deviate from"
    return f"""<b>Uniform weights {verdict} their exact moments ({title}).</b> Over
        {theory["comparisons"]} comparisons (curves, and sizes from {theory["smallest_size"]}
        samples on; those along a curve are correlated) the mean square error of the
        {experiment.replicates} replicates differs from the exact value by at most
        {theory["largest_abs_z"]:.2f} standard errors."""


def _reachability(power: Experiment) -> str:
    """What one step can reach, and what the errors are therefore compared with."""
    reach = power.facts["reachability"]
    return f"""B has rank {reach["rank"]} in dimension {power.settings["n"]}, so one step moves
        the state within a subspace only. The exact least-squares control leaves
        {percent(reach["relative"])} of ‖x<sub>f</sub> − A x<sub>0</sub>‖ uncovered. No average
        of sampled controls can do better, and an error relative to the target zero does not
        exist. Figure 2(b) therefore compares with x<sub>actual</sub> = A x<sub>0</sub> + B v*,
        the state the exact control leads to; the distance to the target follows by Pythagoras:
        ‖x − x<sub>f</sub>‖² = ‖x − x<sub>actual</sub>‖² + ‖x<sub>actual</sub> − x<sub>f</sub>‖²."""


def _closed_form(power: Experiment) -> str:
    """Lemma 4.4, with two examples one can check by hand."""
    case = power.facts["counterexamples"]["closed_form"]
    one = power.facts["counterexamples"]["one_sample"]
    solves = power.facts["alse"]["A"]
    return f"""For w = (3, 4) with each entry drawn once, the printed weights
        |w<sub>k</sub>|/n<sub>k</sub> sum to {number(case["printed_sum"])} instead of 1 and leave
        the squared error {number(case["printed"])}; divided by γ(w) they leave
        {_or_zero(case["corrected"])}. While entries are missing, the simplex forces their weight
        onto the entries seen: for w = (1, 1) and one draw the minimum is {number(one["true"])},
        where the printed proof gives {number(one["claimed"])}. ALSE here is the corrected
        minimizer; for matrices it is a quadratic program whose duality gap is recomputed from
        the data, at worst {number(solves["worst_relative_gap"])} of ‖A‖² over {solves["solves"]}
        solves."""


def _ordering(power: Experiment) -> str:
    """Lemma 4.5, second inequality: false pathwise, true in the mean square."""
    three = power.facts["counterexamples"]["ordering"]
    x0, A = power.facts["ordering"]["1a"], power.facts["ordering"]["1b"]
    ratio = power.facts["slse_mean_square_over_bound"]
    return f"""Three realizations of the matrix with rows (1, 1) and (2, 2) average to it exactly
        (squared error {_or_zero(three["uniform"])}), while SLSE, which takes them one by one,
        ends at {number(three["slse"])}. In these runs SLSE was worse than uniform weights in
        {percent(x0["slse_above_uniform"])} of all pairs (replicate, size) for x<sub>0</sub> and
        in {percent(A["slse_above_uniform"])} for A. What holds is the statement in the mean
        square, E d<sub>N</sub>² ≤ V/N: over all sizes from 2 on, the mean square of SLSE was at
        most {number(ratio["1a"])} (x<sub>0</sub>) and {number(ratio["1b"])} (A) times the exact
        one of uniform weights; values slightly above 1 are chance. Safeguarded SLSE (one more
        line search, towards the plain mean) makes the printed inequality true: it was worse in
        {percent(x0["safeguarded_above_uniform"])} and {percent(A["safeguarded_above_uniform"])}.
        ALSE was above SLSE in {percent(x0["alse_above_slse"])} and
        {percent(A["alse_above_slse"])}."""


def _never_zero(power: Experiment) -> str:
    """The remark on zero error with SLSE."""
    return f"""The paper reports zero relative error of x<sub>0</sub> for ALSE and for SLSE. SLSE
        converges geometrically, but from three dimensions on it meets zero exactly for special
        vectors only: the smallest of its {power.replicates} relative errors at N =
        {power.settings["samples"]} was {number(power.facts["smallest_slse_error"]["1a"])}."""


def _stopping(power: Experiment) -> str:
    """Algorithm 1, followed on the x0 slot."""
    rule = power.facts["stopping_rule"]
    flaw = """Its test measures the last change of the control. A sample that does not help gets
        weight 0, the change is 0, and the loop ends for every error bound, however small.
        Followed on the samples of x<sub>0</sub> alone,"""
    if rule["median_stop"] is None:
        return f"{flaw} no run met such a sample."
    return f"""{flaw} {percent(rule["stopped"])} of the runs met such a sample; at the first one
        the median number of samples was {rule["median_stop"]:g} and the median relative error of
        x<sub>0</sub> still {number(rule["median_relative_error"])}. The printed update has a
        second flaw: it combines with the previous raw sample instead of the fused estimate, so
        that its weights never shrink. A sound rule stops on a bound of the error itself, which
        the algorithm can compute because it is given x<sub>0</sub>, x<sub>f</sub> and A."""


def _two_steps(tracking: Experiment) -> str:
    """Rolled or from the reference."""
    s = tracking.settings
    main, other = tracking.panel("3b"), tracking.panel("3b-alternative")
    rolled, reference = (
        (main, other) if tracking.settings["step_two"] == "rolled" else (other, main)
    )
    first, second = tracking.facts["reachability"]
    return f"""The paper prints A as an n × m matrix; it must be n × n (here {s["n"]} × {s["n"]},
        Gaussian, spectral radius {s["spectral_radius"]:g}). It does not say whether the computed
        x(2) starts from the computed x(1) or from the reference. After all samples the median
        relative error of uniform weights is {number(float(rolled.curve("uniform").median[-1]))}
        when rolled on and {number(float(reference.curve("uniform").median[-1]))} from the
        reference. Neither reference state is reachable: {percent(first["relative"])} and
        {percent(second["relative"])} of the required change lie outside the range of B, so both
        are compared with what the exact controls reach. The paper pairs the realizations
        (diagonal fusion); fusing each entity first has never a larger mean square error."""


def _or_zero(value: float, panel: Panel | None = None) -> str:
    """A number, or zero with the reason why it counts as zero."""
    if value == 0:
        return "0"
    level, label = (
        (ROUNDING**2, "zero to rounding") if panel is None else (panel.zero_level, panel.zero_label)
    )
    return label if value <= level else number(value)


def _thousands(count: int) -> str:
    return f"{count:,}".replace(",", "&thinsp;")
