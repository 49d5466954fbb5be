"""Bounds on the error of a plan whose system is a model from data."""

from __future__ import annotations

import warnings
from math import sqrt
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .. import _core
from .._base import gate, html
from .._base.numbers import norm
from ..exceptions import DataWarning, InputError
from ..identification.identifying import identify
from ..identification.levels import wishart_quantile
from ..identification.model import Model
from .certificate import Certificate
from .region_errors import ToCome, region_errors, root_of, spread

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .._base.types import Floats
    from ..identification.assumptions import Assumptions
    from ..identification.identified import Identified
    from ..identification.region import Region
    from .basis import ModelBasis


class Asked(NamedTuple):
    """The arguments of `Plan.bound` for a model."""

    noise: bool
    open_loop: bool
    x0_fixed: bool


def declared(noise: object, open_loop: object, x0_fixed: object) -> Asked:
    """Check the declarations of `Plan.bound`."""
    names = zip(Asked._fields, (noise, open_loop, x0_fixed), strict=True)
    return Asked(*(gate.flag(name, value) for name, value in names))


@np.errstate(over="ignore")
def certificate(
    basis: ModelBasis,
    u: Floats,
    predicted: Floats,
    delta: float,
    asked: Asked,
    exact: Mapping[str, object],
) -> Certificate:
    """Bound where the true system ends under `u`; `predicted` are the states of the model."""
    model, K = basis.model, len(u)
    for name, value in exact.items():
        if value is not None:
            raise InputError(
                f"`{name}` must be left out for a model from data: its region does not need exact "
                "values; Plan.error compares with them"
            )
    _refuse(basis, K, asked)
    share, single = step_region(basis, delta, K, asked)
    ways = []
    if single is not None:
        region, to_come = single
        steps = model.data.steps if isinstance(model, Model) else 1
        method = "several steps" if K > 1 else "one step" if steps == 1 else _direct_name(steps)
        ways.append(_Way.of(basis, region, u, predicted, method, to_come))
    if asked.open_loop:
        direct = _direct(basis, u, share, asked)
        ways.append(_Way.of(basis, direct, u.reshape(1, -1), predicted, _direct_name(K), None))
    best = min(ways, key=lambda way: way.target)
    tube = np.min([way.tube for way in ways], axis=0)
    components = np.min([way.components for way in ways], axis=0)
    if K == 1 and _sharper_by_rows(basis, ways[0].region, asked):
        rows = model.region(delta, components=True)  # type: ignore[call-arg]
        own = region_errors(rows, basis.x0, u, rho0=basis.x0_error)
        components = np.abs(own.states[-1] - basis.xf) + own.components
    reason, control = "over several steps no bound of the control is known", np.inf
    if K == 1 or asked.open_loop:
        reason, control = _control_error(basis, ways[-1])
    return Certificate(
        target=best.target,
        state=float(tube[-1]),
        reach=best.reach,
        model_error=best.model_error,
        start=best.start,
        components=components,
        tube=tube,
        control=control,
        control_reason=f"only the state is certified: {reason}" if np.isinf(control) else None,
        delta=delta,
        assumption=_said(basis, ways, asked),
        method=best.method,
        noise=asked.noise,
        missing=best.region.missing if np.isinf(best.target) else (),
    )


def step_region(
    basis: ModelBasis, delta: float, K: int, asked: Asked
) -> tuple[float, tuple[Region, ToCome | None] | None]:
    """The level of each region, and the one for single steps with its noise to come, if any."""
    able = not asked.noise or _noise_to_come(basis.model) != "unknown"
    share = delta / 2.0 if asked.open_loop and able else delta
    return share, _region(basis, share, K, asked) if able or not asked.open_loop else None


