"""Logs with the faults that real logs have, of three plants, and what `identify` makes of them.

``FAULTS`` has one function for each kind, ``fault(plant, gen, size) -> Log``; size 0, 1, 2 is
small, one that matters, large. `outcome` says what follows: a finite statement that is wrong, a
refusal, or none of both. ``python tests/python/broken_logs.py SETS`` prints the table.
"""

from __future__ import annotations

import sys
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

import stochens_rs as se
from declarations import opts
from stochens_rs.exceptions import InputError, SolverError
from stochens_rs.identification.window import rows_of

Array = NDArray[np.float64]
Generator = np.random.Generator
DELTA = 0.05


# -- plants ----------------------------------------------------------------------------------------


class Plant(NamedTuple):
    """``x+ = A x + B u + G e``, ``y = C x + D e``, ``u = K y + dither``, e standard normal."""

    name: str
    A: Array
    B: Array
    C: Array
    G: Array
    D: Array
    K: Array
    dither: Array
    start: Array
    lags: int | None = None

    @property
    def noise(self) -> Array:
        """The deviation of the noise of each reading."""
        return np.diag(self.G if self.lags is None else self.D)

    @property
    def truth(self) -> Array:
        """The coefficients of the regressors: ``[A B]``, or those of the lags."""
        if self.lags is None:
            return np.hstack([self.A, self.B])
        gain = self.G @ np.linalg.inv(self.D)  # readings say the state after two steps
        powers = [np.linalg.matrix_power(self.A - gain @ self.C, k) for k in range(self.lags)]
        return np.hstack([self.C @ P @ M for M in (gain, self.B) for P in powers])


def _sampled(F: Array, g: Array, dt: float) -> tuple[Array, Array]:
    n, m = g.shape
    whole = linalg.expm(np.block([[F, g], [np.zeros((m, n + m))]]) * dt)
    return whole[:n, :n], whole[:n, n:]


def _cart() -> Plant:
    """A pendulum on a cart, 20 Hz, [m, rad, m/s, rad/s] and N: unstable, held by a feedback."""
    F = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [0, -1.96, -0.5, 0], [0, 23.5, 1, 0]], dtype=float)
    A, B = _sampled(F, np.array([[0.0], [0.0], [1.0], [-2.0]]), 0.05)
    P = linalg.solve_discrete_are(A, B, np.diag([10.0, 10.0, 1.0, 1.0]), np.eye(1))
    K = -np.linalg.solve(np.eye(1) + B.T @ P @ B, B.T @ P @ A)
    size = np.array([0.002, 0.002, 0.02, 0.03])
    none = np.zeros((4, 4))
    start = np.array([0.05, 0.02, 0.05, 0.05])
    return Plant("cart", A, B, np.eye(4), np.diag(size), none, K, np.array([1.5]), start)


def _oven() -> Plant:
    """Two zones [K], a heater [W] and a fan [%], slow and stable, in open loop."""
    A = np.array([[0.92, 0.05], [0.08, 0.86]])
    B = np.array([[0.004, -0.01], [0.001, -0.03]])
    size, none = np.array([0.4, 0.3]), np.zeros((2, 2))
    dither = np.array([200.0, 20.0])
    return Plant("oven", A, B, np.eye(2), np.diag(size), none, none, dither, np.array([3.0, 2.0]))


def _belt() -> Plant:
    """A motor [rad] that moves a load [mm] by a belt, hardly damped; both are read, no speeds."""
    F = np.array([[0, 1, 0, 0], [-90, -3, 1.8, 0], [0, 0, 0, 1], [9000, 0, -180, -2]], dtype=float)
    A, B = _sampled(F, np.array([[0.0], [40.0], [0.0], [0.0]]), 0.05)
    C, size = np.eye(4)[[0, 2]], np.diag([0.01, 0.4])
    # e is all that two readings do not say of the next one: (A - gain C)^2 = 0
    seen = np.vstack([C, C @ A])
    gain = A @ A @ np.linalg.solve(seen, np.eye(4)[:, 2:])
    start = np.array([0.1, 0.5, 5.0, 20.0])
    none = np.zeros((1, 2))
    return Plant("belt", A, B, C, gain @ size, size, none, np.array([1.0]), start, lags=2)


