"""Arguments of `System` from continuous time and from other packages; none of these is imported.

Continuous time: from ``x' = A x + B u`` to ``x(k+1) = A_d x(k) + B_d u(k)``.
"""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Any

import numpy as np

from .. import _core
from .._base import running, validation
from .._base.reading import matrices
from .._base.types import Floats
from ..exceptions import InputError, InputTypeError


def discretize(A: Floats, B: Floats, dt: float, method: str) -> tuple[Floats, Floats]:
    """Discrete-time matrices for a step of ``dt`` seconds.

    Parameters
    ----------
    A : (n, n) array
    B : (n, m) array
    dt : float
        Step in seconds.
    method : {"zoh", "euler"}
        ``"zoh"``: exact for inputs held constant over a step,
        ``[[A_d, B_d], [0, I]] = exp(dt [[A, B], [0, 0]])``; A_d depends on A only, and the units of
        an input on its column of B_d only. ``"euler"``: ``A_d = I + dt A``, ``B_d = dt B``, which
        keeps the zeros of ``A`` (``"zoh"`` fills them).

    Returns
    -------
    A_d : (n, n) array
    B_d : (n, m) array

    Raises
    ------
    InputError
        ``dt`` is not a positive number, or is so large that the result overflows or (``"zoh"``)
        has no correct digits; ``method`` is unknown.
    """
    step = validation.positive("dt", dt)
    if validation.choice("method", method, ("zoh", "euler")) == "zoh":
        return _core.zero_order_hold(np.ascontiguousarray(A), np.ascontiguousarray(B), step)
    with np.errstate(over="ignore"):  # `System` refuses what is not finite
        return np.eye(len(A)) + step * A, step * B


CONTINUOUS = (
    "{}, which means continuous time: discretize it, e.g. with System.from_any(system, dt=0.01), "
    "which holds the inputs constant over each step of 0.01 s"
)
# How far off a pole may lie, as a share of its distance from the circle of modulus 1; and how far
# rounding moves double poles, which lie nowhere better than eps^(1/2).
_OFF, _CLUSTERED = 0.02, 1e-7
# python-control names systems without a name sys[0], sys[1], ... and what it makes of G G$converted
_UNNAMED = "sys["


def arguments(system: Any, dt: Any) -> dict[str, Any]:
    """The arguments of `System` for a tuple or an object of another package.

    A system in continuous time is discretized with `dt`.
    """
    if isinstance(system, type):
        raise InputTypeError(f"`system` must be a System, got the class {system.__name__[:40]}")
    found = _of_tuple(system) if isinstance(system, tuple) else _of_object(system)
    continuous, poles = found.pop("continuous"), found.pop("poles", None)
    if continuous:
        found = _discretized(found, dt)
    else:
        same_step(found["dt"], dt)
    if poles is not None:
        _compare_poles(found["A"], np.exp(found["dt"] * poles) if continuous else poles)
    return found


def same_step(own: Any, dt: Any) -> None:
    """Refuse a step for a system in discrete time, unless it is its own."""
    if dt is not None and (
        isinstance(own, bool) or own is None or own != validation.positive("dt", dt)
    ):
        raise InputError(
            f"`dt` must be left out for a system in discrete time, whose dt is {own}, got "
            f"{validation.show(dt)}: it discretizes systems in continuous time"
        )


def checked_dt(dt: object) -> float | bool | None:
    """The `dt` of a system in discrete time."""
    if dt is None:
        return None
    if isinstance(dt, (bool, np.bool_)) and dt:
        return True
    if validation.is_real(dt) and dt == 0:
        raise InputError(CONTINUOUS.format("`dt` is 0"))
    return validation.positive("dt", dt)


def _of_tuple(system: tuple[Any, ...]) -> dict[str, Any]:
    if len(system) not in (2, 3):
        raise InputTypeError(f"`system` must be (A, B) or (A, B, dt), got {len(system)} items")
    dt = system[2] if len(system) == 3 else None
    if not (dt is None or isinstance(dt, (bool, np.bool_)) or validation.is_real(dt)):
        raise InputTypeError(f"`system` must have a number dt, got {validation.show(dt)}")
    continuous = validation.is_real(dt) and dt == 0
    return {"A": system[0], "B": system[1], "dt": dt, "continuous": continuous}


