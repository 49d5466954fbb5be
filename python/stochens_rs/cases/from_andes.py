"""The linear model of a power system that ANDES has linearized."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import numpy as np

from .._base import memory, validation
from .._base.discretize import discretize
from .._base.types import Floats
from ..exceptions import InputError, InputTypeError
from ..system import System

__all__ = ["from_andes"]

# Relative difference up to which the reduction here gives the state matrix of ANDES.
_SAME = 1e-6


def from_andes(
    system: Any,
    *,
    inputs: Iterable[tuple[str, str]] | None = None,
    dt: float = 0.01,
    method: Literal["zoh", "euler"] = "zoh",
    eps: float = 1e-5,
) -> System:
    """Linear model of an ANDES system at its operating point; ANDES itself is not imported.

    Parameters
    ----------
    system : andes.System
        After ``system.PFlow.run()`` and ``system.EIG.run()``. Its equations are evaluated with
        changed inputs, which are then put back.
    inputs : sequence of (str, str), optional
        Pairs of a model and one of its parameters or services, such as ``("TGOV1", "pref0")``:
        every device in service gives an input. Default: ``tm0``, the mechanical torque [pu], of
        all machines of ``GENROU`` and ``GENCLS``.
    dt : float, default 0.01
        Step in seconds.
    method : {"zoh", "euler"}, default "zoh"
        ``"zoh"`` is exact for inputs held over a step, ``"euler"`` is ``I + dt A``.
    eps : float, default 1e-5
        Step of the central differences.

    Returns
    -------
    System
        States are deviations of those of ``system.EIG.x_name``, in ANDES' units (speeds in per
        unit); inputs are deviations of the parameters.

    Raises
    ------
    InputTypeError
        If `system` is not an ANDES system.
    InputError
        If it was not linearized, is not in steady state, has a state matrix that ANDES reduced by
        constraints between states, or an input that is unknown or without effect.
    ResourceError
        If its equations do not fit as dense matrices into the memory this process may use.

    Notes
    -----
    ANDES gives ``A = T^-1 (f_x - f_y g_y^-1 g_x)`` for ``T x' = f(x, y, u)``,
    ``0 = g(x, y, u)``. Here ``B = T^-1 (f_u - f_y g_y^-1 g_u)`` with f_u, g_u by differences;
    states without time constant count as y. The same elimination must give ANDES' own state
    matrix. With a limiter exactly at its bound, ANDES' matrix holds for moves to one side only.
    Tested with ANDES 2.0.

    References
    ----------
    H. Cui, F. Li and K. Tomsovic, "Hybrid symbolic-numeric framework for power system modeling
    and analysis", IEEE Trans. Power Systems 36(2), 2021.
    """
    eps = validation.positive("eps", eps)
    try:
        dae, A, names = system.dae, system.EIG.As, [str(name) for name in system.EIG.x_name]
        n, m = int(dae.n), int(dae.m)
    except Exception:  # anything a foreign object raises
        raise InputTypeError(
            f"`system` must be an ANDES system, got {validation.show(system)}"
        ) from None
    if A is None or not n:
        raise InputError("`system` has no state matrix: call PFlow.run() and EIG.run() first")
    memory.need(f"the equations of {n + m} variables", 8 * 3 * (n + m) ** 2)
    A = validation.matrix("system.EIG.As", np.array(A, dtype=float), square=True)
    J = np.block([[_dense(dae.fx), _dense(dae.fy)], [_dense(dae.gx), _dense(dae.gy)]])
    T = np.asarray(dae.Tf, dtype=float)
    x = np.flatnonzero(T)  # the states that stay
    y = np.setdiff1d(np.arange(n + m), x)
    # x' = T^-1 (J_xx - J_xy J_yy^-1 J_yx) x; columns that vanish make J_yy singular.
    gain = np.linalg.lstsq(J[np.ix_(y, y)].T, J[np.ix_(x, y)].T, rcond=None)[0].T
    own = (J[np.ix_(x, x)] - gain @ J[np.ix_(y, x)]) / T[x, None]
    if own.shape != A.shape or np.abs(own - A).max() > _SAME * np.abs(A).max():
        raise InputError(
            "`system` has a state matrix that cannot be followed: ANDES reduced it by constraints "
            f"between states ({n} states, {len(A)} kept)"
        )
    acting = _inputs(system, inputs)
    columns = [(J_u[x] - gain @ J_u[y]) / T[x] for J_u in _differences(system, acting, eps)]
    A_d, B_d = discretize(A, np.column_stack(columns), dt, method)
    name = f"{len(names)} states (ANDES, {method})"
    return System(A_d, B_d, dt=dt, name=name, states=names, inputs=[one for one, _, _ in acting])


def _dense(sparse: Any) -> Floats:
    """A sparse matrix of kvxopt or cvxopt, by its triplets."""
    dense = np.zeros(sparse.size)
    rows, columns, values = (np.array(part).ravel() for part in (sparse.I, sparse.J, sparse.V))
    np.add.at(dense, (rows.astype(int), columns.astype(int)), values)
    return dense


def _inputs(system: Any, inputs: object) -> list[tuple[str, Floats, int]]:
    """Name, values and place of every input."""
    if inputs is None:
        pairs = [
            (model, "tm0")
            for model in ("GENROU", "GENCLS")
            if getattr(getattr(system, model, None), "n", 0)
        ]
    else:
        pairs = validation.items("inputs", inputs)
    found = []
    for pair in pairs:
        try:
            model, word = pair
            device = getattr(system, model)
            values, online, devices = getattr(device, word).v, device.u.v, list(device.idx.v)
        except Exception:  # not a pair, or unknown in ANDES
            raise InputError(
                "`inputs` must hold pairs of a model and its parameter, such as "
                f"('TGOV1', 'pref0'), got {str(pair)[:60]!r}"
            ) from None
        if not isinstance(values, np.ndarray) or values.dtype != np.float64:
            raise InputError(f"`inputs`: {model}.{word} must be an array of numbers")
        for k in np.flatnonzero(online):
            own = f"{devices[k]}"
            own = own if own.startswith(model) else f"{model}_{own}"
            found.append((f"{word}_{own}", values, int(k)))
    if not found:
        raise InputError("`inputs` must name at least one device in service")
    return found


def _differences(system: Any, inputs: list[tuple[str, Floats, int]], eps: float) -> list[Floats]:
    """The derivative of (f, g) with respect to each input, by central differences."""

    def equations() -> Floats:
        system.TDS.fg_update(system.exist.pflow_tds)
        return np.concatenate([system.dae.f, system.dae.g])

    start = equations()
    if not np.abs(start).max() <= 1e-4:
        raise InputError(
            f"`system` is not in steady state: its equations are off by {np.abs(start).max():.2g}"
        )
    columns = []
    for name, values, k in inputs:
        before = values[k]
        try:
            values[k] = before + eps
            above = equations()
            values[k] = before - eps
            columns.append((above - equations()) / (2.0 * eps))
        finally:
            values[k] = before
            equations()
        if not columns[-1].any():
            raise InputError(f"`inputs`: {name} has no effect on the equations of `system`")
    return columns