PLANTS = {plant.name: plant for plant in (_cart(), _oven(), _belt())}
STATES = ("cart", "oven")


@dataclass
class Log:
    """Readings (R, T + 1, p) and inputs (R, T, m), or lists, and how they are identified."""

    y: Any
    u: Any
    how: dict[str, Any] = field(default_factory=dict)
    last: bool = False  # whether only the last pair of each run is taken
    twice: float = 0.0  # the share of the runs that are handed over a second time
    motor: float = 0.0  # the pole of a lag before the plant
    dead: int = 0  # steps until an input acts

    def data(self, outputs: bool) -> Any:
        data = se.Trajectories(list(self.y), list(self.u), outputs=outputs)
        data = data.last_pairs() if self.last else data
        return data if not self.twice else [data, data[: max(1, round(self.twice * len(data)))]]


def logged(
    plant: Plant,
    gen: Generator,
    runs: int = 6,
    steps: int = 100,
    *,
    dead: int = 0,
    motor: float = 0.0,
    act: Callable[[Array, Array], Array] | None = None,
    push: Callable[[int], Any] = lambda k: 0.0,
    law: Callable[[Array, Array], Array] = lambda e, y: e,
    ahead: float = 0.0,
    system: Callable[[int], tuple[Array, Array]] | None = None,
    last: bool = False,
    **how: Any,
) -> Log:
    """Runs of a plant.

    Of an actuator with a dead time, a lag of this pole and the law ``act(u, y)``; `push(k)` in
    deviations of the noise; noise ``law(e, y)``; a feedback that knows `ahead` of the noise to
    come; and a plant that is ``system(k)`` at step k.
    """
    p, m = len(plant.C), plant.B.shape[1]
    x = plant.start * gen.standard_normal((runs, len(plant.A)))
    sent, acting = [np.zeros((runs, m))] * dead, np.zeros((runs, m))
    y_all, u_all = [], []
    for k in range(steps + 1):
        e = gen.standard_normal((runs, p))
        y = x @ plant.C.T
        e = law(e, y) + push(k)
        y = y + e @ plant.D.T
        u = y @ plant.K.T + plant.dither * gen.standard_normal((runs, m))
        u = u + ahead * plant.dither * e[:, :1]
        y_all.append(y)
        u_all.append(u)
        sent.append(u if act is None else act(u, y))
        acting = motor * acting + (1.0 - motor) * sent[k]
        A, B = (plant.A, plant.B) if system is None else system(k)
        x = x @ A.T + acting @ B.T + e @ plant.G.T
    y_all, u_all = np.array(y_all).swapaxes(0, 1), np.array(u_all).swapaxes(0, 1)
    return Log(y_all, u_all[:, :-1], how, last, motor=motor, dead=dead)


# -- what follows from a log -----------------------------------------------------------------------


def outcome(plant: Plant, log: Log) -> tuple[str, str]:
    """``wrong``, ``refused``, ``warned`` or ``right``, and the words behind it."""
    outputs = plant.lags is not None
    options = ({"lags": plant.lags} if outputs else {}) | log.how
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            model = se.identify(log.data(outputs), **opts(**options))
            region = model.region(DELTA)
        except InputError as error:
            return "refused", str(error)
        if model.doubts or not region.bounded:
            return "refused", "; ".join(model.doubts) or "not bounded"
        missed = misses(plant, model, region)
        falls = certified(plant, model) and not stays(plant, model, log)
    said = "; ".join(model.warnings)
    if missed or falls:
        return "wrong", said
    return ("warned" if said else "right"), said


