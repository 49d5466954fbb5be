"""What data say about a system, without the regions: the fields of a model, and its estimate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .._base import gate
from ..exceptions import InputError, ShapeError
from ..rng import Key
from .assumptions import Assumptions
from .certifying import Block, assembled, blocks
from .checks import DRAWS, WORK, Checks
from .consistency import refuse, require_sound
from .dependences import Lag, Range, exact_relations, one_more_lag, spanned, tested_rows
from .identified import Identified
from .instruments import projected, two_stages
from .least_squares import TRUSTED, Fitted, fit, named, r_factor
from .trajectories import Trajectories

if TYPE_CHECKING:
    from .._base.types import Floats


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Identified, listed=False):
    """Least squares of measured data and what was assumed; the fields are those of `Model`."""

    data: Trajectories
    triangle: Floats
    assumptions: Assumptions
    scale: Floats
    intercept: bool = False
    known: Floats | None = None
    instruments: Floats | None = None
    checks: Checks | None = None
    key: Key | None = None

    def __post_init__(self) -> None:
        gate.instance("data", self.data, Trajectories)
        gate.instance("assumptions", self.assumptions, Assumptions)
        gate.flag("intercept", self.intercept)
        n, d = self.n, self._d
        r = 0
        if self.instruments is not None:
            r = gate.kept("instruments", self.instruments, ndim=(2,)).shape[1]
            gate.kept("instruments", self.instruments, shape=(self.size, max(r, d)))
        gate.kept("triangle", self.triangle, shape=(r + d + n,) * 2)
        gate.kept("scale", self.scale, shape=(d,))
        if self.known is not None and gate.instance("known", self.known, np.ndarray).shape != (
            n,
            d,
        ):
            raise ShapeError(f"`known` must have shape ({n}, {d}), got {self.known.shape}")
        if self.checks is not None:
            gate.instance("checks", self.checks, Checks)
        refuse(self.assumptions, self.known, self.instruments, self.data.single)
        require_sound(self.scale, self.known)
        if (self.noise == "symmetric") != (self.key is not None):
            raise InputError("`key` must be given for noise='symmetric', and only there")
        if self.key is not None:
            gate.instance("key", self.key, Key)

    @property
    def n(self) -> int:
        """The number of states."""
        return self.data.n

    @property
    def m(self) -> int:
        """The number of inputs."""
        return self.data.m

    @property
    def dt(self) -> float | None:
        """The time between two steps [s]; None if unspecified."""
        return self.data.dt

    @property
    def size(self) -> int:
        """The number of pairs N."""
        return self.data.size

    @property
    def state_names(self) -> tuple[str, ...]:
        """The names of the states."""
        return self.data.state_names

    @property
    def input_names(self) -> tuple[str, ...]:
        """The names of the inputs."""
        return self.data.input_names

    @property
    def design(self) -> str:
        """The declared design."""
        return self.assumptions.design

    @property
    def noise(self) -> str:
        """The declared law of the noise."""
        return self.assumptions.noise

    @property
    def _d(self) -> int:
        return self.n + self.m + self.intercept

    @property
    def _own(self) -> Floats:
        """The triangle of [Z Y] alone."""
        r = 0 if self.instruments is None else self.instruments.shape[1]
        return self.triangle[:, r:] if r else self.triangle

    @cached_property
    def _blocks(self) -> list[Block]:
        return self._blocks_of(by_rows=False)

    def _blocks_of(self, *, by_rows: bool) -> list[Block]:
        R = self._own
        if self.instruments is not None:
            R = np.linalg.qr(R)[1]
        return blocks(R, self._d, self.size, self.known, by_rows)

    @cached_property
    def _Theta(self) -> Floats:
        """``[A B c]``, read-only."""
        d, covariance = self._d, self.assumptions.state_noise
        if self.instruments is not None:
            r = self.instruments.shape[1]
            return gate.frozen(two_stages(projected(self.triangle, r, self.size), d))
        if isinstance(covariance, str):
            return gate.frozen(assembled(self._blocks, self.known, self.n, d))
        return gate.frozen(_corrected(self.triangle, d, self.n, self.size, covariance))

    @property
    def covariance(self) -> Floats | None:
        """The covariance of the noise, shape (n, n): the known one, or ``S / nu`` of the residuals.

        None if there are no more pairs than unknowns. With noisy states it includes their noise.
        """
        if self.assumptions.known is not None:
            return self.assumptions.known
        found = np.zeros((self.n, self.n))
        for block in self._blocks:
            if block.fitted.nu < 1:
                return None
            found[np.ix_(block.rows, block.rows)] = block.fitted.S / block.fitted.nu
        return found

    @property
    def rank(self) -> int:
        """How many directions of z = (x, u, 1) the data determine, the least over the rows."""
        free = [block.fitted.rank - len(block.columns) for block in self._blocks]
        return self._d + min(free)

    @property
    def identifiable(self) -> bool:
        """Whether the data determine the whole model."""
        return self.rank == self._d

    @cached_property
    def missing(self) -> tuple[str, ...]:
        """The directions of z that the data do not determine, in the names of states and inputs.

        ``x[1] - u[0]``: the data are the same for all models that act alike on the z in which this
        combination is 0.
        """
        names = np.array([*self.state_names, *self.input_names, "1"][: self._d], dtype=object)
        found: list[str] = []
        for block in self._blocks:
            if block.fitted.missing.shape[1]:
                for text in named(block.fitted.missing, list(names[block.columns])):
                    if text not in found:
                        found.append(text)
        return tuple(found)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to be careful about, one sentence each; see also `checks`."""
        said, lag = list(self.doubts), self._lag
        if lag is not None and lag.significant and not lag.refuses:
            said.append(lag.said(self.state_names))
        if self.checks is not None:
            said += self.checks.warnings
        elif self.size * self.n * DRAWS > WORK:
            said.append(
                f"the residuals were not tested, as {self.size} pairs take long: see Model.check"
            )
        said += cautions(self._blocks, self.missing)
        if self.assumptions.noisy_states and self.instruments is None:
            said.append("the states are measured with error, so that no region is known")
        return tuple(said)

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """Why no certificate of a plan from this model is finite, one sentence each.

        Columns that are tied exactly, or of which states and inputs one step earlier explain a
        tenth of the variance or more, and that `identify` was not told to be so: they are no states
        of a plant. Empty where nothing of this is seen, which does not prove that they are.
        """
        said = exact_relations(*self._residuals, self.state_names)
        lag = self._lag
        return said if lag is None or not lag.refuses else (*said, lag.said(self.state_names))

    @cached_property
    def _residuals(self) -> tuple[Fitted, Range]:
        """Least squares without regard to known entries, and what its residuals span."""
        R = self._own if self.instruments is None else r_factor(self._own)
        f = fit(R, self._d, self.size)
        return f, spanned(f, tested_rows(self.assumptions, self.known, self.n))

    @cached_property
    def _lag(self) -> Lag | None:
        """The test of one more lag; None where errors of reading are declared, or none is known."""
        if self.assumptions.noisy_states:
            return None
        return one_more_lag(self.data, self.intercept, self._residuals[1])

    @cached_property
    def _largest(self) -> Floats | None:
        if self.data.steps > 1:
            return None
        x, u, _ = self.data.pairs()
        return np.hstack([np.abs(x).max(axis=0), np.abs(u).max(axis=0)])

    def _pairs(self) -> tuple[Floats, Floats]:
        """Z and Y, the rows of all pairs."""
        x, u, y = self.data.pairs()
        ones = np.ones((len(x), int(self.intercept)))
        return np.hstack([x, u, ones]), np.ascontiguousarray(y)


def cautions(found: list[Block], missing: tuple[str, ...]) -> list[str]:
    """What to be careful about in a fit."""
    said = []
    if missing:
        said.append(f"the data do not determine the model along {'; '.join(missing)}")
    ratio = min((b.fitted.ratio for b in found if b.fitted.rank), default=1.0)
    if ratio < TRUSTED:
        said.append(
            f"the states and inputs are nearly dependent (ratio {ratio:.1e}): bounds are large"
        )
    return said


def _corrected(R: Floats, d: int, n: int, N: int, covariance: Floats) -> Floats:
    """``Y' Z (Z' Z - N C)^-1``: consistent for states with errors of covariance C."""
    V = R[:d, :d].T @ R[:d, :d]
    V[:n, :n] -= N * covariance
    if np.linalg.eigvalsh(V)[0] <= 0.0:
        raise InputError("`state_noise` is as large as the states themselves: no estimate")
    return np.asarray(np.linalg.solve(V, R[:d, :d].T @ R[:d, d:]).T)
