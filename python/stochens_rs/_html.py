"""What a notebook shows of a record: its repr as a title, a small table, a line drawing.

Colours come from the page, so that a dark one stays readable; what is drawn has the middle tones of
Okabe and Ito's palette. No scripts, no style sheets: nothing outside the fragment changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .closed_loop import Tracking
    from .data_streaming import DataStream
    from .ensembles import Ensemble
    from .planning import SamplePlan
    from .results import Fit, Path, Plan, PlanBound, PlanError
    from .stream_records import Confidence, Trace
    from .streaming import Stream
    from .system import System
    from .theory.bounds import Bound
    from .trajectories import EnsembleTrajectory, Trajectory
    from .trajectory_plans import TrajectoryPlan

    Floats = NDArray[np.float64]

Rows = Iterable[tuple[str, object]]

# What a relative error is relative to, by the names of `PlanError`.
RELATIVE_TO = {
    "x_actual": "the state that the exact control leads to",
    "x0": "x0, as the exact control leads to the origin",
    "v": "the exact control",
    "B^+ A x0": "the control that takes x0 to the origin, as the exact one is zero",
}

_COLORS = ("#3b8fd4", "#e0701a", "#1fa37a", "#c78a00", "#b56b99", "#888888")
_WIDTH, _HEIGHT, _POINTS = 240, 56, 120
_TABLE = "border:0;border-collapse:collapse;margin:3px 0;font-variant-numeric:tabular-nums"
_CELL = "border:0;padding:1px 14px 1px 0;vertical-align:top;text-align:{}"


def system(shown: System) -> str:
    """Sizes and step length."""
    dt = f"{shown.dt} s" if isinstance(shown.dt, float) else str(shown.dt)
    return _card(shown, [("states n", shown.n), ("inputs m", shown.m), ("step dt", dt)])


def ensemble(shown: Ensemble) -> str:
    """What the realizations are."""
    rows = [
        ("realizations N", _grouped(shown.size)),
        ("shape of each", _shape(shown.shape)),
        ("entries kept", _kept(shown)),
        ("drawn here", shown.scheme or "no"),
    ]
    return _card(shown, rows)


def _kept(shown: Ensemble) -> str:
    if not shown.is_singleton:
        return "all"
    return "one" if len(shown.shape) == 1 else f"one in each of the {shown.axis}"


def fit(shown: Fit) -> str:
    """How near the estimate is, and how well that is known."""
    rows = [
        ("realizations N", _grouped(len(shown.weights))),
        ("shape", _shape(shown.shape)),
        ("distance to the target", shown.error),
        ("no weights come nearer than", shown.lower_bound),
        ("gap of the squared distance", shown.gap),
        ("entries never seen", shown.unseen or None),
    ]
    return _card(shown, rows)


def path(shown: Path) -> str:
    """The error over the sizes."""
    first, last = (_grouped(int(shown.sizes[k])) for k in (0, -1))
    rows = [
        ("realizations N", f"{first} to {last}, {len(shown.sizes)} sizes"),
        ("error", f"{shown.errors[0]:.4g} at the first, {shown.errors[-1]:.4g} at the last"),
    ]
    text = "error over N, both logarithmic"
    return _card(shown, rows, _lines(shown.sizes, [shown.errors], text, log=True))


def plan(shown: Plan) -> str:
    """The control, and what it comes from."""
    return _card(shown, [("control u", _vector(shown.u)), *_made_from(shown)])


def trajectory_plan(shown: TrajectoryPlan) -> str:
    """The same over several steps, with the states of the model."""
    warnings = [("warning", text) for text in shown.info.get("warnings", ())]
    steps = np.arange(shown.steps + 1)
    drawn = _states(steps, shown.predicted_states, "states of the model over the steps")
    return _card(shown, [*_made_from(shown), *warnings], drawn)


def trajectory(shown: Trajectory) -> str:
    """From where to where, and how."""
    rows = [
        ("steps", _duration(shown.steps, shown.dt)),
        _ends(shown.states),
        _largest(shown.inputs),
    ]
    return _card(shown, rows, _states(shown.times, shown.states, "states over time"))


def ensemble_trajectory(shown: EnsembleTrajectory) -> str:
    """The mean, how well it is known, and how it was obtained."""
    error = shown.standard_error
    rows = [
        ("steps", _duration(shown.steps, shown.dt)),
        ("trajectories", _grouped(shown.replicates)),
        ("realizations N per step", _grouped(shown.size)),
        ("drawn", ", ".join(shown.sampled)),
        _ends(shown.mean, "mean state"),
        ("standard error at the end", None if error is None else f"at most {error[-1].max():.4g}"),
    ]
    return _card(shown, rows, _states(shown.times, shown.mean, "mean states over time"))


def tracking(shown: Tracking) -> str:
    """How far from the reference, and what no control could have done."""
    distance = np.sqrt(shown.mean_square)
    rows = [
        ("steps", _grouped(len(shown.residuals))),
        ("realizations N per step", _grouped(shown.info["size"])),
        ("replicates", shown.info["replicates"]),
        ("off by (rms)", f"{distance[-1]:.4g} at the end, {distance.max():.4g} at most"),
        ("out of reach in one step", f"{shown.residuals.max():.4g} at most"),
    ]
    text = "distance from the reference (rms) over the steps"
    return _card(shown, rows, _lines(np.arange(len(distance)), [distance], text))


def stream(shown: Stream) -> str:
    """How far it is, and how near."""
    rows = [
        ("steps", _grouped(shown.steps)),
        ("realizations", _counts(shown.counts)),
        ("state off by", shown.error),
        ("certified", shown.certificate),
        ("control u", _vector(shown.u)),
    ]
    return _card(shown, rows, _errors(shown.trace))


def trace(shown: Trace) -> str:
    """The curve of the errors."""
    return _card(shown, [], _errors(shown))


def data_stream(shown: DataStream) -> str:
    """What has come in, and the control where there is one."""
    counts = shown.counts
    known = all(counts.values())
    rows = [
        ("realizations", _counts(counts)),
        ("control u", _vector(shown.u) if known else "none: an entity has no realization"),
        ("certified", shown.certificate if known else None),
    ]
    return _card(shown, rows)


def sample_plan(shown: SamplePlan) -> str:
    """One row per bound, as in the text."""
    head = ("bound", "N", "exact rms", "quantile", "failures")
    body = [
        (
            one.name,
            "more than 2^53" if one.size is None else _grouped(one.size),
            _text(one.rms),
            _text(one.quantile),
            "" if one.failures is None else f"{one.failures} of {shown.runs}",
        )
        for one in shown.rows
    ]
    size = shown.rows[0].size
    rows = [
        ("enough", "nothing up to 2^53" if size is None else f"N = {_grouped(size)}"),
        (f"error of the {shown.quantity}", shown._limit),
        ("with probability", f"{1.0 - shown.delta:g}"),
        ("fusion", shown.fusion),
        *(
            []
            if shown.expected_size is None
            else [("no guarantee, exact rms", f"N = {_grouped(shown.expected_size)}")]
        ),
        ("no guarantee, simulated", f"N = {_grouped(shown.simulated_size)}"),
    ]
    return _card(shown, rows, _grid(head, body))


def bound(shown: Bound) -> str:
    """What is bounded, and by what."""
    return _card(shown, [("inequality", shown.name), ("from", shown.source)])


def plan_bound(shown: PlanBound) -> str:
    """What each radius is measured from, and over what it holds."""
    rows = [
        (
            "state",
            f"within {shown.state:.4g} of where the exact control leads ({shown.state_bound}), "
            f"within {shown.target:.4g} of xf",
        ),
        ("control", f"within {shown.control:.4g} of the exact one ({shown.control_bound})"),
        ("holds", shown.covers),
    ]
    return _card(shown, rows)


def plan_error(shown: PlanError) -> str:
    """How far off, and of what that is a share."""
    rows = [
        (
            "control off by",
            _share(shown.control, shown.control_relative, shown.control_relative_to),
        ),
        ("state off by", _share(shown.state, shown.state_relative, shown.state_relative_to)),
        ("out of reach of any control", shown.residual),
        (
            "rounding",
            f"{shown.control_rounding:.1g} of the control, {shown.state_rounding:.1g} of the state "
            "at most",
        ),
    ]
    return _card(shown, rows)


def _share(value: float, relative: float, relative_to: str) -> str:
    words = RELATIVE_TO.get(relative_to)
    share = "" if words is None else f" ({100 * relative:.3g} % of the norm of {words})"
    return f"{value:.4g}{share}"


def confidence(shown: Confidence) -> str:
    """Each radius with the bound that gave it."""
    radii = [
        (f"{name} within", f"{getattr(shown, name):.4g} ({shown.bounds[name]})")
        for name in ("x0", "xf", "A")
    ]
    observed = "" if shown.finite_sample else ": an estimate, from the ranges observed so far"
    rows = [
        ("state within", shown.state),
        *radii,
        ("all of them", f"with probability {100 * (1 - shown.delta):.6g} % at least{observed}"),
        ("of", shown.covers),
        ("infinite, because", shown.reason),
    ]
    return _card(shown, rows)


def counted(steps: int) -> str:
    """``1 step``, ``2 steps``."""
    return "1 step" if steps == 1 else f"{steps} steps"


def record(shown: object) -> str:
    """Every field of a small record, by its name."""
    return _card(shown, [(name.replace("_", " "), value) for name, value in vars(shown).items()])


def _made_from(shown: Plan | TrajectoryPlan) -> Rows:
    """How large the control is, and the realizations behind each entity."""
    yield _largest(shown.u)
    for name in ("x0", "xf", "A"):
        one = shown.info.get(name)
        if one is not None:
            size = "" if one.get("size") is None else f", {_grouped(one['size'])} realizations"
            yield name, f"{one['method']}{size}"


def _largest(inputs: Floats) -> tuple[str, object]:
    return "largest |u|", float(np.abs(inputs).max()) if inputs.size else None


def _ends(states: Floats, what: str = "state") -> tuple[str, object]:
    start, end = np.linalg.norm(states[[0, -1]], axis=1)
    return f"norm of the {what}", f"{start:.4g} at the start, {end:.4g} at the end"


def _shape(shape: tuple[int, ...]) -> str:
    return " × ".join(map(str, shape))


def _duration(steps: int, dt: float | None) -> str:
    return f"{steps}" if dt is None else f"{steps} of {dt:g} s"


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{_grouped(count)} of {name}" for name, count in counts.items())


def _grouped(count: int) -> str:
    return f"{count:,}".replace(",", "\u2009")


def _vector(values: Floats) -> str:
    """At most six entries."""
    some = ", ".join(f"{value:.4g}" for value in values[:6])
    return f"({some}{', …' if len(values) > 6 else ''})"


def _text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _card(shown: object, rows: Rows, below: str = "") -> str:
    """Title line, one row per fact that is known, and what comes below."""
    title = type(shown).__name__
    text = repr(shown)
    about = text[len(title) + 1 : -1].strip(" :") if text.startswith("<") else ""
    label, cell = _CELL.format("left") + ";font-weight:normal;opacity:.75", _CELL.format("left")
    body = "".join(
        f'<tr><th style="{label}">{escape(what)}</th>'
        f'<td style="{cell};overflow-wrap:anywhere">{escape(_text(value))}</td></tr>'
        for what, value in rows
        if value is not None
    )
    table = f'<table style="{_TABLE}"><tbody>{body}</tbody></table>' if body else ""
    return (
        '<div style="max-width:44em;overflow-x:auto;line-height:1.4">'
        f'<div><b>{escape(title)}</b> <span style="opacity:.75">{escape(about)}</span></div>'
        f"{table}{below}</div>"
    )


def _grid(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """A table with a column of names and columns of numbers."""

    def row(tag: str, cells: Sequence[str]) -> str:
        sides = ["left", *["right"] * (len(cells) - 1)]
        return "".join(
            f'<{tag} style="{_CELL.format(side)};white-space:nowrap">{escape(text)}</{tag}>'
            for side, text in zip(sides, cells, strict=True)
        )

    lines = "".join(f"<tr>{row('td', cells)}</tr>" for cells in body)
    return (
        f'<table style="{_TABLE}">'
        f"<thead><tr>{row('th', head)}</tr></thead><tbody>{lines}</tbody></table>"
    )


def _states(times: Floats | NDArray[np.int64], states: Floats, text: str) -> str:
    if states.shape[1] <= len(_COLORS):
        return _lines(times, list(states.T), text)
    with np.errstate(over="ignore", invalid="ignore"):
        order = np.argsort(-np.ptp(states, axis=0), kind="stable")[: len(_COLORS)]
    most = list(states.T[np.sort(order)])
    return _lines(times, most, f"{text}, the {len(most)} that change most")


def _errors(shown: Trace) -> str:
    late = shown.steps > 0
    return _lines(shown.steps[late], [shown.errors[late]], "error over the steps, log", log=True)


def _lines(
    x: Floats | NDArray[np.int64], curves: Sequence[Floats], text: str, *, log: bool = False
) -> str:
    """Curves over a common axis as a small drawing; "" if there is nothing finite to draw."""
    across, heights = np.asarray(x, dtype=np.float64), np.array(curves, dtype=np.float64)
    if log:
        with np.errstate(divide="ignore", invalid="ignore"):
            across, heights = np.log(across), np.log(heights)
    finite = heights[np.isfinite(heights)]
    if len(across) < 2 or not finite.size:
        return ""
    low, high = float(finite.min()), float(finite.max())
    values = (np.exp(low), np.exp(high)) if log else (low, high)
    # halves, because the difference of two floats can overflow
    span = (high / 2 - low / 2) or 1.0
    right = (across - across[0]) / (across[-1] - across[0]) * _WIDTH
    down = _HEIGHT - (heights / 2 - low / 2) / span * _HEIGHT
    chosen = np.unique(np.linspace(0, len(across) - 1, _POINTS).astype(int))
    drawn = "".join(
        f'<polyline fill="none" stroke="{color}" stroke-width="1.5" points="'
        + " ".join(f"{right[k]:.1f},{row[k]:.1f}" for k in chosen if np.isfinite(row[k]))
        + '"/>'
        for color, row in zip(_COLORS, down, strict=False)
    )
    note = f"{text}, from {values[0]:.3g} to {values[1]:.3g}"
    return (
        f'<svg viewBox="-2 -2 {_WIDTH + 4} {_HEIGHT + 4}" width="{_WIDTH + 4}" '
        f'height="{_HEIGHT + 4}" role="img" style="display:block;max-width:100%">'
        f"<title>{escape(note)}</title>{drawn}</svg>"
        f'<div style="opacity:.75;font-size:.9em">{escape(note)}</div>'
    )