def misses(plant: Plant, model: Any, region: Any) -> bool:
    """Whether a region misses the plant; with more lags than it has, as runs without noise show."""
    truth, p = plant.truth, len(plant.C)
    if model.window is None or model.window.count == plant.lags:
        return not region.contains(truth[:, :p], truth[:, p:])
    silent = logged(plant, np.random.default_rng(0), 2, 50, law=lambda e, y: 0.0 * e)
    rows, d = rows_of(model.window, silent.data(True))[1], model.window.length
    off = np.linalg.norm(rows[:, d:] - rows[:, :d] @ model.coefficients.T, axis=1)
    return any(
        e > region.bound(z[:p], z[p:]) + 1e-9 * np.abs(rows).max()
        for e, z in zip(off, rows[:, :d], strict=True)
    )


def certified(plant: Plant, model: Any) -> bool:
    """Whether a gain from this model is certified; it is kept for `stays`."""
    p = len(plant.C)
    size = np.abs(model.data.rows[:, :p]).max(axis=0) + 1e-300
    try:
        loop = se.gain(model, np.diag(size**-2.0), np.diag(plant.dither**-2.0))
    except (InputError, SolverError):
        return False
    object.__setattr__(model, "_loop_of_test", loop)
    return bool(loop.certificate(DELTA).status == "certified")


def stays(plant: Plant, model: Any, log: Log) -> bool:
    """Whether the plant comes to rest under the gain, with its dead time and its motor."""
    K = model._loop_of_test.K
    if model.window is None:
        A, B = plant.A, plant.B
    else:
        joint = model.window.loop(plant._replace(lags=model.window.count).truth).ABc
        A, B = joint[:, : len(joint)], joint[:, len(joint) : len(joint) + plant.B.shape[1]]
    m = B.shape[1]
    stages = [log.motor * np.eye(m)] if log.motor else []  # of the motor, then of the dead time
    stages += [np.zeros((m, m))] * log.dead
    whole, enters = A, B
    for stage in stages:
        whole = np.block(
            [[whole, enters @ (np.eye(m) - stage)], [np.zeros((m, len(whole))), stage]]
        )
        if stage.any():  # u of now acts through the motor: x+ = A x + B (a v + (1 - a) u)
            whole[: len(A), -m:] = B @ stage
            enters = np.vstack([B, np.eye(m)]) @ (np.eye(m) - stage)
        else:
            whole[: len(whole) - m, -m:] = enters
            enters = np.vstack([np.zeros_like(enters), np.eye(m)])
    feedback = np.hstack([K, np.zeros((m, len(whole) - K.shape[1]))])
    return bool(np.abs(np.linalg.eigvals(whole + enters @ feedback)).max() < 1.0)


# -- faults ----------------------------------------------------------------------------------------


class Fault(NamedTuple):
    """A kind of fault, the plants that can have it, and those of which no log shows it."""

    text: str
    make: Callable[[Plant, Generator, Any], Log]
    sizes: tuple[Any, Any, Any]
    plants: tuple[str, ...]
    unseen: tuple[str, ...]

    def __call__(self, plant: Plant, gen: Generator, size: int) -> Log:
        return self.make(plant, gen, self.sizes[size])


FAULTS: dict[str, Fault] = {}


def fault(
    *sizes: Any, plants: tuple[str, ...] = tuple(PLANTS), unseen: tuple[str, ...] = ()
) -> Any:
    def add(make: Any) -> Any:
        FAULTS[make.__name__] = Fault(make.__doc__, make, sizes, plants, unseen)  # type: ignore[arg-type]
        return make

    return add


def clean(plant: Plant, gen: Generator) -> Log:
    """A log without a fault."""
    return logged(plant, gen)


def last_pairs(plant: Plant, gen: Generator, **how: Any) -> Log:
    """The last pairs of 60 runs."""
    return logged(plant, gen, 60, 5, last=True, design="independent", **how)


def of_readings(*sizes: Any) -> Any:
    """A fault of a clean log: ``spoil(y, spread, size, gen)`` in place."""

    def add(spoil: Any) -> Any:
        def make(plant: Plant, gen: Generator, size: Any) -> Log:
            log = clean(plant, gen)
            y = log.y.copy()
            spoil(y, spread(log), size, gen)
            return changed(log, y)

        make.__name__, make.__doc__ = spoil.__name__, spoil.__doc__
        return fault(*sizes)(make)

    return add