class _Way(NamedTuple):
    """What one region says: the parts of the distance from xf, and radii around the prediction."""

    region: Region
    u: Floats
    end: Floats
    target: float
    reach: float
    model_error: float
    start: float
    components: Floats
    tube: Floats
    method: str
    to_come: ToCome | None

    @classmethod
    def of(
        cls,
        basis: ModelBasis,
        region: Region,
        u: Floats,
        predicted: Floats,
        method: str,
        to_come: ToCome | None,
    ) -> _Way:
        errors = region_errors(region, basis.x0, u, rho0=basis.x0_error, to_come=to_come)
        end, whole = errors.states[-1], float(errors.radii[-1])
        apart, alone = end - basis.xf, whole
        if basis.x0_error and np.isfinite(whole):
            exact = region_errors(region, basis.x0, u, rho0=0.0, to_come=to_come)
            alone = float(exact.radii[-1])
        tube = np.full(len(predicted), np.inf)  # a region over all steps says nothing between
        at = np.linspace(0, len(predicted) - 1, len(errors.radii)).astype(int)
        tube[at] = errors.radii + np.linalg.norm(errors.states - predicted[at], axis=1)
        return cls(
            region=region,
            u=u,
            end=end,
            target=norm(apart) + whole,
            reach=norm(apart),
            model_error=alone,
            start=whole - alone if np.isfinite(whole) else 0.0,
            components=np.abs(apart) + errors.components,
            tube=tube,
            method=method,
            to_come=to_come,
        )


def _said(basis: ModelBasis, ways: list[_Way], asked: Asked) -> str:
    """The assumptions in words."""
    text = ways[0].region.assumption
    if asked.open_loop:
        text += (
            "; runs independent of each other, of lengths fixed beforehand, with Gaussian noise "
            "and inputs independent of all noise"
        )
    if basis.x0_error:
        text += f"; x0 within {basis.x0_error:.4g}"
    if ways[0].to_come is not None:
        text += "; noise to come of the same size, at half of the probability of failure"
    return text


def _direct_name(steps: int) -> str:
    return f"direct regression over {steps} steps"


def _refuse(basis: ModelBasis, K: int, asked: Asked) -> None:
    """Refuse declarations that do not go with the plan."""
    if asked.open_loop and K == 1:
        raise InputError("`open_loop` must be False for one step, which asks nothing of the runs")
    if asked.x0_fixed:
        if basis.x0_error:
            raise InputError("`x0_fixed` must be False with `x0_error`: x0 must be known exactly")
        if K > 1 and not asked.open_loop:
            raise InputError(
                f"`x0_fixed` must be False over {K} steps, whose later states depend on the data; "
                "it is for one step, or together with open_loop=True"
            )
    for name, value in (("open_loop", asked.open_loop), ("x0_fixed", asked.x0_fixed)):
        if value and not isinstance(basis.model, Model):
            raise InputError(
                f"`{name}` must be False for a plan from a {type(basis.model).__name__}: it needs "
                "the runs, which a Model by `identify` keeps"
            )


def _noise_to_come(model: Identified) -> str:
    """What bounds the noise of a run to come: the "region", its "known" size, or "unknown"."""
    assumed: Assumptions | None = getattr(model, "assumptions", None)
    if not isinstance(model, Model):
        return "region" if assumed is None or assumed.known is None else "known"
    exact = model.design == "independent" and model.noise == "gaussian"
    if exact and model.instruments is None and len(model._blocks) == 1:
        return "region"
    known = model.assumptions.known is not None and model.instruments is None
    return "known" if known else "unknown"


def _region(basis: ModelBasis, delta: float, K: int, asked: Asked) -> tuple[Region, ToCome | None]:
    """The region for K steps, and the noise to come where that is not in it."""
    model, kind = basis.model, _noise_to_come(basis.model)
    options: dict[str, Any] = {}
    named: list[str] = []
    if asked.x0_fixed and K == 1:
        options["x0"] = basis.x0
        named.append("`x0_fixed`")
    if K > 1 and not (
        isinstance(model, Model)
        and (model.instruments is not None or model.noise == "symmetric" or len(model._blocks) > 1)
    ):
        options["frobenius"] = True
    if asked.noise and kind == "region":
        options["future"] = K
        named.append("`noise`")
    elif asked.noise:
        if kind == "unknown":
            raise InputError(
                "`noise` must be False: noise to come is bounded for noise of known covariance or "
                "size (`sigma` of identify), for Gaussian noise with design='independent' and no "
                "single known entries, and over several steps with open_loop=True; this model has "
                "none of these"
            )
        delta /= 2.0
    try:
        region = model.region(delta, **options)
    except InputError as error:
        if not named:
            raise
        raise InputError(f"{' and '.join(named)} must be False: {error}") from None
    if not asked.noise or kind == "region":
        return region, None
    assumed: Assumptions = model.assumptions  # type: ignore[attr-defined]
    assert assumed.known is not None
    n, law = region.n, assumed.noise
    if law == "gaussian":
        radius = sqrt(wishart_quantile(n, K, delta))
    elif law == "bounded":
        radius = sqrt(K)
    else:
        radius = sqrt(K) * _core.one_noise(n, delta / K)
    return region, ToCome(radius, root_of(assumed.known))


