"""Bounds on the error of a plan whose system is a model from data."""

from __future__ import annotations

import warnings
from math import sqrt
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from .. import _core
from .._base import html, validation
from .._base.numbers import norm
from .._base.records import trusted
from ..exceptions import DataWarning, InputError
from ..identification.identifying import identify
from ..identification.model import Model
from .certificate import Certificate
from .region_errors import GaussianNoise, SizedNoise, ToCome, root_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .._base.types import Floats
    from ..identification.assumptions import Assumptions
    from ..identification.identified import Identified
    from ..identification.region import Region
    from .provenance import ModelBasis

    _Way: TypeAlias = tuple[Region, Floats, ToCome | None, bool]

# Of the probability of failure with Gaussian noise to come: the region, the noise of the last
# state, and that of earlier states with what the error of the model makes of it. For one step the
# last share goes to the noise, too. Fixed before the data.
REGION, END, BEFORE = 0.5, 0.4, 0.1


class Asked(NamedTuple):
    """The arguments of `Plan.bound` for a model."""

    noise: bool
    open_loop: bool
    x0_fixed: bool


def declared(noise: object, open_loop: object, x0_fixed: object) -> Asked:
    """Check the declarations of `Plan.bound`."""
    names = zip(Asked._fields, (noise, open_loop, x0_fixed), strict=True)
    return Asked(*(validation.flag(name, value) for name, value in names))


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
    if model.doubts:
        return _nothing(basis, u, predicted, delta, asked)
    share, regions, to_come = step_regions(basis, delta, K, asked)
    steps = model.data.steps if isinstance(model, Model) else 1
    name = "several steps" if K > 1 else "one step" if steps == 1 else _direct_name(steps)
    methods = [name] * len(regions)
    # a region, the inputs in its form, and whether it says how far the control is from the best
    ways: list[_Way] = [(region, u, to_come, K == 1) for region in regions]
    if asked.open_loop:
        ways.append((_direct(basis, u, share, asked), u.reshape(1, -1), None, True))
        methods.append(_direct_name(K))
    apart: Region | None = None
    if K == 1 and _sharper_by_rows(basis, ways[0][0], asked):
        apart = model.region(delta, components=True)  # type: ignore[call-arg]
    best, target, reach, model_error, start, components, tube, control, why = _core.certify(
        basis.x0,
        basis.x0_error,
        basis.xf,
        predicted,
        [(region._core, inputs, noise, asks) for region, inputs, noise, asks in ways],
        None if apart is None else (apart._core, u, None, False),
    )
    region = ways[best][0]
    return trusted(
        Certificate,
        target=target,
        state=float(tube[-1]),
        reach=reach,
        model_error=model_error,
        start=start,
        components=components,
        tube=tube,
        control=np.inf if control is None else control,
        control_reason=_why(ways[-1][0], control, why),
        control_method=None if control is None or np.isinf(control) else "the region",
        delta=delta,
        assumption=_said(basis, ways[0], asked),
        method=methods[best],
        noise=asked.noise,
        missing=region.missing if np.isinf(target) else (),
        warnings=model.warnings,
    )


def _why(region: Region, control: float | None, why: str | None) -> str | None:
    """Why the control is not bounded, if it is not."""
    if control is not None and np.isfinite(control):
        return None
    if control is not None:
        text = "the data do not determine where the control leads"
    elif why == "many":
        text = f"{region.m} inputs act on {region.n} states, so that many controls are as good"
    elif why == "no effect":
        text = "within the error of the data some inputs may have no effect"
    else:
        text = "over several steps no bound of the control is known"
    return f"only the state is certified: {text}"


def _nothing(
    basis: ModelBasis, u: Floats, predicted: Floats, delta: float, asked: Asked
) -> Certificate:
    """A certificate of nothing: the columns of the data are no states of a plant."""
    everywhere = np.full(len(predicted), np.inf)
    everywhere[0] = basis.x0_error
    reason = "the columns of the data are no states of a plant, see `doubts`"
    return Certificate(
        target=np.inf,
        state=np.inf,
        reach=norm(predicted[-1] - basis.xf),
        model_error=np.inf,
        start=basis.x0_error,
        components=np.full(len(basis.xf), np.inf),
        tube=everywhere,
        control=np.inf,
        control_reason=f"nothing is certified: {reason}",
        delta=delta,
        assumption="none that would do: see `doubts`",
        method="several steps" if len(u) > 1 else "one step",
        noise=asked.noise,
        doubts=basis.model.doubts,
        warnings=basis.model.warnings,
    )