def changed(log: Log, y: Any = None, u: Any = None) -> Log:
    """The log with other readings or inputs."""
    return Log(log.y if y is None else y, log.u if u is None else u, log.how)


def spread(log: Log) -> Array:
    """The deviation of each reading."""
    return log.y.std(axis=(0, 1))


# of the actuator


@fault(1, 2, 3)
def dead_time(plant, gen, steps):
    """Inputs act some steps later; at most two, where the feedback fails beyond."""
    return logged(plant, gen, dead=min(steps, 2) if plant.K.any() else steps)


@fault(0.1, 0.3, 0.7)
def hidden_motor(plant, gen, pole):
    """The actuator follows its command with a lag that is not measured."""
    return logged(plant, gen, motor=pole)


@fault(2.0, 1.0, 0.5)
def saturated_actuator(plant, gen, limit):
    """The command is logged, the actuator has a limit."""
    most = limit * plant.dither
    return logged(plant, gen, act=lambda u, y: np.clip(u, -most, most))


@fault(0.2, 0.5, 1.0)
def dead_zone(plant, gen, width):
    """Small commands do nothing."""
    w = width * plant.dither
    return logged(plant, gen, act=lambda u, y: np.sign(u) * np.maximum(np.abs(u) - w, 0.0))


@fault(0.1, 0.4, 1.0)
def friction(plant, gen, force):
    """A force against the sign of the last state that is read."""
    f = force * plant.dither
    return logged(plant, gen, act=lambda u, y: u - f * np.sign(y[:, -1:]))


@fault(0.1, 0.3, 0.6)
def worn_actuator(plant, gen, loss):
    """The effect of the inputs is lost little by little over the log."""
    return logged(plant, gen, 1, 600, system=lambda k: (plant.A, plant.B * (1.0 - loss * k / 600)))


@fault(0.1, 0.3, 0.6)
def warming_actuator(plant, gen, loss):
    """The effect of the inputs is lost over each run, and is back in the next."""
    return logged(plant, gen, system=lambda k: (plant.A, plant.B * (1.0 - loss * k / 100)))


@fault(1 / 50, 1 / 6, 1 / 2)
def flipped_input(plant, gen, share):
    """An input has the other sign in a part of the log."""
    log = logged(plant, gen, 1, 600)
    u = log.u.copy()
    u[:, : int(share * 600), 0] *= -1.0
    return changed(log, u=u)


# of the plant


@fault(0.03, 0.1, 0.3)
def two_rigs(plant, gen, apart):
    """Half of the runs are of another rig."""
    first, second = (
        logged(plant, gen, 3),
        plant._replace(A=plant.A * (1 - apart / 10), B=plant.B * (1 + apart)),
    )
    other = logged(second, gen, 3)
    return Log(np.concatenate([first.y, other.y]), np.concatenate([first.u, other.u]))


@fault(0.003, 0.03, 0.3)
def bent_plant(plant, gen, part):
    """A cubic term in each state: of this part of a reading's deviation, at one deviation."""
    size = spread(clean(plant, np.random.default_rng(1)))

    def law(e, y):
        return e - part * (size / plant.noise) * np.clip(y / size, -3, 3) ** 3

    return logged(plant, gen, law=law)


@fault(0.2, 1.0, 4.0)
def offset(plant, gen, force):
    """A constant force, and no intercept."""
    return logged(plant, gen, push=lambda k: force)


@fault(0.2, 0.7, 2.0)
def periodic_force(plant, gen, force):
    """A force that comes back every 20 steps."""
    return logged(plant, gen, push=lambda k: force * np.sin(2 * np.pi * k / 20))


@fault(0.1, 0.4, 0.8)
def lasting_noise(plant, gen, pole):
    """Noise that lasts."""
    before = {}

    def law(e, y):
        before["w"] = pole * before.get("w", 0.0) + np.sqrt(1 - pole**2) * e
        return before["w"]

    return logged(plant, gen, law=law)


