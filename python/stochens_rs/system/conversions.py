"""Arguments of `System` from continuous time and from other packages; none of these is imported.

Continuous time: from ``x' = A x + B u`` to ``x(k+1) = A_d x(k) + B_d u(k)``.
"""

from __future__ import annotations

import json
import math
from contextlib import suppress
from typing import Any

import numpy as np

from .._base import running, validation
from .._base.reading import matrices
from .._base.types import Floats, NDArray
from ..exceptions import InputError, InputTypeError

# Coefficients of the (13, 13) Pade approximant of exp, b_k = (26-k)! 13! / (26! k! (13-k)!),
# scaled to integers; theta_13 is the largest 1-norm for which its backward error is below 2^-53.
_PADE = tuple(
    math.factorial(26 - k) // (math.factorial(k) * math.factorial(13 - k)) for k in range(14)
)
_PADE_13 = tuple(float(c // _PADE[13]) for c in _PADE)
_THETA_13 = 5.371920351148152

# Each squaring while a part of the state lasts doubles the relative error of that part: after more
# of them, fewer than about six digits of it would be correct.
_SQUARINGS = 28
_SWEEPS = 100  # each halves the logarithms of what is out of balance


def expm(X: Floats, n: int) -> tuple[Floats, int]:
    """Matrix exponential by scaling and squaring with the (13, 13) Pade approximant.

    Parameters
    ----------
    X : (k, k) array
    n : int
        The size of the block in the upper left corner that is watched.

    Returns
    -------
    (k, k) array
        ``exp(X) = r_13(X / 2^s)^(2^s)`` with the smallest ``s`` such that
        ``||X||_1 / 2^s <= theta_13``. Entries that overflow are inf or nan.
    int
        How many of the s squarings found the exponential of the block with a norm above 1/2.

    References
    ----------
    N. J. Higham, "The scaling and squaring method for the matrix exponential revisited",
    SIAM J. Matrix Anal. Appl. 26(4), 2005.
    """
    norm = float(np.abs(X).sum(axis=0).max())
    squarings = max(0, math.ceil(math.log2(norm / _THETA_13))) if norm > 0.0 else 0
    X = np.ldexp(X, -squarings)
    b = _PADE_13
    identity = np.eye(X.shape[0])
    X2 = X @ X
    X4 = X2 @ X2
    X6 = X4 @ X2
    # Odd part U and even part V of the numerator; the denominator is V - U.
    U = X @ (
        X6 @ (b[13] * X6 + b[11] * X4 + b[9] * X2)
        + b[7] * X6 + b[5] * X4 + b[3] * X2 + b[1] * identity
    )  # fmt: skip
    V = (
        X6 @ (b[12] * X6 + b[10] * X4 + b[8] * X2)
        + b[6] * X6 + b[4] * X4 + b[2] * X2 + b[0] * identity
    )  # fmt: skip
    # (V - U)^-1 (V + U), in the form that is exact at X = 0 and accurate near it.
    result = identity + 2.0 * np.linalg.solve(V - U, U)
    lasting = 0
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(squarings):
            lasting += not np.abs(result[:n, :n]).sum(axis=0).max() <= 0.5
            result = result @ result
    return np.asarray(result, dtype=np.float64), lasting


def balance(A: Floats) -> NDArray[np.int64]:
    """Exponents e of the states ``x_i = 2^e_i z_i`` in which rows and columns of A are alike.

    Osborne's iteration: with r and c the sums of row and column i beside the diagonal, unit i
    becomes ``(r / c)^(1/2)`` times as large. A state that acts on no other, or that no other acts
    on, is scaled until its sum is below 1, where nothing is left to gain.

    References
    ----------
    E. E. Osborne, "On pre-conditioning of matrices", J. ACM 7(4), 1960.
    """
    beside = np.abs(A)
    np.fill_diagonal(beside, 0.0)
    e = np.zeros(len(A), dtype=np.int64)
    for _ in range(_SWEEPS):
        moved = False
        for i in range(len(A)):
            row, column = float(beside[i].sum()), float(beside[:, i].sum())
            if not row + column > 0.0 or not math.isfinite(row + column):
                continue
            ratio = (row or min(column, 1.0)) / (column or min(row, 1.0))
            k = round(math.log2(ratio) / 2.0)
            if k and math.ldexp(column, k) + math.ldexp(row, -k) < 0.95 * (row + column):
                beside[i], beside[:, i] = np.ldexp(beside[i], -k), np.ldexp(beside[:, i], k)
                e[i] += k
                moved = True
        if not moved:
            break
    return e


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
    dt = validation.positive("dt", dt)
    n, m = B.shape
    with np.errstate(over="ignore"):
        if validation.choice("method", method, ("zoh", "euler")) == "euler":
            A_d, B_d = np.eye(n) + dt * A, dt * B
        else:
            augmented = np.zeros((n + m, n + m))
            # exp(D^-1 A D) = D^-1 exp(A) D: in units of the states that suit A the entries of
            # the exponential have their digits, and only time scales are left in its norm
            e = balance(dt * A)
            augmented[:n, :n] = np.ldexp(dt * A, e - e[:, None])
            # B_d is linear in dt B: its columns are brought to a 1-norm below 1 by powers of two,
            # hence exactly, and then have no part in the norm that chooses the scaling
            short, exponent = np.frexp(dt)
            largest = np.frexp(np.abs(B).max(axis=0))[1]
            scaled = np.ldexp(np.ldexp(B, -largest), -e[:, None])
            more = np.frexp(np.abs(scaled).sum(axis=0))[1]
            augmented[:n, n:] = short * np.ldexp(scaled, -more)
            norm = float(np.abs(augmented[:, :n]).sum(axis=0).max())
            whole, lasting = expm(augmented, n) if norm < np.inf else (augmented, _SQUARINGS + 1)
            if lasting > _SQUARINGS:
                raise InputError(
                    f"`dt` is too large ({dt:g} s) for the time scales of the system: dt A has the "
                    f"norm {norm:.1g} in balanced units, and a part of the state lasts for so long "
                    "that fewer than six digits of it would be right; take a shorter step"
                )
            A_d = np.ldexp(whole[:n, :n], e[:, None] - e)
            B_d = np.ldexp(whole[:n, n:], exponent + largest + more + e[:, None])
    for name, found in (("A", A_d), ("B", B_d)):
        if not np.isfinite(found).all():
            raise InputError(
                f"`dt` is too large ({dt:g} s): {name} of the discretized system is not finite"
            )
    return np.ascontiguousarray(A_d), np.ascontiguousarray(B_d)


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
        raise InputTypeError(
            f"`system` must be a tuple (A, B) or (A, B, dt), got {len(system)} items"
        )
    dt = system[2] if len(system) == 3 else None
    if not (dt is None or isinstance(dt, (bool, np.bool_)) or validation.is_real(dt)):
        raise InputTypeError(
            "`system` must be (A, B) or (A, B, dt) with a number dt > 0, got "
            f"{validation.show(dt)} as third item"
        )
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
        raise InputError(
            f"`system` cannot be brought into state space by its to_ss(): {said}"
        ) from error
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
            f"`system` must be a system whose attribute {word} can be read, got "
            f"{validation.show(system)}"
        ) from error
