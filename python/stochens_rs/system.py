"""A discrete-time linear system, checked when it is made::

x(k+1) = A x(k) + B u(k),    x(k) in R^n,  u(k) in R^m
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ._base import gate, html
from ._base.simulator import linear_mujoco
from .exceptions import InputError, InputTypeError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["System"]


class System:
    """The system ``x(k+1) = A x(k) + B u(k)``; immutable and hashable.

    Parameters
    ----------
    A : array_like, shape (n, n)
        ``A[i, j]`` is the effect of state j at step k on state i at step k + 1.
    B : array_like, shape (n, m)
        ``B[i, j]`` is the effect of input j at step k on state i at step k + 1.
    dt : float or True, optional
        The time between two steps [s], > 0. True or None (the default): discrete time with an
        unspecified step.
    name : str, optional
        A label that is shown; ``==`` ignores it.

    Raises
    ------
    ShapeError
        If `A` is not square, or `B` has another number of rows.
    NonFiniteError
        If an entry, or `dt`, is nan or infinite.
    InputTypeError
        If `A` or `B` does not hold real numbers, or `dt` or `name` has a wrong type.
    InputError
        If `dt` is 0 (continuous time) or negative, or `A` or `B` has labels.

    Notes
    -----
    `A` and `B` are copied; the attributes are read-only. Here and in all other functions, tables
    with labels (pandas, xarray) are refused unless the labels are 0, 1, 2, ... in order, because
    their rows may be in another order than the states. Bring all tables into the same order and
    pass plain arrays: ``A.loc[states, states].to_numpy()``.

    Examples
    --------
    >>> system = System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]], dt=0.1, name="cart")
    >>> system
    <System cart: n=2 m=1 dt=0.1>
    >>> system.A @ [0.0, 1.0]
    array([0.1, 1. ])
    """

    __slots__ = ("_A", "_B", "_dt", "_name")

    _A: NDArray[np.float64]
    _B: NDArray[np.float64]
    _dt: float | bool | None
    _name: str | None

    def __init__(
        self,
        A: ArrayLike,
        B: ArrayLike,
        *,
        dt: float | bool | None = None,
        name: str | None = None,
    ) -> None:
        checked_A = gate.matrix("A", A, square=True)
        checked_B = gate.matrix("B", B, rows=len(checked_A))
        label = None if name is None else " ".join(gate.text("name", name).split())  # one line
        for slot, value in (
            ("_A", gate.frozen(checked_A)),
            ("_B", gate.frozen(checked_B)),
            ("_dt", _checked_dt(dt)),
            ("_name", label or None),
        ):
            object.__setattr__(self, slot, value)

    @classmethod
    def from_any(cls, system: object) -> System:
        """Convert a pair (A, B), or a system of another package.

        Parameters
        ----------
        system : object
            A `System` (returned as it is), a tuple ``(A, B)`` or ``(A, B, dt)``, a discrete
            ``control.StateSpace``, a discrete ``scipy.signal`` system in state-space form, or
            any object with attributes ``A``, ``B`` and optionally ``dt`` and ``name``. None of
            these packages is imported.

        Returns
        -------
        System
            With copies of A and B.

        Raises
        ------
        InputTypeError
            If `system` is none of these.
        InputError
            If the system is in continuous time or a model estimated from data, or A or B cannot be
            used.

        Examples
        --------
        >>> System.from_any(([[0.5]], [[1.0]], 0.01))
        <System: n=1 m=1 dt=0.01>
        """
        if isinstance(system, cls):
            return system
        if isinstance(system, type):
            raise InputTypeError(f"`system` must be a System, got the class {system.__name__[:40]}")
        if isinstance(system, tuple):
            if len(system) not in (2, 3):
                raise InputTypeError(
                    f"`system` must be a tuple (A, B) or (A, B, dt), got {len(system)} items"
                )
            dt = system[2] if len(system) == 3 else None
            if not (dt is None or isinstance(dt, (bool, np.bool_)) or gate.is_real(dt)):
                raise InputTypeError(
                    "`system` must be (A, B) or (A, B, dt) with a number dt > 0, got "
                    f"{gate.show(dt)} as third item"
                )
            return cls(system[0], system[1], dt=dt)  # type: ignore[arg-type]
        found = {word: _attribute(system, word) for word in ("A", "B", "dt", "name")}
        if found["A"] is None or found["B"] is None:
            hint = ""
            if isinstance(system, list):
                hint = "; use a tuple (A, B)"
            elif isinstance(system, np.ndarray):
                hint = "; pass (A, B)"
            elif _attribute(system, "to_ss", ...) is not ...:
                hint = "; call its to_ss() first"
            raise InputTypeError(
                "`system` must be a System, a tuple (A, B[, dt]) or an object with attributes A "
                f"and B, got {gate.show(system)}{hint}"
            )
        if _attribute(system, "centre") == "estimate":
            one = "`mean()`" if _attribute(system, "mean", ...) is not ... else "`system`"
            raise InputError(
                f"`system` must be known, got {gate.show(system)} estimated from data: pass its "
                f"{one} to take the estimate as exact"
            )
        # scipy.signal sets dt = None for continuous systems; only their class says so.
        if any(
            kind.__name__ == "lti" and kind.__module__.startswith("scipy.signal")
            for kind in type(system).__mro__
        ):
            raise InputError(_CONTINUOUS.format("`system` is a scipy.signal.lti"))
        name: Any = found["name"]
        return cls(
            found["A"],
            found["B"],
            dt=found["dt"],
            # python-control names systems without a name sys[0], sys[1], ...
            name=name if isinstance(name, str) and not name.startswith("sys[") else None,
        )

    @classmethod
    def from_mujoco(
        cls,
        model: object,
        data: object,
        *,
        frame_skip: int = 1,
        eps: float = 1e-6,
        centered: bool = True,
        tolerance: float = 1e-6,
    ) -> System:
        """Linearize a MuJoCo simulation at the point of `data`, by ``mujoco.mjd_transitionFD``.

        Parameters
        ----------
        model : mujoco.MjModel
            With nv degrees of freedom, na activations and nu actuators.
        data : mujoco.MjData
            An equilibrium ``(qpos, qvel, act, ctrl)``; it is not changed.
        frame_skip : int, default 1
            Steps of the simulator for each control, which is held: ``A = A_1^k`` and
            ``B = (I + A_1 + ... + A_1^(k-1)) B_1``.
        eps : float, default 1e-6
            Step of the finite differences.
        centered : bool, default True
            Central differences; False takes forward ones, in half the time.
        tolerance : float, default 1e-6
            Largest change of a state [rad, m, rad/s, m/s] in one control step without a change of
            ``ctrl``. What is allowed is left out of the system, which has no offset.

        Returns
        -------
        System
            ``A`` (n, n) and ``B`` (n, nu) with ``n = 2 nv + na``. States are deviations from the
            point: the nv positions, in the space of speeds (``mj_differentiatePos``, so that a
            free joint has 6), the nv speeds, the na activations. Inputs are deviations from
            ``data.ctrl``. ``dt`` is ``frame_skip * model.opt.timestep``.

        Raises
        ------
        InputError
            If `data` is not at an equilibrium or not of `model`, or the integrator of `model` is
            RK4, which MuJoCo does not differentiate.
        InputTypeError
            If `model` or `data` is of another type.
        ImportError
            If MuJoCo is not installed (extra ``mujoco``).

        Notes
        -----
        It holds near the point. Limits of joints, limits of ``ctrl`` and contacts that begin or
        end are not linear: away from them only.

        References
        ----------
        MuJoCo documentation, API reference, ``mjd_transitionFD``.
        """
        A, B, dt, name, _ = linear_mujoco(
            model,
            data,
            gate.size("frame_skip", frame_skip),
            gate.positive("eps", eps),
            gate.flag("centered", centered),
            gate.nonnegative("tolerance", tolerance),
        )
        return cls(A, B, dt=dt, name=name)

    @property
    def A(self) -> NDArray[np.float64]:
        """The state matrix, shape (n, n), read-only."""
        return self._A

    @property
    def B(self) -> NDArray[np.float64]:
        """The input matrix, shape (n, m), read-only."""
        return self._B

    @property
    def n(self) -> int:
        """The number of states."""
        return int(self._B.shape[0])

    @property
    def m(self) -> int:
        """The number of inputs."""
        return int(self._B.shape[1])

    @property
    def dt(self) -> float | bool | None:
        """The time between two steps [s]; True or None if unspecified."""
        return self._dt

    @property
    def name(self) -> str | None:
        """The label, or None."""
        return self._name

    def __setattr__(self, attribute: str, value: object) -> None:
        raise AttributeError(f"a System is immutable: `{attribute}` cannot be set")

    def __delattr__(self, attribute: str) -> None:
        raise AttributeError(f"a System is immutable: `{attribute}` cannot be deleted")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, System):
            return NotImplemented
        return (
            self._step() == other._step()
            and np.array_equal(self._A, other._A)
            and np.array_equal(self._B, other._B)
        )

    def __hash__(self) -> int:
        # Adding 0.0 turns -0.0 into 0.0: they are equal, so their hashes must be equal.
        return hash(
            (self._B.shape, (self._A + 0.0).tobytes(), (self._B + 0.0).tobytes(), self._step())
        )

    def _step(self) -> tuple[bool, float | bool | None]:
        return (self._dt is True, self._dt)  # True == 1.0 in Python, but not here

    def __reduce__(self) -> tuple[object, ...]:
        return (_rebuild, (self._A, self._B, self._dt, self._name))

    def __copy__(self) -> System:
        return self

    def __deepcopy__(self, memo: dict[int, object]) -> System:
        return self

    def __repr__(self) -> str:
        label = "" if self._name is None else f" {self._name}"
        return f"<System{label}: n={self.n} m={self.m} dt={self._dt}>"

    def _repr_html_(self) -> str:
        dt = f"{self.dt} s" if isinstance(self.dt, float) else str(self.dt)
        return html.card(self, [("states n", self.n), ("inputs m", self.m), ("step dt", dt)])


_CONTINUOUS = (
    "{}, which means continuous time: discretize first, e.g. with scipy.signal.cont2discrete "
    "or control.c2d"
)


def _attribute(system: object, word: str, missing: object = None) -> Any:
    """Return an attribute of any object, or `missing`."""
    try:
        return getattr(system, word, missing)
    except Exception as error:  # a property can raise anything
        raise InputTypeError(
            f"`system` must be a system whose attribute {word} can be read, got {gate.show(system)}"
        ) from error


def _checked_dt(dt: object) -> float | bool | None:
    if dt is None:
        return None
    if isinstance(dt, (bool, np.bool_)) and dt:
        return True
    if gate.is_real(dt) and dt == 0:
        raise InputError(_CONTINUOUS.format("`dt` is 0"))
    return gate.positive("dt", dt)


def _rebuild(A: ArrayLike, B: ArrayLike, dt: float | bool | None, name: str | None) -> System:
    return System(A, B, dt=dt, name=name)
