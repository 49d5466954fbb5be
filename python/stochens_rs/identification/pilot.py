"""`PilotModel`: the model that simulates the instruments of another one, fixed without its data."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from .. import _core
from .._base import validation
from .._base.records import Record, sizes
from .._base.running import get_num_threads
from .._base.types import Floats
from ..data.trajectories import Trajectories, require_whole, shared_rows
from ..exceptions import InputError, InputTypeError, ShapeError
from ..system.system import System
from ..theory.exact import best_control, states
from .assumptions import Assumptions, Pilot
from .window import Regressors, of_names, rows_of

MOST = 100_000  # steps of a reference


class PilotModel(Record):
    """What repeats the runs of a model on paper, and the plan it has for a task fixed beforehand.

    Attributes
    ----------
    model : ndarray, shape (n, n + m) or (n, n + m + 1)
        ``[A B]`` or ``[A B c]`` of the pilot.
    source : str
        Where it is from, in words.
    gain : ndarray, shape (m, n), or None
        The inputs of the runs were ``u = gain x + dither``; None: they were fixed in open loop.
    dither : ndarray, shape (N, m), or None
        The dither of each pair.
    start : ndarray, shape (n,), or None
        The initial state of the reference task; None without one.
    inputs : ndarray, shape (K, m), or None
        What the pilot would do.
    root : ndarray, shape (n + m, n + m) or with 1 more, or None
        For any feedback a triangle, ``root' root`` the mean square of z in the first runs.
    before : int
        The number of their pairs; 0 otherwise.
    follow : ndarray, shape (m, n), or None
        The feedback that plans will be followed with, by its rule for the pilot.
    """

    model: Annotated[Floats, "state column"]
    source: str
    gain: Annotated[Floats, "input state"] | None = None
    dither: Annotated[Floats, "pair input"] | None = None
    start: Annotated[Floats, "content"] | None = None
    inputs: Annotated[Floats, "step input"] | None = None
    root: Annotated[Floats, "column column"] | None = None
    before: int = 0
    follow: Annotated[Floats, "input content"] | None = None

    def _check(self) -> None:
        found = sizes(self)
        for one, other in (("gain", "dither"), ("start", "inputs")):
            if (getattr(self, one) is None) != (getattr(self, other) is None):
                raise InputError(f"`{one}` and `{other}` must be given both or not at all")
        if self.root is not None:
            return
        columns = found["state"] + found.get("input", found["column"] - found["state"])
        if found["column"] not in (columns, columns + 1):
            raise ShapeError(
                f"`model` must have {columns} columns, or one more, got {found['column']}"
            )

    @property
    def steps(self) -> int:
        """The number of steps of the reference; 0 without one."""
        return 0 if self.inputs is None else len(self.inputs)

    @property
    def said(self) -> str:
        """What is assumed of the runs, in words."""
        how = "in open loop" if self.gain is None else "by the declared gain and dither"
        task = "; reference fixed without the runs of the model" if self.steps else ""
        if self.root is not None:
            return (
                "any design, number and lengths of runs fixed beforehand and in the order of time; "
                f"pilot: {self.source}{task}"
            )
        return (
            "number and lengths of runs fixed beforehand, states exact, starts independent of the "
            f"noise of all runs, inputs {how}; pilot: {self.source}{task}"
        )

    def simulated(self, data: Trajectories, pairs: Floats, m: int) -> _core.Pilot:
        """The model of these runs; `pairs` are theirs, (z, y), and m behind the first n in z."""
        feedback, threads = None, get_num_threads()
        if self.root is not None:
            root = np.ascontiguousarray(self.root)
            given = np.ascontiguousarray(self.model), root, self.before, m, threads
            return _core.Pilot.after(np.ascontiguousarray(pairs), *given)
        if self.gain is not None and self.dither is not None:
            feedback = np.ascontiguousarray(self.gain), np.ascontiguousarray(self.dither)
        rows, model = np.ascontiguousarray(data.rows), np.ascontiguousarray(self.model)
        return _core.Pilot(rows, data.lengths, model, feedback, threads)


def divided(
    data: Trajectories, pilot: Any, offset: bool
) -> tuple[Floats, str, Trajectories, Floats | None]:
    """The model of a pilot, its source in words, the main runs, and the pairs before them."""
    n, d = data.n, data.n + data.m + offset
    if validation.is_real(pilot):
        number: float = np.asarray(pilot).item()
        first = _first(data, number, d)
        runs = data[:first]
        rows = rows_of(of_names(data.state_names, data.input_names, offset), runs)[1]
        model = _core.fit(rows, d, runs.size, get_num_threads()).H
        source = f"runs 0 to {first - 1}, the model is of runs {first} to {len(data) - 1}"
        return np.ascontiguousarray(model), source, data[first:], rows
    if isinstance(pilot, (tuple, System)):
        if isinstance(pilot, tuple) and len(pilot) != 2:
            raise ShapeError(f"`pilot` must be (A, B), got {len(pilot)} items")
        system = pilot if isinstance(pilot, System) else System(*pilot)
        model, source = np.hstack([system.A, system.B]), "a system declared to be from elsewhere"
    elif hasattr(pilot, "Theta"):
        model, source = pilot.Theta, "a model declared to be of other data"
        own = getattr(pilot, "data", None)
        if own is not None and shared_rows(data, own):
            raise InputError(
                "`pilot` shares runs with the data: it must be of other runs, or their number"
            )
    else:
        raise InputTypeError(
            f"`pilot` must be runs, a model or a system, got {validation.show(pilot)}"
        )
    if model.shape[0] != n or model.shape[1] not in (d, d - offset):
        raise ShapeError(f"`pilot` must have n={n} m={data.m} as the data, got {model.shape}")
    zeros = np.zeros((n, d - model.shape[1]))
    return np.ascontiguousarray(np.hstack([model, zeros])), source, data, None


def _first(data: Trajectories, pilot: float, d: int) -> int:
    """How many of the first runs are the pilot's.

    A share, at least 2, two pairs for each unknown, and five where 3/10 of the runs have so many.
    """
    count, length = len(data), int(data.lengths.min())
    if isinstance(pilot, int):
        first = validation.size("pilot", pilot)
    else:
        if not 0.0 < pilot < 1.0:
            raise InputError(f"`pilot` must be a share in (0, 1) or a number of runs, got {pilot}")
        few, enough = -(-2 * d // length), -(-5 * d // length)
        first = max(2, few, min(enough, 3 * count // 10), round(pilot * count))
    if first >= count:
        raise InputError(f"`pilot` must leave runs for the model, got {first} of {count} runs")
    return first


def refuse(assumed: Assumptions, data: Trajectories, entries: bool, past: bool) -> None:
    """Refuse what has no exact law of the error of the model; `entries`: whether some are known.

    `past`: whether the pairs are weighted after their past, which starts may then depend on.
    """
    if assumed.design != "adaptive" or assumed.noise != "gaussian":
        raise InputError("`pilot` needs Gaussian noise, and design='adaptive', which is then exact")
    if entries:
        raise InputError("`pilot` goes without known entries")
    if assumed.tail > 0.0:
        raise InputError(
            "`tail` of `window` must be 0 with a pilot, whose law is that of the noise alone: take "
            "a longer window, or leave `pilot` out"
        )
    if past:
        return
    require_whole(data, "data", "a pilot simulates whole runs from their starts")
    n, first = data.n, data.layout.starts()
    starts, ends = data.rows[first, :n], data.rows[first + data.lengths - 1, -n:]
    known = {end.tobytes() for end in ends}
    if any(start.tobytes() in known for start in starts[starts.any(axis=1)]):
        raise InputError(
            "`pilot` needs runs that start independently: one starts where another ended"
        )


def made(
    data: Trajectories, assumed: Assumptions, entries: bool, asked: Pilot, offset: bool
) -> tuple[PilotModel, Trajectories]:
    """The pilot and the main runs."""
    n, m = data.n, data.m
    refuse(assumed, data, entries, False)
    if data.lengths.min() != data.lengths.max() and not asked.lengths_fixed:
        raise InputError("runs of unequal length, fixed beforehand, need `lengths_fixed=True`")
    model, source, main, before = divided(data, asked.source, offset)
    gain = dither = None
    count = 0 if before is None else len(before)
    if asked.dither is not None:
        gain = validation.matrix("inputs", asked.inputs, rows=m, cols=n)
        dither = validation.matrix("dither", asked.dither, rows=data.size, cols=m)[count:]
    start, u = None, None
    if asked.reference is not None:
        start, u = _task(asked.reference, model, n, m, main)
    return PilotModel(model, source, gain, dither, start, u, follow=followed(asked, main, n)), main


def followed(asked: Pilot, main: Trajectories, n: int) -> Floats | None:
    """The gain (m, n) that plans will be followed with, of other runs than the model."""
    if asked.gain is None:
        return None
    own = getattr(getattr(asked.gain, "model", None), "data", None)
    if own is not None and shared_rows(main, own):
        raise InputError("`gain` must not come from the runs of the model")
    return validation.matrix("gain", asked.gain.K, rows=main.m, cols=n)


def split(
    data: Trajectories, assumed: Assumptions, entries: bool, asked: Pilot, d: int
) -> tuple[Trajectories, Trajectories]:
    """The first runs and the others, whose pairs are weighted after their past."""
    refuse(assumed, data, entries, True)
    if (np.ptp(data.lengths) > 0 or len(data.layout.gaps)) and not asked.lengths_fixed:
        raise InputError(
            "runs of unequal length, or with lost rows, need `lengths_fixed=True`: you declare "
            "that lengths were fixed beforehand and rows lost by chance"
        )
    first = _first(data, np.asarray(asked.source).item(), d)
    return data[:first], data[first:]


def after(first: Trajectories, main: Trajectories, window: Regressors, asked: Pilot) -> PilotModel:
    """The pilot of runs whose pairs are weighted after their past."""
    rows, d = rows_of(window, first)[1], window.length
    triangle = _core.triangle(rows, get_num_threads())
    fitted = _core.fit(triangle, d, len(rows), get_num_threads())
    if len(rows) < 2 * d or fitted.rank < d or fitted.ratio < 1e-8:
        raise InputError(
            f"`source` must be more runs: the first {len(first)}, {len(rows)} pairs, do not "
            f"determine the {d} coefficients of a row, which weights after the past need"
        )
    model, root = np.ascontiguousarray(fitted.H), triangle[:d, :d] / np.sqrt(len(rows))
    n, start, u = len(window.loop(model).G), None, None
    if asked.reference is not None:
        if main.outputs and not hasattr(asked.reference, "predicted_states"):
            raise InputError("`reference` must be a Plan for outputs, made without these runs")
        start, u = _task(asked.reference, model, n, main.m, main)
    count = len(first)
    source = f"runs 0 to {count - 1}, the model is of runs {count} to {count + len(main) - 1}"
    follow = followed(asked, main, n)
    return PilotModel(model, source, None, None, start, u, root, len(rows), follow)


def _task(
    reference: Any, model: Floats, n: int, m: int, main: Trajectories
) -> tuple[Floats, Floats]:
    """Start and inputs of a reference: a plan, or what the pilot would do from x0 to xf."""
    if hasattr(reference, "predicted_states"):
        own = getattr(getattr(reference.basis, "model", None), "data", None)
        if own is not None and shared_rows(main, own):
            raise InputError("`reference` must not come from the runs of the model")
        u = validation.matrix("reference.u", reference.u, cols=m)
        return validation.vector("reference.x0", reference.predicted_states[0], length=n), u
    task = validation.items("reference", reference)
    if len(task) != 3:
        raise ShapeError(f"`reference` must be (x0, xf, steps) or a plan, got {len(task)} items")
    x0 = validation.vector("reference[0]", task[0], length=n)
    xf = validation.vector("reference[1]", task[1], length=n)
    K = validation.size("reference[2]", task[2], maximum=MOST)
    A, B = model[:, :n], model[:, n : n + m]
    # x(K) - A^K x0 - C_K u of an offset
    drift = states(A, model[:, n + m :], 0.0 * x0, np.ones((K, model.shape[1] - n - m)))[-1]
    return x0, np.ascontiguousarray(best_control(A, B, x0, xf - drift, K).u.reshape(K, m))