@fault(0.3, 1.0, 3.0)
def growing_noise(plant, gen, more):
    """Noise that grows with a reading."""
    size = spread(clean(plant, np.random.default_rng(1)))
    return logged(
        plant, gen, law=lambda e, y: e * (1.0 + more * np.clip(np.abs(y / size)[:, :1], 0, 3))
    )


@fault(6.0, 3.0, 2.0)
def heavy_noise(plant, gen, nu):
    """Noise with heavy tails (Student's, of so many degrees of freedom)."""
    return logged(plant, gen, law=lambda e, y: e / np.sqrt(gen.chisquare(nu, (len(e), 1)) / nu))


@fault(0.1, 0.4, 1.0, unseen=("cart", "oven"))
def knowing_controller(plant, gen, ahead):
    """The controller sees the disturbance by a sensor that is not logged."""
    return logged(plant, gen, ahead=ahead)


def _steps_of(plant: Plant, factors: Array) -> list[tuple[Array, Array]]:
    """A and B of steps that last so many times as long."""
    n, m = len(plant.A), plant.B.shape[1]
    whole = np.block([[plant.A, plant.B], [np.zeros((m, n)), np.eye(m)]])
    generator = linalg.logm(whole).real
    steps = [linalg.expm(generator * factor) for factor in factors]
    return [(step[:n, :n], step[:n, n:]) for step in steps]


# here, as SciPy's norms of exponentials draw from NumPy's global generator
JITTERS, TIMES = (0.05, 0.2, 0.5), np.linspace(-1.0, 1.0, 21)
JITTERED = {
    (name, jitter): _steps_of(plant, 1.0 + jitter * TIMES)
    for name, plant in PLANTS.items()
    for jitter in JITTERS
}


@fault(*JITTERS)
def jittered_sampling(plant, gen, jitter):
    """The steps last longer and shorter than the log says."""
    steps = JITTERED[plant.name, jitter]
    return logged(plant, gen, system=lambda k: steps[gen.integers(len(steps))])


# of the sensors


@fault(0.1, 1.0, 3.0)
def noisy_readings(plant, gen, size):
    """Readings with an error (in deviations of the noise) that is not of the plant."""
    log = logged(plant, gen)
    return changed(log, log.y + size * plant.noise * gen.standard_normal(log.y.shape))


@of_readings(0.3, 1.0, 5.0)
def spikes(y, spread, size, gen):
    """One reading in 600 is off, in deviations of the readings."""
    y[gen.integers(6), gen.integers(20, 80), 0] += size * spread[0]


@of_readings(3.0, 2.0, 1.0)
def wrapped_angle(y, spread, range_, gen):
    """A reading is that of an angle: it jumps from one end of its range to the other."""
    half = range_ * spread[-1]
    y[..., -1] = (y[..., -1] + half) % (2 * half) - half


@of_readings(2.5, 1.5, 0.7)
def clipped_sensor(y, spread, range_, gen):
    """A reading stays at the end of its range."""
    end = range_ * spread[0]
    y[..., 0] = np.clip(y[..., 0], -end, end)


@of_readings(12, 8, 5)
def few_bits(y, spread, bits, gen):
    """Readings of few bits over six deviations."""
    step = 6 * spread / 2**bits
    y[:] = np.round(y / step) * step


@of_readings(0.1, 0.5, 0.9)
def filtered_readings(y, spread, pole, gen):
    """Readings behind a low-pass filter."""
    for k in range(1, y.shape[1]):
        y[:, k] = pole * y[:, k - 1] + (1 - pole) * y[:, k]


@of_readings(0.1, 0.5, 0.9)
def one_filtered_reading(y, spread, pole, gen):
    """One of the readings behind a low-pass filter."""
    for k in range(1, y.shape[1]):
        y[:, k, -1] = pole * y[:, k - 1, -1] + (1 - pole) * y[:, k, -1]


@of_readings(3, 15, 60)
def stuck_sensor(y, spread, rows, gen):
    """A reading is repeated for a while."""
    run, at = gen.integers(6), gen.integers(5, 30)
    y[run, at : at + rows, 0] = y[run, at, 0]