def _of_object(system: Any) -> dict[str, Any]:
    realized, poles = "", None
    if _package(system) and attribute(system, "A") is None and attribute(system, "to_ss"):
        poles = _poles(system)
        system, realized = _state_space(system)
    found = {word: attribute(system, word) for word in ("A", "B", "dt", "name")}
    if found["A"] is None or found["B"] is None:
        hint = ""
        if isinstance(system, list):
            hint = "; use a tuple (A, B)"
        elif isinstance(system, np.ndarray):
            hint = "; pass (A, B)"
        elif attribute(system, "to_ss", ...) is not ...:
            hint = "; call its to_ss() first"
        raise InputTypeError(
            "`system` must be a System, a tuple (A, B[, dt]) or an object with attributes A "
            f"and B, got {validation.show(system)}{hint}"
        )
    if attribute(system, "centre") == "estimate":
        one = "`mean()`" if attribute(system, "mean", ...) is not ... else "`system`"
        raise InputError(
            f"`system` must be known, got {validation.show(system)} estimated from data: pass its "
            f"{one} to take the estimate as exact"
        )
    if np.ndim(found["A"]) == 3:
        raise InputTypeError(
            f"`system` must be one system, got {validation.show(system)} of {len(found['A'])}: "
            "pass its `mean()`, or all of them to simulate_ensemble or control_fleet"
        )
    found["poles"] = poles
    name = found["name"]
    named = isinstance(name, str) and not name.startswith(_UNNAMED)
    found["name"] = _joined(name.partition("$")[0] if named else None, realized)
    for argument, word in (("states", "state_labels"), ("inputs", "input_labels")):
        names = attribute(system, word)
        found[argument] = names if isinstance(names, list) and names else None
    units, found["units"] = attribute(system, "units"), None
    if isinstance(units, str):  # of a Dataset from `to_xarray`
        with suppress(ValueError, RecursionError):
            found["units"] = json.loads(units)
    # scipy.signal sets dt = None for continuous systems; only their class says so.
    signal = _package(system) == "scipy.signal"
    lti = signal and any(kind.__name__ == "lti" for kind in type(system).__mro__)
    found["continuous"] = lti or (validation.is_real(found["dt"]) and found["dt"] == 0)
    return found


def _state_space(system: Any) -> tuple[Any, str]:
    """A transfer function in state space, as its package realizes it; and what to say of it."""
    try:
        made = system.to_ss()
    except MemoryError:
        raise
    except Exception as error:  # improper, of several inputs without Slycot, ...
        said = " ".join(str(error).split())[:120]
        raise InputError(f"`system` has no state space by its to_ss(): {said}") from error
    return made, f"realized by {_package(system)} to_ss"


def _poles(system: Any) -> Any:
    """The poles of a transfer function, or None where its package cannot tell them."""
    try:
        poles = system.poles
        return np.asarray(poles() if callable(poles) else poles, dtype=np.complex128).ravel()
    except MemoryError:
        raise
    except Exception:  # of several inputs without Slycot, ...
        return None


def _compare_poles(A: Any, wanted: Any) -> None:
    """Warn where the eigenvalues of a realization are not the poles of its transfer function.

    Where a pole of modulus r lies off by more than `_OFF` of ``|1 - r|``, what it says of stability
    and of slow modes is another thing.
    """
    found = np.linalg.eigvals(np.asarray(A, dtype=np.float64))
    if not (len(wanted) and np.isfinite(wanted).all()):
        return
    apart = np.abs(found[:, None] - wanted)
    nearest = wanted[apart.argmin(axis=1)]
    off = apart.min(axis=1) - np.maximum(_OFF * np.abs(1.0 - np.abs(nearest)), _CLUSTERED)
    if off.max() > 0.0:
        k = int(off.argmax())
        largest, true = float(np.abs(found).max()), float(np.abs(wanted).max())
        running.warn(
            f"the realization of the transfer function has other poles: {found[k]:.6g} where "
            f"{nearest[k]:.6g} is the nearest, and {largest:.6g} as largest modulus for "
            f"{true:.6g}; polynomials of order {len(wanted)} determine their roots badly: pass "
            "a state space of first- and second-order parts in series"
        )


def _discretized(found: dict[str, Any], dt: Any) -> dict[str, Any]:
    if dt is None:
        said = "`system` is a scipy.signal.lti" if found["dt"] is None else "`dt` is 0"
        raise InputError(CONTINUOUS.format(said))
    step = validation.positive("dt", dt)
    names = found.get("states"), found.get("inputs")
    A, B, states, inputs = matrices(found["A"], found["B"], *names)
    of_A = validation.matrix("A", A, square=True)
    of_B = validation.matrix("B", B, rows=len(of_A))
    of_A, of_B = discretize(of_A, of_B, step, "zoh")
    name = _joined(found.get("name"), "zero-order hold")
    return {
        "A": of_A, "B": of_B, "dt": step, "name": name, "states": states, "inputs": inputs,
        "units": found.get("units"),
    }  # fmt: skip


def _joined(name: str | None, more: str) -> str | None:
    return f"{name}, {more}" if name and more else name or more or None


def _package(system: Any) -> str:
    """The package a class of transfer functions or state space comes from, or ""."""
    for kind in type(system).__mro__:
        if kind.__module__.startswith("scipy.signal"):
            return "scipy.signal"
        if kind.__module__.partition(".")[0] == "control":
            return "control"
    return ""


def attribute(system: object, word: str, missing: object = None) -> Any:
    """Return an attribute of any object, or `missing`."""
    try:
        return getattr(system, word, missing)
    except Exception as error:  # a property can raise anything
        raise InputTypeError(
            f"`system` has no {word} to read, {validation.show(system)}"
        ) from error
