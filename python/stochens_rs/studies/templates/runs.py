"""Runs that are drawn from a system which is known: the truth and the design of studies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._base import memory, validation
from ..._base.records import Record
from ..._base.types import Floats
from ...exceptions import InputError
from ...identification import Trajectories
from ...rng import Key
from ...system import System


@dataclass(frozen=True, eq=False)
class Truth(Record, listed=False):
    """``x(k+1) = A x(k) + B u(k) + c + w(k)``, w(k) Gaussian with covariance ``root root'``."""

    system: System
    root: Floats
    c: Floats | None = None

    def noise(self, key: Key, *shape: int, sigma: float | None = None) -> Floats:
        """Draw w, (*shape, n); `sigma` in place of the root: covariance ``sigma^2 I``."""
        drawn = key.generator().standard_normal((*shape, self.system.n))
        return drawn @ self.root.T if sigma is None else sigma * drawn

    def step(self, x: Floats, u: Floats) -> Floats:
        """The next states without noise, for rows of states and inputs."""
        found: Floats = x @ self.system.A.T + u @ self.system.B.T
        return found if self.c is None else found + self.c


@dataclass(frozen=True, eq=False)
class RunDesign(Record, listed=False):
    """How runs are made: drawn starts and inputs, or those of runs that were measured.

    Attributes
    ----------
    starts, excitation : ndarray, shapes (n,), (m,)
        Standard deviations of x(0), and of what is drawn for u(k).
    feedback : ndarray, shape (m, n)
        ``u(k) = feedback x(k)`` and what is drawn.
    length : int
        Steps of a run.
    runs : Trajectories or None
        Its starts and inputs in place of all these, in turn.
    """

    starts: Floats
    excitation: Floats
    feedback: Floats
    length: int
    runs: Trajectories | None = None

    def draw(self, truth: Truth, size: int, key: Key, sigma: float | None = None) -> Trajectories:
        """Runs of the true system, `size` of them."""
        x, u, lengths = self._chosen(size, key)
        memory.need("the runs", 8 * size * u.shape[1] * (3 * x.shape[1] + u.shape[2]))
        w = truth.noise(key.child("noise"), *u.shape[:2], sigma=sigma)
        states = np.empty((size, u.shape[1] + 1, x.shape[1]))
        states[:, 0] = x
        for k in range(u.shape[1]):
            u[:, k] += states[:, k] @ self.feedback.T
            states[:, k + 1] = truth.step(states[:, k], u[:, k]) + w[:, k]
        ends = lengths.tolist()
        some = [one[: T + 1] for one, T in zip(states, ends, strict=True)]
        return Trajectories(some, [one[:T] for one, T in zip(u, ends, strict=True)])

    def _chosen(self, size: int, key: Key) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """Starts, inputs without feedback, and numbers of steps."""
        n, m = len(self.starts), len(self.excitation)
        if self.runs is None:
            gen = key.child("design").generator()
            x = gen.standard_normal((size, n)) * self.starts
            u = gen.standard_normal((size, self.length, m)) * self.excitation
            return x, u, np.full(size, self.length)
        own = self.runs.runs
        which = np.arange(size) % len(own)
        inputs = np.zeros((len(own), int(self.runs.lengths.max()), m))
        for row, (_, acting) in zip(inputs, own, strict=True):
            row[: len(acting)] = acting
        return np.array([x[0] for x, _ in own])[which], inputs[which], self.runs.lengths[which]


def checked_design(
    system: System,
    runs: Trajectories | None,
    length: Any,
    starts: Any,
    excitation: Any,
    feedback: Any,
) -> RunDesign:
    """Check the arguments about the design."""
    n, m = system.n, system.m
    if runs is not None:
        validation.instance("runs", runs, Trajectories)
        if (runs.n, runs.m, runs.steps) != (n, m, 1):
            raise InputError(f"`runs` must have n={n} and m={m}, as the system, got {runs!r}")
        runs._require_whole("runs", "their inputs are played again")
    return RunDesign(
        starts=validation.deviations("starts", starts, n),
        excitation=validation.deviations("excitation", excitation, m),
        feedback=np.zeros((m, n))
        if feedback is None
        else validation.matrix("feedback", feedback, rows=m, cols=n),
        length=validation.size("length", length),
        runs=runs,
    )