@of_readings(0.1, 1.0, 5.0)
def drifting_sensor(y, spread, size, gen):
    """A reading drifts over each run, in its deviations."""
    y[..., 0] += size * spread[0] * np.linspace(0, 1, 101)


@fault(1, 2, 5)
def late_sensor(plant, gen, rows):
    """One reading stands some rows too late."""
    log = logged(plant, gen, 6, 100 + rows)
    y = log.y[:, rows:].copy()
    y[..., -1] = log.y[:, :-rows, -1]
    return changed(log, y, log.u[:, rows:])


@of_readings(1.02, 1.5, 1000.0)
def changed_units(y, spread, factor, gen):
    """The unit of a reading is another one in the second half of the log."""
    y[3:, :, -1] *= factor


@fault(1 / 50, 1 / 6, 1 / 2)
def swapped_columns(plant, gen, share):
    """Two columns change places in a part of the log."""
    log = logged(plant, gen, 1, 600)
    y, rows = log.y.copy(), int(share * 600)
    y[:, :rows, [0, -1]] = y[:, :rows, [-1, 0]]
    return changed(log, y)


# of the logger


@fault(1 / 6, 1 / 2, 1.0)
def state_after_action(plant, gen, share):
    """A row holds the readings after its input, in a part of the runs."""
    log = logged(plant, gen, 6, 101)
    late = np.arange(6) < round(6 * share)
    y = np.where(late[:, None, None], log.y[:, 1:], log.y[:, :-1])
    return changed(log, y, log.u[:, :-1])


@fault(1 / 6, 1 / 2, 1.0)
def input_of_the_next_row(plant, gen, share):
    """A row holds the input of the step behind it, in a part of the runs."""
    log = logged(plant, gen, 6, 101)
    early = np.arange(6) < round(6 * share)
    u = np.where(early[:, None, None], log.u[:, 1:], log.u[:, :-1])
    return changed(log, log.y[:, :-1], u)


@fault(0.003, 0.03, 0.2)
def filled_rows(plant, gen, share):
    """Lost rows are filled with the last readings."""
    log = logged(plant, gen)
    y, lost = log.y.copy(), gen.random((6, 101)) < share
    for k in range(1, 101):
        y[lost[:, k], k] = y[lost[:, k], k - 1]
    return changed(log, y)


@fault(0.003, 0.03, 0.2)
def closed_gaps(plant, gen, share):
    """Lost rows are left out, and what is left is closed up."""
    log = logged(plant, gen)
    kept = [gen.random(100) >= share for _ in range(6)]
    y = [one[np.append(keep, True)] for one, keep in zip(log.y, kept, strict=True)]
    return changed(log, y, [one[keep] for one, keep in zip(log.u, kept, strict=True)])


@fault(0.1, 0.3, 0.5)
def interpolated(plant, gen, shift):
    """Readings are interpolated to times between two rows."""
    log = logged(plant, gen, 6, 101)
    return changed(log, (1 - shift) * log.y[:, :-1] + shift * log.y[:, 1:], log.u[:, :-1])


@fault(0.1, 0.5, 1.0)
def same_file_twice(plant, gen, share):
    """A part of the runs is handed over twice."""
    log = last_pairs(plant, gen) if plant.lags is None else logged(plant, gen)
    log.twice = share
    return log


# of what is declared


@fault(0.9, 0.6, 1 / 3)
def declared_covariance(plant, gen, part):
    """The declared noise is this part of the true one; 30 pilot runs where there are states."""
    return logged(plant, gen, covariance=part**2 * np.diag(plant.noise**2))


@fault(0.9, 0.6, 1 / 3, plants=STATES)
def declared_covariance_of_last_pairs(plant, gen, part):
    """The same of the last pairs of 60 runs."""
    return last_pairs(plant, gen, covariance=part**2 * np.diag(plant.noise**2))


@fault(1, 2, 3)
def declared_delay(plant, gen, steps):
    """The declared delay is longer than the true one by some steps."""
    return logged(plant, gen, dead=1, delay=1 + steps)


