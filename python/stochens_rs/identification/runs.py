"""The stored pairs of measured runs: one array with a row (x, u, x_next) for each pair."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .._base import gate, html
from .._base.labels import checked_names

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from typing_extensions import Self

    from .._base.types import Floats


class Runs:
    """Rows (x, u, x_next), the number of pairs of each run, and names; immutable."""

    __slots__ = ("_dt", "_input_names", "_lengths", "_n", "_rows", "_state_names", "_steps")

    _rows: Floats
    _lengths: NDArray[np.int64]
    _n: int
    _dt: float | None
    _state_names: tuple[str, ...]
    _input_names: tuple[str, ...]
    _steps: int

    def _set(
        self,
        rows: Floats,
        lengths: NDArray[np.int64],
        n: int,
        dt: object,
        state_names: Sequence[str] | None,
        input_names: Sequence[str] | None,
        steps: int,
    ) -> None:
        m = rows.shape[1] - 2 * n
        rows.flags.writeable = lengths.flags.writeable = False
        of_states, of_inputs = checked_names(n, m, state_names, input_names)
        for slot, value in (
            ("_rows", rows),
            ("_lengths", lengths),
            ("_n", n),
            ("_dt", None if dt is None else gate.positive("dt", dt)),
            ("_state_names", of_states),
            ("_input_names", of_inputs),
            ("_steps", steps),
        ):
            object.__setattr__(self, slot, value)

    @classmethod
    def _of(
        cls,
        rows: Floats,
        lengths: NDArray[np.int64],
        n: int,
        dt: float | None,
        state_names: Sequence[str] | None,
        input_names: Sequence[str] | None,
        steps: int = 1,
    ) -> Self:
        self = object.__new__(cls)
        self._set(rows, lengths, n, dt, state_names, input_names, steps)
        return self

    def _part(self, rows: Floats, lengths: NDArray[np.int64]) -> Self:
        names = self._state_names, self._input_names
        return type(self)._of(rows, lengths, self._n, self._dt, *names, self._steps)

    @property
    def n(self) -> int:
        """The number of states."""
        return self._n

    @property
    def m(self) -> int:
        """The number of inputs."""
        return int(self._rows.shape[1]) - 2 * self._n

    @property
    def dt(self) -> float | None:
        """The time between two steps [s]; None if unspecified."""
        return self._dt

    @property
    def size(self) -> int:
        """The number of pairs N, of all runs together."""
        return len(self._rows)

    @property
    def lengths(self) -> NDArray[np.int64]:
        """The number of steps of each run, read-only."""
        return self._lengths

    @property
    def state_names(self) -> tuple[str, ...]:
        """The names of the states."""
        return self._state_names

    @property
    def input_names(self) -> tuple[str, ...]:
        """The names of the inputs."""
        return self._input_names

    @property
    def steps(self) -> int:
        """How many steps of the system a pair spans: 1, or the number given to `k_step`."""
        return self._steps

    @property
    def single(self) -> bool:
        """Whether every run is one pair."""
        return len(self._lengths) == len(self._rows)

    @property
    def runs(self) -> list[tuple[Floats, Floats]]:
        """The states (T + 1, n) and inputs (T, m) of each run."""
        n, ends = self._n, np.cumsum(self._lengths)
        parts = [self._rows[end - T : end] for T, end in zip(self._lengths, ends, strict=True)]
        return [(np.vstack([part[:, :n], part[-1:, -n:]]), part[:, n:-n].copy()) for part in parts]

    def _places(self) -> NDArray[np.int64]:
        """The step k of each pair in its run."""
        first = np.cumsum(self._lengths) - self._lengths
        return np.arange(self.size) - np.repeat(first, self._lengths)

    def __len__(self) -> int:
        return len(self._lengths)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"Trajectories are immutable: `{name}` cannot be set")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Runs):
            return NotImplemented
        return self._about() == other._about() and (
            np.array_equal(self._lengths, other._lengths)
            and np.array_equal(self._rows, other._rows)
        )

    __hash__ = None  # type: ignore[assignment]  # as for arrays

    def _about(self) -> tuple[object, ...]:
        return (self._n, self._dt, self._state_names, self._input_names, self._steps)

    def __repr__(self) -> str:
        runs, pairs = html.number_of(len(self), "run"), html.number_of(self.size, "pair")
        dt = "" if self._dt is None else f" dt={self._dt:g}"
        over = "" if self._steps == 1 else f" over {self._steps} steps"
        shown = pairs if self.single else f"{runs}, {pairs}"
        return f"<Trajectories: {shown}{over}, n={self.n} m={self.m}{dt}>"

    def _repr_html_(self) -> str:
        shortest, longest = int(self._lengths.min()), int(self._lengths.max())
        rows = [
            (
                "steps of a run",
                f"{shortest}" if shortest == longest else f"{shortest} to {longest}",
            ),
            ("states", ", ".join(self._state_names)),
            ("inputs", ", ".join(self._input_names)),
        ]
        states = self.runs[0][0] if len(self) == 1 or not self.single else self._rows[:, : self._n]
        about = (
            "states over the pairs" if self.single and len(self) > 1 else "states of the first run"
        )
        return html.card(self, rows, html.states(np.arange(len(states)), states, about))