def step_regions(
    basis: ModelBasis, delta: float, K: int, asked: Asked
) -> tuple[float, tuple[Region, ...], ToCome | None]:
    """The level of each event, the regions for single steps that hold in it, and noise to come."""
    kind = _noise_to_come(basis.model)
    # with a covariance from the data the direct regression is sharper: it has the whole level
    estimated = (
        kind == "Gaussian"
        and isinstance(basis.model, Model)
        and basis.model.assumptions.known is None
    )
    able = not asked.noise or (kind != "unknown" and not estimated)
    share = delta / 2.0 if asked.open_loop and able else delta
    if asked.open_loop and not able:
        return share, (), None
    return share, *_regions(basis, share, K, asked)


def _said(basis: ModelBasis, way: _Way, asked: Asked) -> str:
    """The assumptions in words."""
    region, _, to_come, _ = way
    text = region.assumption
    if asked.open_loop:
        text += (
            "; runs independent of each other, of lengths fixed beforehand, with Gaussian noise "
            "and inputs independent of all noise"
        )
    if basis.x0_error:
        text += f"; x0 within {basis.x0_error:.4g}"
    if isinstance(to_come, SizedNoise):
        text += "; noise to come of the same size, at half of the probability of failure"
    if isinstance(to_come, GaussianNoise):
        text += "; noise to come independent of the data, at half of the probability of failure"
    return text


def _direct_name(steps: int) -> str:
    return f"direct regression over {steps} steps"


def _refuse(basis: ModelBasis, K: int, asked: Asked) -> None:
    """Refuse declarations that do not go with the plan."""
    if asked.open_loop and K == 1:
        raise InputError("`open_loop` must be False for one step, which asks nothing of the runs")
    if asked.x0_fixed:
        if basis.x0_error:
            raise InputError("`x0_fixed` must be False with an Uncertain x0")
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


def _noise_to_come(model: Identified) -> Literal["Gaussian", "sized", "region", "unknown"]:
    """What bounds the noise of a run to come: its law and covariance, its size, or the region."""
    source = getattr(model, "least_squares", model)  # of a fused model
    assumed: Assumptions | None = getattr(source, "assumptions", None)
    if assumed is None:
        return "region"
    if getattr(source, "instruments", None) is not None:
        return "unknown"
    if assumed.known is not None:
        return "Gaussian" if assumed.noise == "gaussian" else "sized"
    if not isinstance(model, Model):
        return "region"
    if assumed.noise != "gaussian" or len(model._blocks) > 1:
        return "unknown"
    return "region" if assumed.design == "independent" else "Gaussian"


def _regions(
    basis: ModelBasis, delta: float, K: int, asked: Asked
) -> tuple[tuple[Region, ...], ToCome | None]:
    """The regions for K steps, in one event, and the noise to come where that is not in them."""
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
    whole = delta
    if asked.noise and kind == "region":
        options["future"] = K
        named.append("`noise`")
    elif asked.noise and kind == "Gaussian":
        delta *= REGION
        if isinstance(model, Model) and model.assumptions.known is None:
            options["method"] = "mixture"  # which bounds the covariance as well
    elif asked.noise and kind == "sized":
        delta /= 2.0
    elif asked.noise:
        raise InputError(
            "`noise` must be False: noise to come is bounded for noise of known covariance or "
            "size (`sigma` of identify), for Gaussian noise without single known entries, and over "
            "several steps with open_loop=True; this model has none of these"
        )
    try:
        regions = model._regions(delta, **options)
    except InputError as error:
        if not named:
            raise
        raise InputError(f"{' and '.join(named)} must be False: {error}") from None
    if not asked.noise or kind == "region":
        return regions, None
    n, bound = regions[0].n, regions[0].noise
    if kind == "Gaussian":
        # too few pairs for a bound of the covariance: infinite
        root = np.diag(np.full(n, np.inf)) if bound is None else root_of(bound)
        end = END if K > 1 else END + BEFORE
        return regions, GaussianNoise(root, end * whole, BEFORE * whole / (2 * max(K - 1, 1)))
    assumed: Assumptions = model.assumptions  # type: ignore[attr-defined]
    assert assumed.known is not None
    radius = sqrt(K) if assumed.noise == "bounded" else sqrt(K) * _core.one_noise(n, delta / K)
    return regions, SizedNoise(radius, root_of(assumed.known))


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
