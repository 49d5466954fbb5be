"""Controls from realizations: ``u = B^+ (xf - A x0)``, one per realization or fused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, overload

import numpy as np

from .. import _core
from .._base import gate, memory, numbers
from .._base.threads import get_num_threads
from ..ensembles.ensemble import Counts, Ensemble
from ..ensembles.sampling import sample
from ..exceptions import InputError, InputTypeError, ShapeError
from ..fusion import alse
from ..fusion.fusing import METHODS, fuse
from ..rng import RngLike, as_key
from ..system import System
from ..theory import exact as _exact
from .plan import Fit, Plan
from .plan_bound import Basis, known

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ..fusion.fusing import Method
    from .trajectory_plan import TrajectoryPlan

    Floats: TypeAlias = NDArray[np.float64]
    EntityLike: TypeAlias = Fit | Ensemble | Counts | ArrayLike

Fusion: TypeAlias = Literal["product", "diagonal"]

_FUSIONS = ("product", "diagonal")


def realization_controls(
    B: ArrayLike,
    x0: EntityLike,
    xf: EntityLike,
    A: EntityLike,
    *,
    out: Floats | None = None,
) -> Floats:
    """Compute one control per realization, ``u^s = B^+ (xf^s - A^s x0^s)``.

    Parameters
    ----------
    B : array_like, shape (n, m)
        Input matrix.
    x0, xf : Ensemble or array_like, shape (n,)
        Realizations of the initial state and the target; an array is the same for all.
    A : Ensemble or array_like, shape (n, n)
        Realizations of the system matrix; an array is the same for all.
    out : ndarray of float64, shape (N, m), optional
        Where to write the controls: C-contiguous, writeable, sharing no memory with the other
        arguments. Memory that was used before saves more time than the controls take. After an
        exception its entries mean nothing.

    Returns
    -------
    ndarray, shape (N, m)
        ``u[s]`` belongs to realization s of every ensemble (N = 1 if all are arrays); `out` itself
        if it was given.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used, the ensembles differ in size, or a control overflows.
    SolverError
        If the singular value decomposition of B does not converge.

    Notes
    -----
    ``B^+`` is the Moore-Penrose inverse; singular values up to ``eps max(n, m) sigma_max`` count
    as zero. For singletons a control costs O(m). Its mean is ``B^+ (xf - A x0)``.

    Here ``B^+`` is a matrix, formed once for all realizations. Rounding leaves the control off by
    about ``eps condition(B) ||u||`` as it does everywhere, but the state ``B u`` by about
    ``eps condition(B) ||xf - A x0||``, where that of `control` is off by ``eps ||B|| ||u||`` only.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0], [0.5]])
    >>> u = se.realization_controls(B, [1.0, 2.0], [0.0, 0.0], se.sample(A, 5, rng=1))
    >>> u.shape
    (5, 1)
    >>> again = np.empty((5, 1))
    >>> v = se.realization_controls(B, [1.0, 2.0], [0.0, 0.0], se.sample(A, 5, rng=1), out=again)
    >>> v is again, bool((v == u).all())
    (True, True)
    """
    inputs = gate.matrix("B", B)
    entities = _entities(x0, xf, A, n=inputs.shape[0])
    start, goal, matrix = (entity.realizations() for entity in entities)
    pinv = _exact.factors(inputs).inverse
    size = max(entity.size or 1 for entity in entities)
    shape = (size, inputs.shape[1])
    if out is None:
        memory.need("the controls", size * inputs.shape[1] * 8)
        # not from the core: NumPy asks the system for large pages, which are filled far sooner
        controls = np.empty(shape)
    else:
        controls = gate.output("out", out, shape, {"B": B, "x0": x0, "xf": xf, "A": A})
    _core.realization_controls(
        controls, out is None, pinv, start, goal, matrix, entities[2].by_rows, get_num_threads()
    )
    return controls


def control(
    B: ArrayLike,
    x0: EntityLike,
    xf: EntityLike,
    A: EntityLike,
    *,
    fusion: Fusion = "product",
) -> Plan:
    """Compute the fused control for one step from x0 to xf.

    Parameters
    ----------
    B : array_like, shape (n, m)
        Input matrix.
    x0, xf : Fit, Ensemble, Counts or array_like, shape (n,)
        Initial state and target. A Fit or Counts stands for its estimate, an Ensemble for its
        uniform average, an array for itself.
    A : Fit, Ensemble, Counts or array_like, shape (n, n)
        System matrix.
    fusion : {"product", "diagonal"}, default "product"
        "product": ``B^+ (xf_hat - A_hat x0_hat)``. "diagonal": the average of the controls of the
        paired realizations, as in the paper; it needs ensembles of equal size (or arrays).

    Returns
    -------
    Plan
        The control, the state it should lead to, and what is out of reach.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    SolverError
        If the singular value decomposition of B does not converge.

    Notes
    -----
    Both have the mean ``B^+ (xf - A x0)``; product fusion is never worse, in the Loewner order of
    the covariances and for every convex loss. Product fusion is the sum over all triples of
    realizations with product weights, evaluated in O(N) (paper, Lemma 3.2, where one index is
    used for three weight vectors). With m < n a target is in general not reachable in one step;
    the control is then the least-squares one and ``reachability`` says what is left.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0, 0.0], [0.5, 1.0]])
    >>> x0 = [1.0, 2.0]
    >>> fit = se.fuse(se.sample(A, 500, rng=1), "alse", target=A)
    >>> plan = se.control(B, se.sample(x0, 500, rng=2), [0.0, 0.0], fit)
    >>> plan.status, plan.reachability.reachable
    ('optimal', True)
    """
    inputs = gate.matrix("B", B)
    fusion = "diagonal" if gate.choice("fusion", fusion, _FUSIONS) == "diagonal" else "product"
    entities = _entities(x0, xf, A, n=inputs.shape[0])
    estimates: tuple[Floats | None, ...] = (None, None, None)
    if fusion == "diagonal":
        first, last, matrices = (entity.realizations() for entity in entities)
        by_rows = entities[2].by_rows
        difference = _core.mean_difference(inputs.shape[0], first, last, matrices, by_rows)
        goal = entities[1].estimate()
        free = goal - difference  # the average of A^s x0^s
        estimates = None, goal, None
        unsure = _exact.EPS * (
            numbers.norm(free) + numbers.norm(goal)
        )  # the averages count as exact
    else:
        start, goal, matrix = (entity.estimate() for entity in entities)
        estimates = start, goal, matrix
        with np.errstate(over="ignore", invalid="ignore"):
            free = matrix @ start
            difference = goal - free
            unsure = _exact.summed(matrix, start, goal)
    best = _exact.best(inputs, free, difference, unsure)
    info: dict[str, Any] = {entity.name: entity.description for entity in entities}
    info["singular_values"] = best.factors.singular_values
    plan = Plan(
        u=best.u,
        predicted_state=best.reached,
        reachability=best.reachability(),
        fusion=fusion,
        status=alse.worst([entity.status for entity in entities]),
        info=info,
    )
    x0_known, xf_known, A_known = (
        known(entity.name, entity.value, estimate)
        for entity, estimate in zip(entities, estimates, strict=True)
    )
    object.__setattr__(plan, "_basis", Basis(inputs.copy(), x0_known, xf_known, A_known))
    return plan


@overload
def steer(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: int,
    *,
    method: Method = "uniform",
    fusion: Fusion = "product",
    rng: RngLike = None,
    steps: None = None,
) -> Plan: ...


@overload
def steer(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: int,
    *,
    method: Method = "uniform",
    fusion: Fusion = "product",
    rng: RngLike = None,
    steps: int,
) -> TrajectoryPlan: ...


def steer(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: int,
    *,
    method: Method = "uniform",
    fusion: Fusion = "product",
    rng: RngLike = None,
    steps: int | None = None,
) -> Plan | TrajectoryPlan:
    """Sample x0, xf and A, fuse them, and compute the control: all in one call.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes.
    x0, xf : array_like, shape (n,)
        Initial state and target.
    size : int
        Number of realizations of each entity.
    method : {"uniform", "alse", "slse", "slse-safeguarded"}, default "uniform"
        How to fuse; the least-squares methods fit to the exact entity, as in the paper's analysis.
    fusion : {"product", "diagonal"}, default "product"
        As in `control`; "diagonal" goes with method "uniform" only.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness; the entities draw from its children "x0", "xf" and "A".
    steps : int, optional
        Number of steps K to reach the target in, as in `control_steps`; None: one step, as in
        `control`.

    Returns
    -------
    Plan or TrajectoryPlan
        The fused control, a TrajectoryPlan if `steps` is given; ``info["key"]`` repeats it.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it. Among them fusion="diagonal" over
        several steps.

    Notes
    -----
    The average of one control per realization, ``fusion="diagonal"``, is inconsistent for
    ``steps >= 2``: the control is not linear in A. In a Gaussian system with n=6, m=2, K=4 the
    mean control from averages of 1, 5, 20 and 100 realizations is off by about 1.5, 0.9, 0.7 and
    0.3 times the exact control, however many of them are averaged.

    The realizations are drawn. For more of them than fit into memory draw counts instead, at a
    cost that does not depend on their number: `control` takes the results of `sample_counts`.

    Examples
    --------
    >>> import stochens_rs as se
    >>> system = se.System([[0.9, 0.2], [-0.1, 0.8]], [[1.0, 0.0], [0.5, 1.0]])
    >>> plan = se.steer(system, [1.0, 2.0], [0.0, 0.0], 10_000, rng=1)
    >>> plan.error(system, [1.0, 2.0], [0.0, 0.0]).control_relative < 0.1
    True
    """
    checked = System.from_any(system)
    gate.choice("method", method, METHODS)
    if gate.choice("fusion", fusion, _FUSIONS) == "diagonal" and method != "uniform":
        raise InputError(
            f"`fusion` must be 'product' for method '{method}', got 'diagonal': paired "
            "realizations share one weight vector, so weights of their own cannot be paired"
        )
    if steps is not None:
        _refuse_diagonal(fusion, gate.size("steps", steps))
    key = as_key(rng)
    targets = {
        "x0": gate.vector("x0", x0, length=checked.n),
        "xf": gate.vector("xf", xf, length=checked.n),
        "A": checked.A,
    }
    fits = {
        name: fuse(sample(target, size, rng=key.child(name)), method, target=target)
        for name, target in targets.items()
    }
    plan: Plan | TrajectoryPlan
    if steps is None:
        plan = control(checked.B, fits["x0"], fits["xf"], fits["A"], fusion=fusion)
    else:
        from .several_steps import control_steps

        plan = control_steps(checked.B, fits["x0"], fits["xf"], fits["A"], steps)
    plan.info["key"] = key
    return plan


@dataclass(frozen=True)
class _Entity:
    """One argument of a control problem: a fit, an ensemble, counts, or exact values."""

    name: str
    value: Fit | Ensemble | Counts | Floats

    def estimate(self) -> Floats:
        """What product fusion uses."""
        if isinstance(self.value, Fit | Counts):
            return self.value.estimate
        return self.value.mean() if isinstance(self.value, Ensemble) else self.value

    def _ensemble(self) -> Ensemble | None:
        if isinstance(self.value, Counts):
            raise InputTypeError(
                f"`{self.name}` must be an Ensemble or an array here: counts have no realizations"
            )
        if isinstance(self.value, Fit):
            if self.value.method != "uniform" or self.value.ensemble is None:
                raise InputError(
                    f"`{self.name}` must be an Ensemble or an array here, got a fit by "
                    f"'{self.value.method}': paired realizations share one weight vector, so "
                    "weights of their own go with fusion='product'"
                )
            return self.value.ensemble
        return self.value if isinstance(self.value, Ensemble) else None

    def realizations(self) -> _core.Draws | Floats:
        """What the core pairs up: draws, rows of dense realizations, or a flat exact value."""
        ensemble = self._ensemble()
        if ensemble is not None:
            return ensemble._core_realizations()
        return self.estimate().ravel()

    @property
    def by_rows(self) -> bool:
        ensemble = self._ensemble()
        return ensemble is not None and ensemble.axis == "rows"

    @property
    def size(self) -> int | None:
        if isinstance(self.value, Fit):
            return len(self.value.weights)
        return self.value.size if isinstance(self.value, Ensemble | Counts) else None

    @property
    def status(self) -> str:
        return self.value.status if isinstance(self.value, Fit) else "completed"

    @property
    def description(self) -> dict[str, Any]:
        if isinstance(self.value, Fit):
            fit = self.value
            return {"method": fit.method, "size": self.size, "status": fit.status, "gap": fit.gap}
        if isinstance(self.value, Ensemble | Counts):
            return {"method": "uniform", "size": self.size}
        return {"method": "exact", "size": None}


def _entities(x0: object, xf: object, A: object, *, n: int) -> tuple[_Entity, _Entity, _Entity]:
    """Check the three arguments against the number of states."""
    checked = []
    for name, value, shape in (("x0", x0, (n,)), ("xf", xf, (n,)), ("A", A, (n, n))):
        if isinstance(value, Fit | Ensemble | Counts):
            if value.shape != shape:
                raise ShapeError(
                    f"`{name}` must have shape {shape} to fit `B` with {n} rows, got {value.shape}"
                )
            checked.append(_Entity(name, value))
        elif len(shape) == 1:
            checked.append(_Entity(name, gate.vector(name, value, length=n)))
        else:
            checked.append(_Entity(name, gate.matrix(name, value, rows=n, cols=n)))
    return checked[0], checked[1], checked[2]


def _refuse_diagonal(fusion: str, steps: int) -> None:
    if fusion == "diagonal":
        reason = (
            "leave out `steps` for one step"
            if steps == 1
            else "the control over K >= 2 steps is not linear in A, so the average of the controls "
            "of the realizations is biased, and more of them do not help"
        )
        raise InputError(f"`fusion` must be 'product' with steps={steps}, got 'diagonal': {reason}")
