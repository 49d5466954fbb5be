"""A plan on a system that is known exactly."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .._base import gate
from ..exceptions import ShapeError
from ..system import System
from ..theory.dynamics import checked_ends, states
from ..theory.exact import best_control
from .within import limited_error

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .._base.labels import Labels
    from .._base.types import Floats
    from ..theory.records import PlanError
    from .limited import Limited


class Compared:
    """What `Plan` does with an exactly known system."""

    u: Floats
    predicted_states: Floats
    limited: Limited | None
    labels: Labels | None

    @property
    def steps(self) -> int:
        """Number of steps K."""
        return len(self.u)

    def error(self, system: System, x0: ArrayLike, xf: ArrayLike | None = None) -> PlanError:
        """Compare the control with the best one for an exactly known system.

        Parameters
        ----------
        system : System
            The true system. The names of the plan in another order are brought into its order.
        x0, xf : array_like, shape (n,)
            The true initial state and the target, in the order of the plan; xf is left out for a
            plan with a reference.

        Returns
        -------
        PlanError
            With ``v = C_K^+ (xf - A^K x0)``, the smallest control that comes nearest to the
            target: the error of the control, the distance between the two last states, and the
            residual that no control reaches. ``||x(K) - xf||`` is ``sqrt(state^2 + residual^2)``.
            For a plan with limits or weights v is the best control of the exact system with the
            same ones (R="auto" with the value used): ``||x(K) - xf|| <= state + residual``.

        Raises
        ------
        InputError, InputTypeError
            If the arguments do not fit this plan, or something overflows.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
        >>> plan = se.control(system, [1.0, 1.0], [0.0, 0.0], steps=5)
        >>> plan.error(system, [1.0, 1.0], [0.0, 0.0]).control
        0.0
        """
        fitting = self._fitting(system)
        if self.limited is not None:
            how: Any = {"length": fitting.n, "labels": fitting.state_names}
            start = gate.vector("x0", x0, **how)
            goal = None if xf is None else gate.vector("xf", xf, **how)
            return limited_error(self.limited, fitting.A, fitting.B, start, goal, self.u)
        checked, start, goal = checked_ends(fitting, x0, xf)
        best = best_control(checked.A, checked.B, start, goal, self.steps)
        return best.error(self.u.ravel(), start)

    def states(self, system: System, x0: ArrayLike) -> Floats:
        """Trajectory of an exactly known system under this control.

        Parameters
        ----------
        system : System
            The true system, as in `error`.
        x0 : array_like, shape (n,)
            Its initial state, in the order of the plan.

        Returns
        -------
        ndarray, shape (K + 1, n)
            ``x(k+1) = A x(k) + B u(k)``.

        Raises
        ------
        InputError, InputTypeError
            If the arguments do not fit this plan, or a state overflows.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
        >>> plan = se.control(system, [1.0, 0.0], [0.0, 0.0], steps=5)
        >>> bool(abs(plan.states(system, [1.0, 0.0])[-1]).max() < 1e-12)
        True
        """
        checked = self._fitting(system)
        start = gate.vector("x0", x0, length=checked.n, labels=checked.state_names)
        return states(checked.A, checked.B, start, self.u)

    def _fitting(self, system: object) -> System:
        checked = System.from_any(system)
        n, m = self.predicted_states.shape[1], self.u.shape[1]
        if (checked.n, checked.m) != (n, m):
            raise ShapeError(
                f"`system` must have n={n} and m={m} as this plan, got n={checked.n} and "
                f"m={checked.m}"
            )
        return checked._in_order("system", self.labels)
