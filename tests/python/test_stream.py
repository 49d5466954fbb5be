"""The sequential algorithm: against the reference, exact arithmetic, and its proved bounds."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from stochens_rs.rng import as_key
from stream_problems import OPTIONS, SLOTS, X0, XF, A, B, make
from twin import streaming

V_STAR = np.linalg.pinv(B) @ (XF - A @ X0)


def twin(key, steps, **options):
    keys = [bytes(key.child(name)) for name in SLOTS]
    return streaming.stream(B, X0, XF, A, keys=keys, steps=steps, **options)


# -- the twin ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("safeguard", "slots"), OPTIONS)
def test_equals_the_reference(safeguard, slots):
    options = {"safeguard": safeguard, "slots": slots}
    steps = sets(10_000, 4000) if slots == "random" else 1500
    key = as_key(3)
    theirs, ours = twin(key, steps, **options), make(key, **options)
    ours.step(steps)
    scale = np.linalg.norm(V_STAR)
    np.testing.assert_allclose(ours.u, theirs.controls[-1], rtol=0, atol=1e-9 * scale)
    assert list(ours.counts.values()) == theirs.counts
    for found, expected in zip(ours.estimates.values(), theirs.estimates, strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    trace = ours.trace
    np.testing.assert_allclose(trace.errors, theirs.errors[trace.steps], rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(trace.step_sizes, theirs.sizes[trace.steps], rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(trace.certificates, theirs.certificates[trace.steps], rtol=1e-9)


def test_realizations_are_those_of_a_sample():
    """One slot's estimate is SLSE of `sample(..., rng=key.child(slot))`."""
    key = as_key(8)
    for safeguard, method in ((False, "slse"), (True, "slse-safeguarded")):
        stream = make(key, safeguard=safeguard)
        stream.step(700)
        for name, target in (("x0", X0), ("xf", XF), ("A", A)):
            ensemble = se.sample(target, stream.counts[name], rng=key.child(name))
            fit = se.fuse(ensemble, method, target=target)
            np.testing.assert_allclose(stream.estimates[name], fit.estimate, rtol=0, atol=1e-12)
            assert stream.residuals[name] == pytest.approx(fit.error, rel=1e-9)


# -- convergence ---------------------------------------------------------------------------------


# -- what is proved ------------------------------------------------------------------------------


def test_certificate_bounds_the_error_at_every_step():
    worst = np.inf
    for seed in range(sets(100, 30)):
        stream = make(seed, safeguard=seed % 2 == 1, slots=("random", "round-robin")[seed % 2])
        for _ in range(120):
            true = np.linalg.norm(B @ (stream.u - V_STAR))
            assert stream.error == pytest.approx(true, rel=1e-9, abs=1e-12)
            assert true <= stream.certificate
            worst = min(worst, stream.certificate / true)
            stream.step()
    assert 1.0 < worst < 10.0  # a bound, and not a useless one


def test_runs_stop_by_the_certificate():
    tol = 0.1 * np.linalg.norm(B @ V_STAR)
    steps = []
    for seed in range(40):
        stream = make(seed)
        run = stream.run(tol=tol, max_steps=100_000)
        assert run.status == "converged"
        assert run.rule == "certificate"
        assert run.error <= run.certificate <= tol
        assert run.steps == stream.steps
        assert run.steps % 10 == 0  # looked at every n steps
        earlier = make(seed)
        earlier.step(run.steps - 10)
        assert earlier.certificate > tol
        steps.append(run.steps)
        again = stream.run(tol=tol)
        assert (again.status, again.steps) == ("converged", 0)
    assert 400 < np.median(steps) < 6000  # known for one such system: 1603


def test_printed_rule_compares_successive_controls():
    expected = twin(as_key(5), 60).controls
    changes = np.linalg.norm(np.diff(expected, axis=0), axis=1)
    tol = 0.02
    run = make(5).run(tol=tol, rule="printed")
    assert run.steps == int(np.argmax(changes <= tol)) + 1


def variance(target):
    """E ||E - E*||^2 = sum_j (g_j^2 - ||a_j||^2)."""
    return float(np.sum(np.abs(target).sum(axis=0) ** 2) - np.sum(target**2))


def test_mean_square_errors():
    """E d_1^2 = V, E d_n^2 <= V / n, and the bound for the control, over 400 seeds.

    |z| <= 5 for the equality: a false alarm with probability below 1e-6 were it normal.
    """
    marks = (0, 3, 9, 30, 150)
    squares = np.empty((400, len(marks), 4))
    for seed in range(400):
        stream = make(seed, slots="round-robin")
        for k, mark in enumerate(marks):
            if mark:
                stream.step(mark - stream.steps)
            squares[seed, k] = [*stream.residuals.values(), stream.error]
    squares **= 2
    mean, deviation = squares.mean(axis=0), squares.std(axis=0) / 20.0
    variances = np.array([variance(w) for w in (X0, XF, A)])
    with np.errstate(invalid="ignore", divide="ignore"):
        z = (mean[0, :3] - variances) / deviation[0, :3]
    rounding = 1e-9 * variances
    assert np.all((np.abs(z) < 5.0) | (np.abs(mean[0, :3] - variances) < rounding))
    for k, mark in enumerate(marks):
        n = 1 + mark // 3
        assert np.all(mean[k, :3] <= variances / n + 5.0 * deviation[k, :3])
        V0, Vf, VA = variances / n
        norm_A, norm_0 = np.linalg.norm(A, 2), np.linalg.norm(X0)
        bound = 3.0 * (Vf + norm_A**2 * V0 + VA * (norm_0 + np.sqrt(V0)) ** 2)
        assert mean[k, 3] + 5.0 * deviation[k, 3] <= bound
    assert mean[-1, 3] < 0.05 * mean[0, 3]


