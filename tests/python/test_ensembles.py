"""Ensembles as objects: views, prefixes, equality, pickles, refusals, nothing modified."""

from __future__ import annotations

import multiprocessing
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import exceptions as ex

W = np.array([3.0, -1.0, 0.0, 2.0])
A = np.array([[0.9, 0.0, 0.2], [-0.1, 0.0, 0.8]])
SQUARE = np.outer(W, W + 1.0)


def _mean(ensemble: se.Ensemble) -> np.ndarray:
    return ensemble.mean()


@pytest.mark.parametrize("method", ["spawn", "fork"] if sys.platform == "linux" else ["spawn"])
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_ensembles_travel_to_processes(method: str) -> None:
    # the parent has used threads before: a forked child must not wait for them
    se.set_num_threads(2)
    ensemble = se.sample(W, 100_000, rng=1)
    se.set_num_threads(None)
    with multiprocessing.get_context(method).Pool(1) as pool:
        there = pool.apply_async(_mean, (ensemble,)).get(timeout=60)
    assert np.array_equal(there, ensemble.mean())


def test_indices_are_a_read_only_view_that_outlives_its_ensemble() -> None:
    ensemble = se.sample(W, 1000, rng=1)
    view = ensemble.indices
    assert view is not None
    assert view.dtype == np.uint8
    assert view.shape == (1000, 1)
    assert not view.flags.writeable
    with pytest.raises(ValueError, match="WRITEABLE"):
        view.flags.writeable = True
    expected = view.copy()
    del ensemble
    se.sample(W, 100_000, rng=2)  # may reuse freed memory
    assert np.array_equal(view, expected)


def test_ensembles_are_immutable_and_made_by_functions() -> None:
    ensemble = se.sample(W, 10, rng=1)
    with pytest.raises(AttributeError, match="cannot"):
        ensemble.size = 3  # type: ignore[misc]
    with pytest.raises(ex.InputTypeError, match="from_samples"):
        se.Ensemble()
    with pytest.raises(TypeError):
        hash(ensemble)


def test_inputs_are_neither_modified_nor_shared() -> None:
    samples = np.arange(6.0).reshape(3, 2)
    ensemble = se.Ensemble.from_samples(samples)
    samples[:] = 0.0
    assert ensemble.combine([1.0, 0.0, 0.0]).tolist() == [0.0, 1.0]
    target = A.copy()
    target.flags.writeable = False
    se.fuse(se.sample(target, 10, rng=1), "alse", target=target)
    assert np.array_equal(target, A)


def test_memory_that_was_used_before_shows_nowhere() -> None:
    size = 1 << 20  # memory of this size is kept for the next ensemble
    for scheme in ("iid", "systematic"):
        assert se.sample([1.0, 2.0, 3.0], size, rng=1).indices.any()
        zeros = se.Ensemble.from_indices(np.zeros(size, dtype=np.uint8), [1.0, 2.0, 3.0])
        assert not zeros.indices.any()
        del zeros
        assert se.sample([1.0, 2.0, 3.0], size, rng=1).indices.any()
        matrix = np.array([[1.0, 0.0], [2.0, 0.0]])  # a column of zeros is at index 0
        lines = se.sample(matrix, size // 2, rng=1, scheme=scheme).indices
        assert lines[:, 0].any()
        assert not lines[:, 1].any()


def test_a_system_goes_in_in_any_form() -> None:
    B = np.eye(4)[:, :2]
    forms = (
        se.System(SQUARE, B),
        (SQUARE, B),
        (SQUARE.tolist(), B.tolist(), 0.1),
        SimpleNamespace(A=SQUARE, B=B, dt=1.0),
        (se.Ensemble.from_samples([SQUARE]), B),
        (se.fuse(se.Ensemble.from_samples([SQUARE])), B),
    )
    plans = [se.control(form, W, -W, steps=2) for form in forms]
    assert all(np.array_equal(plan.u, plans[0].u) for plan in plans)
    assert [plan.info["A"]["method"] for plan in plans] == ["exact"] * 4 + ["uniform"] * 2
    controls = [se.realization_controls(form, W, -W) for form in forms[:5]]
    assert all(np.array_equal(one, controls[0]) for one in controls)


def test_a_part_of_a_systematic_sample_is_not_one() -> None:
    whole = se.sample(A, 50, rng=4, scheme="systematic")
    assert whole.prefix(50).key == whole.key
    assert (whole.prefix(49).key, whole.prefix(49).scheme) == (None, None)


@pytest.mark.parametrize("method", ["slse", "slse-safeguarded"])
def test_what_cannot_be_reached_does_not_disturb_what_can(method: str) -> None:
    ensemble = se.sample([3.0, 1.0, 0.0], 500, rng=1)
    plain = se.fuse(ensemble, method, target=[3.0, 1.0, 0.0])
    far = se.fuse(ensemble, method, target=[3.0, 1.0, 1e9])
    assert np.array_equal(plain.estimate, far.estimate)
    assert far.error == pytest.approx(1e9, rel=1e-15)


def test_senders_with_vectors_of_their_own_are_averaged() -> None:
    """Each of 3000 nodes sends one index of its own sparse histogram."""
    rng, n = np.random.default_rng(5), 200
    own = rng.dirichlet(np.full(n, 0.02), 3000)
    nodes = [se.sample(p, 1, rng=rng) for p in own]
    fused = se.fuse(nodes)
    assert fused.estimate == pytest.approx(np.mean([one.mean() for one in nodes], axis=0))
    error = np.sum((fused.estimate - own.mean(axis=0)) ** 2)
    # sum_k (||p_k||_1^2 - ||p_k||^2) / N^2, four deviations above
    assert error < 2.0 * np.sum(1.0 - np.sum(own**2, axis=1)) / 3000**2
    assert se.fuse([nodes[0], se.sample(own[1], 3, rng=1)]).weights.shape == (4,)
    with pytest.raises(ex.ShapeError, match=r"`ensemble\[1\]` must have shape \(200,\)"):
        se.fuse([nodes[0], se.sample([1.0], 1, rng=1)])
    with pytest.raises(ex.InputError, match="at least one Ensemble"):
        se.fuse([])
