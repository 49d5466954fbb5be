"""The closed loop of a system and a controller, step by step in Python as it calls one."""

from __future__ import annotations

from collections import Counter
from copy import deepcopy
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._base import html, validation
from .._base.signal_names import order_of
from .._base.types import worst
from ..controls import Regulator
from ..exceptions import InputError, InputTypeError, NonFiniteError
from ..feedback import Loop

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from .._base.types import Floats, Status
    from ..rng import Key
    from ..system import System


class Driven(NamedTuple):
    """States (R, K + 1, n) and inputs (R, K, m), and how the computations ended."""

    states: Floats
    inputs: Floats
    status: Status
    info: dict[str, Any]


def controlled(
    system: System,
    start: Floats,
    K: int,
    controller: Callable[[Floats], Any],
    noise: Any,
    key: Key,
    runs: int | None,
) -> Driven:
    """Simulate ``x(k+1) = A x(k) + B u(k) + w(k)`` with ``u(k) = controller(x(k))``."""
    if not callable(controller) or isinstance(controller, type):
        raise InputTypeError(
            f"`controller` must be a function, u = f(x), got {validation.show(controller)}"
        )
    n, m = system.n, system.m
    loop = controller if isinstance(controller, Regulator) else None
    sizes, labels = (n, m), None
    if loop is not None:
        sizes, labels = (loop.n, loop.m), loop._labels
    elif isinstance(controller, Loop):
        sizes, labels = controller.B.shape, controller.labels
    if sizes != (n, m):
        raise InputError(
            "`controller` must be for n={} and m={} as `system`, got n={} and m={}".format(
                n, m, *sizes
            )
        )
    # what the controller calls by the same names stands where it has it
    order = order_of("system", system.labels, labels)
    back = order.back()
    sigma = validation.deviations("noise", 0.0 if noise is None else noise, n)
    states, inputs = np.empty((runs or 1, K + 1, n)), np.empty((runs or 1, K, m))
    seen: Counter[Status] = Counter()
    for i, (x, u) in enumerate(zip(states, inputs, strict=True)):
        # every run begins with the controller as it was given
        act = controller if loop is None or runs is None else deepcopy(loop)
        w = key.child(f"replicate-{i}").child("noise").generator().standard_normal((K, n)) * sigma
        x[0] = start
        for k in range(K):
            found = validation.vector("controller(x)", act(order.of_states(x[k]).copy()), length=m)
            u[k] = back.of_inputs(found)
            if isinstance(act, Regulator):
                seen[act.log[-1].status] += 1
            with np.errstate(over="ignore", invalid="ignore"):
                x[k + 1] = system.A @ x[k] + system.B @ u[k] + w[k]
            if not np.isfinite(x[k + 1]).all():
                raise NonFiniteError(f"the state overflows at step {k + 1} under `controller`")
    info = {
        "controller": type(controller).__name__,
        "limits": None if loop is None else tuple(map(back.of_inputs, loop.limits)),
        "statuses": dict(seen),
        "noise": sigma,
    }
    return Driven(states, inputs, worst(seen) if seen else "completed", info)


def check_info(info: dict[str, Any]) -> None:
    """Refuse a description of what chose the inputs that `made_by` cannot read."""
    for name in ("size", "runs"):
        if info.get(name) is not None:
            validation.size(f"info['{name}']", info[name])
    limits = info.get("limits")
    if limits is not None:
        pair = isinstance(limits, tuple) and len(limits) == 2
        if not pair or not all(isinstance(one, np.ndarray) and one.ndim == 1 for one in limits):
            raise InputTypeError(
                f"`info['limits']` must be (low, high), got {validation.show(limits)}"
            )
        validation.instance("info['statuses']", info.get("statuses"), dict)


def made_by(info: dict[str, Any]) -> Iterator[tuple[str, object]]:
    """Rows about what chose the inputs."""
    if "size" in info:
        yield "realizations N per step", html.grouped(info["size"])
        return
    yield "controller", info.get("controller")
    if info.get("limits") is not None:
        low, high = map(html.vector, info["limits"])
        yield "limits", f"{low} to {high}"
        yield "calls", ", ".join(f"{count} {what}" for what, count in info["statuses"].items())
