"""The lossless swing model of a network from its branches and machines."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from .._base import memory, validation
from .._base.discretize import discretize
from ..exceptions import InputError
from ..system import System
from ._machines import read_machines
from ._swing import FREQUENCY_HZ, SYSTEM_MVA, checked_frequency, reduced_stiffness, swing_labels
from ._swing import swing as swing_matrices

__all__ = ["swing"]


def swing(
    branches: ArrayLike,
    machines: object,
    *,
    dt: float = 0.01,
    method: Literal["zoh", "euler"] = "zoh",
    base: Literal["system", "machine"] = "system",
    base_mva: float = SYSTEM_MVA,
    frequency: float = FREQUENCY_HZ,
    name: str | None = None,
) -> System:
    """Lossless swing model of a network, reduced to its machines: the model of `ieee14`.

    Parameters
    ----------
    branches : array_like, shape (b, 3)
        Rows ``(from, to, x)``: two bus numbers and the series reactance of the line or
        transformer [pu on `base_mva`], positive.
    machines : mapping, DataFrame or path of a CSV file
        As in :func:`from_matpower`: ``bus``, ``H`` [s], ``D`` [pu], ``xd1`` [pu], optionally
        ``mva``.
    dt : float, default 0.01
        Step in seconds.
    method : {"zoh", "euler"}, default "zoh"
        ``"zoh"`` is exact for inputs held over a step, ``"euler"`` is ``I + dt A``.
    base : {"system", "machine"}, default "system"
        Whether the machines are given on `base_mva`, or each on its ``mva``.
    base_mva : float, default 100
        Base power of the system.
    frequency : float, default 60
        Nominal frequency [Hz].
    name : str, optional
        Label of the system.

    Returns
    -------
    System
        For g machines, in their order: ``A`` (2 g, 2 g), ``B`` (2 g, g). States: rotor angles
        [rad], then speed deviations [rad/s]. Inputs: mechanical powers [pu on `base_mva`].

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    ResourceError
        If the stiffness matrix does not fit into the memory this process may use.

    Notes
    -----
    ``M delta'' + D delta' + L delta = P`` with ``M = 2 H / w0``. A machine is a constant voltage
    behind x'd. The network has no resistances, charging, taps and loads, all voltages are 1 pu,
    and it is linearized at equal angles: a reactance x is a spring of stiffness 1/x, and ``L`` is
    what remains of the springs when the buses are eliminated. Modes come out too fast where
    machines are heavily loaded; :func:`from_matpower` keeps all that at an operating point.

    References
    ----------
    F. Doerfler and F. Bullo, "Kron reduction of graphs with applications to electrical networks",
    IEEE Trans. Circuits and Systems I 60(1), 2013.

    Examples
    --------
    >>> from stochens_rs.cases import swing
    >>> machines = {"bus": [1, 3], "H": [4.0, 6.0], "D": [2.0, 2.0], "xd1": [0.3, 0.2]}
    >>> swing([[1, 2, 0.1], [2, 3, 0.2]], machines, dt=0.05, name="two machines")
    <System two machines: n=4 m=2 dt=0.05>
    """
    validation.choice("base", base, ("system", "machine"))
    given = validation.matrix("branches", branches, cols=3)
    if not (given[:, 2] > 0.0).all():
        k = int(np.argmin(given[:, 2]))
        raise InputError(f"`branches[{k}]` must have a reactance > 0, got {given[k, 2]:g}")
    data = read_machines(machines).on(base, validation.positive("base_mva", base_mva), None)
    numbers, ends = np.unique(given[:, :2], return_inverse=True)
    place = {float(number): k for k, number in enumerate(numbers)}
    lost = [bus for bus in data.bus.tolist() if bus not in place]
    if lost:
        raise InputError(f"`machines` names bus {lost[0]}, which no branch has")
    memory.need(f"the stiffness of {len(numbers)} buses", 8 * 3 * len(numbers) ** 2)
    rows = [
        (int(f) + 1, int(t) + 1, float(x))
        for (f, t), x in zip(ends.reshape(-1, 2), given[:, 2], strict=True)
    ]
    at = [place[bus] + 1 for bus in data.bus.tolist()]
    hertz = checked_frequency(frequency)
    with np.errstate(all="ignore"):  # what is not finite is refused
        try:
            L = reduced_stiffness(len(numbers), rows, at, data.xd1)
        except np.linalg.LinAlgError:
            raise InputError("`branches` must connect every bus to a machine") from None
        A_c, B_c = swing_matrices(validation.matrix("L", L), data.H, data.D, hertz)
    A, B = discretize(A_c, B_c, dt, method)
    return System(A, B, dt=dt, name=name, **swing_labels(data.bus.tolist()))