def _sharper_by_rows(basis: ModelBasis, region: Region, asked: Asked) -> bool:
    """Whether regions by rows are smaller for components, decided without the data."""
    model = basis.model
    return (
        isinstance(model, Model)
        and not asked.noise
        and not asked.x0_fixed
        and len(region.parts) == 1
        and model.n > 1
        and model.instruments is None
        and model.noise != "symmetric"
        and model.assumptions.covariance != "scalar"
    )


def _direct(basis: ModelBasis, u: Floats, delta: float, asked: Asked) -> Region:
    """The region of ``(x(0), u(0), .., u(K-1)) -> x(K)``, from one row of each run.

    The noise of a row is ``sum A^(K-1-k) w(k)``: Gaussian of one covariance, independent of x(0)
    and of inputs in open loop, so that the exact region of one step applies.
    """
    model, K = basis.model, len(u)
    assert isinstance(model, Model)
    if model.instruments is not None or model.noise != "gaussian":
        raise InputError(
            "`open_loop` must be False: regression over several steps needs Gaussian noise and "
            f"states without error, this model has noise='{model.noise}'"
            + (" and instruments" if model.instruments is not None else "")
        )
    data = model.data.k_step(K, open_loop=True)
    needed = K * model.m + model.intercept + 2 * model.n
    if data.size < needed:
        raise InputError(
            f"`open_loop` must be False: regression over {K} steps needs {needed} runs of so many "
            f"steps, the data have {html.number_of(data.size, 'run')}"
        )
    with warnings.catch_warnings():  # the region names what the data do not determine
        warnings.simplefilter("ignore", DataWarning)
        direct = identify(data, design="independent", intercept=model.intercept, checks=False)
    x0 = basis.x0 if asked.x0_fixed else None
    return direct.region(delta, x0=x0, future=int(asked.noise))


def _control_error(basis: ModelBasis, way: _Way) -> tuple[str, float]:
    """``||u - v||`` for ``v = B^+ (xf - A x0 - c)``, or why there is no bound.

    ``v - u = B^+ (r + D z)``, ``r = xf - C z`` and ``B^+ r = (B'B)^-1 (B_C' r + (B - B_C)' r)``.
    With ``s = sigma_min(B_C)`` and ``||B - B_C|| <= eB < s``:
    ``(||D z|| + (||B_C' r|| + eB ||r||) / (s - eB)) / (s - eB)``.
    """
    region = way.region
    n, m = region.n, region.m
    B = region.centre[:, n : n + m]
    if m > n:
        return f"{m} inputs act on {n} states, so that many controls are as good", np.inf
    s, eB = float(np.linalg.svd(B, compute_uv=False)[-1]), spread(region, slice(n, n + m))
    if not eB < s:
        return "within the error of the data some inputs may have no effect", np.inf
    r = basis.xf - way.end
    rho0 = basis.x0_error
    wrong = region.bound(basis.x0, way.u[0])
    if rho0:  # D (e, 0) + A_C e
        A = region.centre[:, :n]
        wrong += (float(np.linalg.norm(A, 2)) + spread(region, slice(n))) * rho0
    across = norm(B.T @ r) + eB * norm(r)
    limit = float((wrong + across / (s - eB)) / (s - eB))
    return "the data do not determine where the control leads", limit
