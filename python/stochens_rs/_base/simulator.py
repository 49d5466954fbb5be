"""The linear model of a MuJoCo simulation near a point, from MuJoCo's own finite differences."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import numpy as np

from ..exceptions import InputError, InputTypeError
from . import memory, validation
from .extras import extra
from .types import Floats

if TYPE_CHECKING:
    from typing_extensions import Self


class FromSimulator:
    """How a `System` is made from a simulator."""

    __slots__ = ()

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
    ) -> Self:
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
        A, B, about = linear_mujoco(
            model,
            data,
            validation.size("frame_skip", frame_skip),
            validation.positive("eps", eps),
            validation.flag("centered", centered),
            validation.nonnegative("tolerance", tolerance),
        )
        return cls(A, B, **about)  # type: ignore[call-arg]


def linear_mujoco(
    model: Any, data: Any, frame_skip: int, eps: float, centered: bool, tolerance: float
) -> tuple[Floats, Floats, dict[str, Any]]:
    """A, B, and what else a `System` is made from: step, name, names of states and inputs."""
    with extra("from_mujoco uses MuJoCo", "mujoco"):
        import mujoco
    for name, value, kind in (("model", model, mujoco.MjModel), ("data", data, mujoco.MjData)):
        if not isinstance(value, kind):
            raise InputTypeError(
                f"`{name}` must be a mujoco.{kind.__name__}, got {validation.show(value)}"
            )
    nv, na, nu = int(model.nv), int(model.na), int(model.nu)
    if data.qvel.size != nv or data.qpos.size != model.nq or data.ctrl.size != nu:
        raise InputError("`data` must be of `model`: mujoco.MjData(model)")
    if not (nv and nu):
        raise InputError(f"`model` must have joints and actuators, got nv={nv} and nu={nu}")
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        raise InputError(
            "`model` uses the integrator RK4, which MuJoCo cannot differentiate: set "
            "model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST (or mjINT_EULER) "
            "before simulating and linearizing"
        )
    for word in ("qpos", "qvel", "ctrl", "act"):
        if getattr(data, word).size:
            validation.vector(f"data.{word}", getattr(data, word))
    n = 2 * nv + na
    memory.need("the linear model", 8 * 4 * (n + nu) ** 2)
    names = _names(mujoco, model, nv)
    _check_drift(mujoco, model, data, frame_skip, tolerance, names["states"])
    # One call of mj_step: [x(k+1); u] = [[A, B], [0, I]] [x(k); u]; the input is held.
    A, B = np.zeros((n, n)), np.zeros((n, nu))
    mujoco.mjd_transitionFD(model, copy.copy(data), eps, centered, A, B, None, None)
    step = np.block([[A, B], [np.zeros((nu, n)), np.eye(nu)]])
    whole = np.linalg.matrix_power(step, frame_skip)
    title = model.names.split(b"\0", 1)[0].decode(errors="replace") or "model"
    about = {"dt": frame_skip * float(model.opt.timestep), "name": f"{title} (MuJoCo)", **names}
    return whole[:n, :n], whole[:n, n:], about


def _check_drift(
    mujoco: Any, model: Any, data: Any, frame_skip: int, tolerance: float, states: list[str]
) -> None:
    """Refuse a point that moves by itself, because x(k+1) = A x(k) + B u(k) has no offset."""
    later = copy.copy(data)
    for _ in range(frame_skip):
        mujoco.mj_step(model, later)
    turned = np.zeros(model.nv)  # of the joints, in the space of their speeds
    mujoco.mj_differentiatePos(model, turned, 1.0, data.qpos, later.qpos)
    drift = np.abs(np.concatenate([turned, later.qvel - data.qvel, later.act - data.act]))
    k = int(np.argmax(drift))
    if not drift[k] <= tolerance:
        raise InputError(
            f"`data` is not at an equilibrium: without a change of ctrl, {states[k]} moves by "
            f"{drift[k]:.2g} in one control step (allowed: {tolerance:g}); set qpos, qvel = 0 and "
            "the ctrl that holds it (mujoco.mj_inverse gives the forces), or let it settle, or "
            "allow more with tolerance="
        )


def _names(mujoco: Any, model: Any, nv: int) -> dict[str, Any]:
    """Names of the positions, speeds, activations and inputs."""

    def name(kind: Any, k: int, word: str) -> str:
        return mujoco.mj_id2name(model, kind, k) or f"{word}{k}"

    joint = [name(mujoco.mjtObj.mjOBJ_JOINT, int(k), "joint") for k in model.dof_jntid]
    own = [k - int(model.jnt_dofadr[model.dof_jntid[k]]) for k in range(nv)]
    many = {j for j, k in zip(joint, own, strict=True) if k}  # free joints and balls
    dof = [f"{j}[{k}]" if j in many else j for j, k in zip(joint, own, strict=True)]
    actuators = [name(mujoco.mjtObj.mjOBJ_ACTUATOR, k, "actuator") for k in range(model.nu)]
    activations = [
        f"act_{actuators[k]}[{i}]" if model.actuator_actnum[k] > 1 else f"act_{actuators[k]}"
        for k in range(model.nu)
        for i in range(model.actuator_actnum[k])
    ]
    states = [f"q_{d}" for d in dof] + [f"v_{d}" for d in dof] + activations
    return {"states": states, "inputs": actuators}