def test_slots_are_fair_and_in_turn():
    stream = make(1)
    stream.step(30_000)
    counts = np.array(list(stream.counts.values())) - 1
    assert counts.sum() == 30_000
    assert np.abs(counts - 10_000).max() < 5 * math.sqrt(30_000 * 2 / 9)  # 5 sigma
    turn = make(1, slots="round-robin")
    turn.step(7)
    assert turn.counts == {"x0": 4, "xf": 3, "A": 3}


# -- numbers -------------------------------------------------------------------------------------


@pytest.mark.parametrize("safeguard", [False, True])
def test_a_million_steps_keep_the_invariant_and_the_accuracy(safeguard):
    stream = make(2, safeguard=safeguard)
    stream.step(10**6)
    assert 0.0 < stream.drift < 1e-12
    F = stream.estimates
    v = np.linalg.pinv(B) @ (F["xf"] - F["A"] @ F["x0"])
    assert np.linalg.norm(stream.u - v) < 1e-12 * np.linalg.norm(v)
    # exact rationals of the estimates as they are
    exact = {name: np.vectorize(Fraction, otypes=[object])(value) for name, value in F.items()}
    known = {
        name: np.vectorize(Fraction, otypes=[object])(value)
        for name, value in (("x0", X0), ("xf", XF), ("A", A))
    }
    for name, residual in stream.residuals.items():
        square = np.sum((exact[name] - known[name]) ** 2)
        assert residual == pytest.approx(math.sqrt(square), rel=1e-9)
        assert residual < 1e-3
    off = (exact["xf"] - exact["A"] @ exact["x0"]) - (known["xf"] - known["A"] @ known["x0"])
    true = np.linalg.norm(B @ (np.linalg.pinv(B) @ off.astype(float)))
    assert stream.error == pytest.approx(true, rel=1e-9)
    assert stream.error <= stream.certificate


def test_counters_far_beyond_32_bits():
    """A stream in the state after 3e13 steps continues."""
    stream = make(6)
    stream.step(5000)
    state = stream._to_sections()
    far = 2**43
    state["steps"] = state["steps"] + np.array([3 * far, far, far, far], dtype=np.uint64)
    late = se.Stream._from_sections(state)
    before = late.certificate
    late.step(20_000)
    assert late.steps == 3 * far + 25_000
    assert 0.0 < late.certificate < before
    assert np.isfinite(late.u).all()


@pytest.mark.parametrize(
    ("x0", "xf", "matrix"),
    [
        (X0, np.zeros(10), A),
        (np.zeros(10), XF, A),
        (X0, XF, np.zeros((10, 10))),
        (X0, XF, A * (np.arange(10) != 4)),  # a zero column
        (np.zeros(10), np.zeros(10), np.zeros((10, 10))),
        (np.where(np.arange(10) == 2, -0.0, X0), XF, np.where(A < 0.1, -0.0, A)),
    ],
)
@pytest.mark.parametrize("safeguard", [False, True])
def test_zeros(x0, xf, matrix, safeguard):
    key = as_key(1)
    stream = se.Stream((matrix, B), x0, xf, rng=key, safeguard=safeguard)
    stream.step(500)
    keys = [bytes(key.child(name)) for name in SLOTS]
    expected = streaming.stream(B, x0, xf, matrix, keys=keys, steps=500, safeguard=safeguard)
    np.testing.assert_allclose(stream.u, expected.controls[-1], rtol=0, atol=1e-9)
    for name, target in (("x0", x0), ("xf", xf), ("A", matrix)):
        assert np.all(stream.estimates[name][target == 0.0] == 0.0)
        if not target.any():
            assert stream.residuals[name] == 0.0


@pytest.mark.parametrize("inputs", [np.ones((2, 1)), np.eye(2), np.ones((2, 5)), np.zeros((2, 2))])
def test_every_shape_and_rank_of_B(inputs):
    stream = se.Stream(([[0.9, 0.2], [-0.1, 0.8]], inputs), [1.0, 2.0], [3.0, -1.0], rng=1)
    run = stream.run(tol=1e-6, max_steps=10**6)
    assert run.status == "converged"
    best = np.linalg.pinv(inputs) @ ([3.0, -1.0] - np.array([[0.9, 0.2], [-0.1, 0.8]]) @ [1.0, 2.0])
    assert np.linalg.norm(inputs @ (stream.u - best)) <= 1e-6


@pytest.mark.parametrize("exponent", [-300, -150, 140])
def test_scales(exponent):
    """Powers of two change nothing but the exponents, as long as the product is in range."""
    scale, inverse = 2.0**exponent, 2.0 ** min(-exponent, 1000)
    plain, scaled = make(1), se.Stream((A * scale, B), X0 * inverse, XF, rng=1)
    plain.step(300)
    scaled.step(300)
    np.testing.assert_array_equal(scaled.u, plain.u)
    assert scaled.residuals["A"] == plain.residuals["A"] * scale


def test_columns_of_very_different_size():
    """A column whose square underflows, next to one of order 1: it stays at zero, not nan."""
    matrix = np.array([[1.0, 1e-200], [-0.5, 2e-310]])
    stream = se.Stream((matrix, np.eye(2)), [1.0, 2.0], [0.0, 1.0], rng=1, safeguard=True)
    stream.step(2000)
    assert np.isfinite(stream.u).all()
    assert stream.error < 1e-3
    assert np.all(np.abs(stream.estimates["A"][:, 1]) <= 1e-199)
