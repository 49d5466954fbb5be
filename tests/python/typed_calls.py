"""What a type checker says of results: read by `mypy`, never run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from typing_extensions import assert_type

import stochens_rs as se
from stochens_rs.feedback import Loop, LoopCertificate
from stochens_rs.fleet import FleetPlan
from stochens_rs.fusion.fused_model import FusedModel
from stochens_rs.loops.readings import ReadingLoop
from stochens_rs.theory import drawn_bound

Floats = NDArray[np.float64]


def plans(model: se.Model, ensemble: se.Ensemble, units: se.SystemEnsemble, A: Floats) -> None:
    for plan in (se.control(model, A[0], A[1]), se.control((ensemble, A), A[0], A[1])):
        assert_type(plan, se.Plan)
        assert_type(plan.bound(0.05), se.Certificate)
        assert_type(plan.bound(0.05).state, float)
        assert_type(plan.bound(0.05).excess, float | None)
        assert_type(plan.bound(0.05).tube, Floats)
    assert_type(se.control_fleet(units, A[0], A[1], 3), FleetPlan)
    assert_type(model.region(0.05).bound(A[0], A[1]), float)


def fits(data: se.Trajectories, ensemble: se.Ensemble, units: se.SystemEnsemble, A: Floats) -> None:
    assert_type(se.fuse(ensemble, "alse", target=A), se.Fit)
    assert_type(se.fuse([ensemble, ensemble]), se.Fit)
    assert_type(se.fuse(units), se.Fit)
    assert_type(se.fuse(units, "alse", data=data), FusedModel)


def loops(model: se.Model, A: Floats) -> None:
    assert_type(se.gain(model, 1.0, 1.0), Loop)
    assert_type(se.gain(model, 1.0, 1.0).certificate(0.05), LoopCertificate)
    assert_type(se.regulate((A, A), 10), se.Regulator)
    assert_type(se.regulate(model, 10, offset_free=True), ReadingLoop)


def formulas(w: Floats) -> None:
    assert_type(drawn_bound("vector", w, size=9, delta=0.1), tuple[float, str])