@fault(1.3, 3.0, 10.0, plants=STATES)
def scalar_covariance(plant, gen, ratio):
    """covariance="scalar", but the noises of two states differ by this factor."""
    sizes = plant.noise[0] * np.where(np.arange(len(plant.A)) % 2, ratio, 1.0)
    return last_pairs(plant._replace(G=np.diag(sizes)), gen, covariance="scalar")


@fault(0.2, 0.6, 0.95, plants=STATES)
def diagonal_covariance(plant, gen, correlation):
    """covariance="diagonal", but the noises have this correlation."""
    n = len(plant.A)
    root = np.linalg.cholesky(np.eye(n) + correlation * (1 - np.eye(n)))
    return last_pairs(plant._replace(G=plant.G @ root), gen, covariance="diagonal")


@fault(1, 2, 3, plants=STATES)
def dead_time_of_last_pairs(plant, gen, steps):
    """Last pairs of runs whose inputs act some steps later."""
    return last_pairs(plant, gen, dead=steps)


@fault(0.2, 0.5, 0.8, plants=STATES)
def hidden_motor_of_last_pairs(plant, gen, pole):
    """Last pairs of runs whose actuator has a lag that is not measured."""
    return last_pairs(plant, gen, motor=pole)


@fault(3.0, 2.0, 1.0, plants=STATES)
def stopped_by_a_switch(plant, gen, limit):
    """Runs end where a reading leaves its range, and their last pairs are taken."""
    log = logged(plant, gen, 60, 30, design="independent")
    beyond = np.abs(log.y[..., 0]) > limit * spread(log)[0]
    ends = [int(np.argmax(np.append(one[2:], True))) + 2 for one in beyond]
    y = [one[: min(end, 30) + 1] for one, end in zip(log.y, ends, strict=True)]
    u = [one[: min(end, 30)] for one, end in zip(log.u, ends, strict=True)]
    return Log(y, u, log.how, last=True)


@fault(40, 20, 10, plants=STATES)
def one_log_as_runs(plant, gen, steps):
    """One log is cut into runs for a pilot, whose runs must begin apart from the noise."""
    log = logged(plant, gen, 1, 600)
    y, u = log.y[0], log.u[0]
    starts = range(0, 600 - steps, steps + 1)  # the row between is left out
    how: dict[str, Any] = {"pilot": 0.2}
    if plant.K.any():
        how |= {"inputs": plant.K, "dither": u - y[:-1] @ plant.K.T}
    return Log([y[k : k + steps + 1] for k in starts], [u[k : k + steps] for k in starts], how)


# of readings


@fault(2, 4, 8, plants=("belt",))
def dead_time_beyond_the_window(plant, gen, steps):
    """Readings that answer later than the window reaches back."""
    return logged(plant, gen, dead=steps, lags=2)


@fault(0.3, 1.0, 3.0, plants=("belt",))
def output_error(plant, gen, size):
    """Readings with an error of their own, so that no window of a few lags is exact."""
    log = noisy_readings(plant, gen, size)
    log.how["lags"] = 4
    return log


# -- the table -------------------------------------------------------------------------------------


def counted(kind: str, name: str, size: int, sets: int, first: int = 0) -> Counter[str]:
    """The outcomes of so many logs."""
    found: Counter[str] = Counter()
    place = list(FAULTS).index(kind)
    for seed in range(first, first + sets):
        gen = np.random.default_rng([38, place, list(PLANTS).index(name), size, seed])
        found[outcome(PLANTS[name], FAULTS[kind](PLANTS[name], gen, size))[0]] += 1
    return found


def main(sets: int) -> None:
    """Print the table: for each size wrong and refused, in percent."""
    print("| fault | small | matters | large |\n|---|---|---|---|")
    for kind, about in FAULTS.items():
        cells = []
        for size in range(3):
            found = sum((counted(kind, name, size, sets) for name in about.plants), Counter())
            share = 100.0 / found.total()
            cells.append(f"{share * found['wrong']:.0f}\u00a0/\u00a0{share * found['refused']:.0f}")
        print(f"| {about.text.rstrip('.')} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
