"""Ensembles of systems, and what their centre means for bounds."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputError

A, B = np.array([[[0.9]], [[0.8]]]), np.array([[[1.0]], [[1.2]]])


def test_systems_in_and_out():
    made = se.SystemEnsemble(A, B, dt=0.1)
    same = se.SystemEnsemble.from_systems(list(made))
    assert same == made
    assert pickle.loads(pickle.dumps(made)) == made
    assert (made.size, len(made), made.n, made.m) == (2, 2, 1, 1)
    assert made[-1] == se.System([[0.8]], [[1.2]], dt=0.1)
    np.testing.assert_allclose(made.mean().B, [[1.1]])
    assert se.SystemEnsemble(A, B, np.ones((2, 1)), dt=0.1) != made


def test_what_an_ensemble_scatters_about_is_kept():
    drawn = se.sample([[1.0]], 3, rng=1)
    assert drawn.centre == "truth"
    models = se.Ensemble.from_samples(A, centre="estimate")
    assert models.centre == models.prefix(1).centre == "estimate"
    assert pickle.loads(pickle.dumps(models)).centre == "estimate"
    assert se.Ensemble.from_samples(A).centre is None


def test_bounds_refuse_realizations_that_scatter_about_an_estimate():
    """Also where their law is declared: the declaration is about the truth."""
    system = se.System([[0.85]], [[1.0]])
    for centre, said in ((None, "pass `system="), ("estimate", "scatter about an estimate")):
        models = se.Ensemble.from_samples(A, centre=centre)
        for one in (models, se.fuse(models)):
            plan = se.control((one, system.B), [1.0], [0.0])
            with pytest.raises(InputError, match=said):
                plan.bound()
            if centre == "estimate":
                with pytest.raises(InputError, match="use the region of the model"):
                    plan.bound(system=system)
                with pytest.raises(InputError, match="no covariance follows"):
                    plan.covariance(system=system)


def test_an_ensemble_from_data_is_not_taken_for_the_system():
    models = se.SystemEnsemble([[[0.9]], [[0.8]]], [[[1.0]], [[1.1]]], centre="estimate")
    with pytest.raises(InputError, match=r"pass its `mean\(\)` to take the estimate as exact"):
        se.control(models, [1.0], [0.0])
    assert se.control(models.mean(), [1.0], [0.0]).u.shape == (1, 1)


def test_names_and_steps_survive_controls_and_fleets():
    named = {"states": ["p", "v"], "inputs": ["f"], "units": {"p": "m"}, "dt": 0.1}
    units = [se.System([[1, 0.1], [0, 0.9 + s]], [[0], [0.1]], **named) for s in (0.0, 0.01, 0.03)]
    models = se.SystemEnsemble.from_systems(units)
    plan = se.control((models, units[0].B), [1.0, 0.0], [0.0, 0.0], steps=3)
    pair = se.Ensemble.from_samples(models.A), units[0].B
    by_hand = se.control(pair, [1.0, 0.0], [0.0, 0.0], steps=3)
    assert np.array_equal(plan.u, by_hand.u)
    assert (plan.labels, plan.dt) == (models.labels, 0.1)
    assert models.mean().labels == models.labels
    fleet = se.control_fleet(models, [1.0, 0.0], [0.0, 0.0], 4)
    assert (fleet.labels, fleet.dt) == (models.labels, 0.1)
    assert "p [m], v" in fleet._repr_html_()
    offset = se.SystemEnsemble(models.A, models.B, np.ones((3, 2)))
    with pytest.raises(InputError, match="without offsets"):
        se.control((offset, units[0].B), [1.0, 0.0], [0.0, 0.0])


def test_a_plan_for_a_mean_says_so_without_being_asked():
    units = se.SystemEnsemble(A, B, labels=se.System([[1.0]], [[1.0]], states=["v"]).labels)
    mean = units.mean()
    for system in (mean, copy.deepcopy(mean), pickle.loads(pickle.dumps(mean))):
        for limits in (None, (-2.0, 2.0)):
            plan = se.control(system, [1.0], [0.0], limits=limits)
            assert "the mean of 2 models" in repr(plan)
            bound = plan.bound(0.05)
            assert "the mean of 2 models" in repr(bound)
            assert "plan.validate(fresh)" in bound.warnings[0]
            assert "certain" not in repr(bound)
    assert "the mean of 2 models" in repr(se.steer(mean, [1.0], [0.0], 100, rng=1).bound())
    alone = units[0], units[:1].mean(), se.System(mean.A, mean.B), (mean.A + 0.0, mean.B)
    for system in alone:
        assert not se.control(system, [1.0], [0.0]).bound().warnings


def test_a_plan_for_a_mean_says_so_after_a_file(tmp_path):
    plan = se.control(se.SystemEnsemble(A, B).mean(), [1.0], [0.0])
    plan.save(tmp_path / "plan")
    assert se.Plan.load(tmp_path / "plan").bound().warnings == plan.warnings != ()
