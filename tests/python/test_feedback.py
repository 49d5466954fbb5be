"""`gain` and the certificates of loops: known values, proofs, verdicts and what is refused."""

from __future__ import annotations

import re

import numpy as np
import pytest

import stochens_rs as se
from core_regions import ball, white
from coverage_study import sets
from declarations import opts
from hidden_systems import RIG
from stochens_rs import _core
from stochens_rs.exceptions import InputError, InputTypeError, NonFiniteError, SolverError
from stochens_rs.feedback import LoopCertificate, Tube
from twin import feedback as twin

CENTRE = np.array([[0.9, 0.2, 0.0], [-0.1, 0.8, 1.0]])
V = np.array([[115.0, 41, -11], [41, 103, -11], [-11, -11, 99]])
S = np.array([[0.45, 0.04], [0.04, 0.06]])
K = np.array([[0.1, -0.5]])
RIG_V, RIG_S = 300 * np.diag([0.04, 0.0025, 0.04, 0.01, 1]), 2.5e-7 * np.eye(4)
WEIGHTS = np.diag([1, 10, 0.1, 1.0]), np.array([[0.01]])
NONE = np.zeros((0, 1))


def judged(centre, V, S, rho, K, **options):
    return _core.Feedback(ball(centre, V, S, rho, **options), K)


def rig_gain():
    A, B = (np.ascontiguousarray(part) for part in (RIG[:, :4], RIG[:, 4:]))
    return _core.feedback_gain(A, B, *WEIGHTS)[0]


# -- known values ------------------------------------------------------------------------------


def test_two_states_and_one_input():
    loop = judged(CENTRE, V, S, 1.0, K)
    norm, least, radius = loop.sizes
    assert loop.status == "certified"
    assert least == pytest.approx(0.700346226733, rel=2e-8)
    assert least <= norm <= 1.0011 * least
    assert radius == pytest.approx(0.9)
    zero, own = np.zeros((2, 2)), 0.01 * np.eye(2)
    Q = [[2.868540217131, 0.060579443841], [0.060579443841, 0.065939769570]]
    np.testing.assert_allclose(squared(loop.invariant(zero, 1.0, 1.0, 0.0)), Q, rtol=2e-7)
    Y = [[2.945453936338, 0.061448455978], [0.061448455978, 0.076930234186]]
    np.testing.assert_allclose(squared(loop.invariant(own, 1.0, 1.0, 0.0)), Y, rtol=2e-7)
    Y = [[0.229647702647, 0.003873619202], [0.003873619202, 0.014290306244]]
    np.testing.assert_allclose(squared(loop.invariant(own, 0.05, 1.0, 0.0)), Y, rtol=2e-7)
    best = loop.invariant(own, 0.0255323, 1.0, 0.0)
    assert np.sum(best**2) == pytest.approx(0.192331880141, rel=1e-6)
    # invariant ellipsoid for w w' <= .01 I
    within = loop_at(0.5).invariant(own / (1 - 0.935533), 0.0255323, 0.935533, 0.0)
    assert within is None or np.linalg.norm(within[0]) >= 1.5998309671 * (1 - 1e-6)


def squared(root):
    """Y from its root."""
    return root @ root.T


def loop_at(rho):
    return judged(CENTRE, V, S, rho, K)


def test_gains_of_two_states():
    A, B = np.ascontiguousarray(CENTRE[:, :2]), np.ascontiguousarray(CENTRE[:, 2:])
    found, cost, _ = _core.feedback_gain(A, B, np.eye(2), np.eye(1))
    np.testing.assert_allclose(found, [[-0.218658778016, -0.559786729868]], rtol=1e-10)
    assert np.trace(cost) == pytest.approx(5.546535977331, rel=1e-11)
    found, cost, _ = _core.guaranteed_gain(ball(CENTRE, V, S, 1.0), np.eye(2), np.eye(1), 50.0)
    expected = [[7.308176289798, 1.391682656441], [1.391682656441, 2.604479165529]]
    np.testing.assert_allclose(cost, expected, rtol=1e-7)
    np.testing.assert_allclose(found, [[-0.272714987607, -0.591120937289]], rtol=1e-7)
    _, cost, tau = _core.guaranteed_gain(ball(CENTRE, V, S, 1.0), np.eye(2), np.eye(1))
    assert tau == pytest.approx(24.7044, rel=1e-3)
    assert np.trace(cost) == pytest.approx(8.863714873575, rel=1e-7)
    assert _core.widest_gain(ball(CENTRE, V, S, 1.0))[2] == pytest.approx(2.737593518716, rel=1e-3)


def test_rows_of_a_region_have_multipliers_of_their_own():
    loop = judged(CENTRE, V, S, 1.0, K, by_rows=True)
    norm, least, _ = loop.sizes
    assert loop.status == "certified"
    assert least == pytest.approx(0.740830498789, rel=1e-4)
    assert norm <= 1.0011 * least
    first, second = loop.multipliers
    assert np.sqrt(second / first) == pytest.approx(3.467380, rel=0.05)
    given = loop.proof, np.zeros((2, 2)), 1.0, 1.0
    assert loop.verified(*given, loop.multipliers)
    assert not loop.verified(*given, loop.multipliers[::-1].copy())


def test_the_rig():
    gain = rig_gain()
    expected = [[4.394760789886, 53.526340151437, 6.269479787414, 16.529412995859]]
    np.testing.assert_allclose(gain, expected, rtol=1e-9)
    loop = judged(RIG, RIG_V, RIG_S, 6.8, gain)
    assert loop.sizes[1] == pytest.approx(0.055922015445, rel=2e-8)
    Q = loop.invariant(np.zeros((4, 4)), 1.0, 1.0, 0.0)
    assert np.sum(Q**2) == pytest.approx(0.003294995285639, rel=1e-7)
    assert 6.8 * _core.widest_gain(ball(RIG, RIG_V, RIG_S, 6.8))[2] == pytest.approx(
        180.704337332, rel=1e-3
    )
    x0 = np.array([0.1, 0.05, 0, 0])
    for alpha, size in ((1e-4, 9.572885476451e-5), (1e-3, 7.614974658646e-5)):
        root = loop.invariant(RIG_S, alpha, 1.0, 0.0)
        assert np.sum(root**2) == pytest.approx(size, rel=1e-7)
    assert loop.invariant(RIG_S, 1e-5, 1.0, 0.0) is None
    _, cost, _ = _core.guaranteed_gain(ball(RIG, RIG_V, RIG_S, 6.8), *WEIGHTS, 1.0)
    assert x0 @ cost @ x0 == pytest.approx(8.945155560734, rel=1e-7)
    _, model, _, radii, noise, size, later, reach = loop.tube(x0, 60, NONE, 0.0, (RIG_S, 0.05))
    # .0139810 with rho g in place of its proved bound, which is .1 % larger
    assert radii.max() == pytest.approx(0.013981020, rel=2e-4)
    assert (noise[:4] > 3.0 * 5e-4).all()
    assert size < np.linalg.norm(noise[:4]) * 1.001
    assert later[26] <= 0.05
    assert np.isfinite(reach).all()
    assert model.shape == (61, 5)
    assert judged(RIG, RIG_V, RIG_S, 6.8, np.zeros((1, 4))).status == "refuted"


@pytest.mark.parametrize(
    ("centre", "rho", "widest"),
    [
        ([1.5, 0.3], 0.45, 26**-0.5),
        ([1.2, 1.0], 0.3, 2.44**-0.5),
        ([0.5, 1.0], 0.3, 0.894427190999916),
        ([0.9, 0.1], 0.3, 0.2 / np.sqrt(2)),
    ],
)
def test_the_widest_margin_of_one_state(centre, rho, widest):
    """Beyond it the recursion of the first one converges, to an indefinite matrix."""
    one = ball(np.array([centre]), np.eye(2), np.eye(1), rho)
    assert rho * _core.widest_gain(one)[2] == pytest.approx(widest, rel=1e-3)
    weights = np.eye(1), np.eye(1)
    if rho > widest:
        with pytest.raises(SolverError, match="guaranteed"):
            _core.guaranteed_gain(one, *weights)


def test_the_widest_margin_where_nothing_is_proved_and_where_nothing_stabilises():
    """A mode that no input moves, next to the unit circle and beyond it."""
    near, beyond = (
        ball(np.array([[size, 0.0]]), np.eye(2), np.eye(1), 0.1) for size in (1.0 - 1e-14, 1.1)
    )
    assert _core.widest_gain(near)[2] == 0.0
    with pytest.raises(SolverError, match="the iteration found no stabilising gain"):
        _core.widest_gain(beyond)


def test_a_recursion_that_ends_at_an_indefinite_matrix_is_refused():
    centre = np.array([[1.5, 0.6, -0.4], [0.9, -1.5, 1.0]])
    one = ball(centre, np.eye(3), np.eye(2), 0.4)
    assert _core.widest_gain(one)[2] < 1.0
    with pytest.raises(SolverError, match="guaranteed"):
        _core.guaranteed_gain(one, np.eye(2), np.eye(1))


# -- the proof ---------------------------------------------------------------------------------


def random_loop(gen, n):
    """A centre, V and S, and a gain that makes the centre stable."""
    A, B = gen.standard_normal((n, n)), gen.standard_normal((n, 1))
    centre = np.hstack([A * (1.05 / np.abs(np.linalg.eigvals(A)).max()), B])
    Z, R = gen.standard_normal((n + 6, n + 1)), gen.standard_normal((n + 2, n))
    found, _, _ = _core.feedback_gain(
        np.ascontiguousarray(centre[:, :n]), centre[:, n:].copy(), np.eye(n), np.eye(1)
    )
    return centre, Z.T @ Z, R.T @ R, found


def used_radius(rho, d):
    """The radius with the allowance for the rounding of the fit, as the core has it."""
    return rho * (1.0 + 1e-8 + 100.0 * d * 2.0**-52)


def skewed(loop, by):
    """The same loop for states ``T x`` that nearly depend on each other."""
    centre, V, S, K = loop
    n = len(S)
    T = np.eye(n) + by * np.tril(np.ones((n, n)), -1)
    back, wide = np.linalg.inv(T), np.eye(n + 1)
    wide[:n, :n] = np.linalg.inv(T)
    S = T @ S @ T.T
    return T @ centre @ wide, wide.T @ V @ wide, (S + S.T) / 2, K @ back


@pytest.mark.parametrize("by", [0.0, 30.0])
def test_no_proof_is_accepted_that_is_false(by):
    """60 loops, in `make test` 8, 9 gaps about the limit: what is accepted is true exactly."""
    gen = np.random.default_rng(1)
    accepted, decided, near, trials = 0, 0, 0, sets(60, 8)
    for trial in range(trials):
        centre, V, S, K = skewed(random_loop(gen, 1 + trial % 3), by)
        n, d = centre.shape
        limit = 1.0 / judged(centre, V, S, 1e-3, K).sizes[1] * 1e-3
        for gap in (1e-2, 1e-3, 1e-5, 1e-7, 1e-9, 1e-11, -1e-11, -1e-9, -1e-7):
            rho = limit * (1.0 - gap)
            loop = judged(centre, V, S, rho, K)
            R = loop.invariant(np.zeros((n, n)), 1.0, 1.0, min(1e-3, 0.1 * abs(gap)))
            if R is None:
                continue
            exact = twin.true(centre, white(V), S, K, used_radius(np.sqrt(rho**2), d), R)
            for one in (R, R * (1.0 + 1e-14), R + 1e-13 * np.linalg.norm(R) * np.eye(n)):
                decided += 1
                if loop.verified(one, np.zeros((n, n)), 1.0, 1.0, np.ones(1)):
                    accepted += 1
                    near += abs(gap) <= 1e-5
                    assert (one is R and exact) or twin.true(
                        centre, white(V), S, K, used_radius(np.sqrt(rho**2), d), one
                    )
    assert min(decided / 8, accepted / 5, near / 0.8) >= trials, (decided, accepted, near)


def test_what_is_no_proof():
    """The proof at rho = 1.2 holds at 1.1999, not at 1.2; nothing that is not finite is a proof."""
    R = loop_at(1.2).invariant(np.zeros((2, 2)), 1.0, 1.0, 0.0)
    zero, one = np.zeros((2, 2)), np.ones(1)
    for rho, holds in ((1.0, True), (1.1999, True), (1.2000001, False), (1.3, False)):
        assert loop_at(rho).verified(R, zero, 1.0, 1.0, one) is holds
    assert not judged(CENTRE, V, S, 1.0, -K).verified(R, zero, 1.0, 1.0, one)
    loop = loop_at(1.0)
    alone = R * [1.0, 0.0]  # Y is singular
    for wrong in (np.full((2, 2), np.nan), np.full((2, 2), np.inf), R[::-1].copy(), alone, 0 * R):
        assert not loop.verified(wrong, zero, 1.0, 1.0, one)
    assert loop.verified(-R, zero, 1.0, 1.0, one)  # the same Y
    skew = np.array([[0.0, 1e-12], [0.0, 0.0]])
    assert not loop.verified(R, skew, 1.0, 1.0, one)
    for alpha, lam in ((0.0, 1.0), (-1.0, 1.0), (np.nan, 1.0), (1.0, 0.0), (1.0, 1.1), (1.0, -1.0)):
        assert not loop.verified(R, zero, alpha, lam, one)
    for t in (0.0, -1.0, np.nan, np.inf):
        assert not loop.verified(R, zero, 1.0, 1.0, np.array([t]))
    Y = squared(R)
    assert not loop.verified(R, (Y + Y.T) / 2, 1.0, 1.0, one)  # X as large as Y
    with pytest.raises(se.StochensError):
        judged(CENTRE, V, S, 1.0, np.nan * K)
    assert loop_at(np.inf).status == "undetermined"


def test_the_verdict_on_both_sides_of_the_limit():
    """60 loops, in `make test` 16."""
    gen, trials = np.random.default_rng(3), sets(60, 16)
    refuted = 0
    for trial in range(trials):
        centre, V, S, K = random_loop(gen, 1 + trial % 4)
        n = len(centre)
        g = judged(centre, V, S, 1e-3, K).sizes[1] / 1e-3
        A0, E = centre @ twin.joined(K, n + 1), white(V) @ twin.joined(K, n + 1)
        assert twin.stacked_norm(A0, np.linalg.cholesky(S), E) <= g * (1 + 1e-4)
        assert judged(centre, V, S, 0.999 / g, K).status == "certified"
        assert judged(centre, V, S, 1.001 / g, K).status in ("not provable", "refuted")
        beyond = judged(centre, V, S, 1.07 / g, K)
        refuted += beyond.status == "refuted"
        if beyond.member is not None:
            A, B = beyond.member[:, :n], beyond.member[:, n:]
            assert np.abs(np.linalg.eigvals(A + B @ K)).max() > 1.0 + 1e-9
            assert ball(centre, V, S, 1.07 / g).contains(beyond.member)
    assert refuted >= 0.8 * trials


def test_a_counterexample_obeys_the_frobenius_bound():
    """`contains` asks the spectral norm alone; the bound in the same event counts as well."""
    centre, V, S, K = random_loop(np.random.default_rng(4), 3)
    g = judged(centre, V, S, 1e-3, K).sizes[1] / 1e-3
    small = judged(centre, V, S, 2.0 / g, K, frobenius=0.9 / g)
    assert small.status == "certified"
    for phi in (1.1 / g, 1.5 / g):
        loop = judged(centre, V, S, 5.0 / g, K, frobenius=phi)
        assert loop.status in ("refuted", "not provable")
        if loop.member is not None:
            scaled = np.linalg.solve(np.linalg.cholesky(S), loop.member - centre)
            assert np.linalg.norm(scaled @ np.linalg.cholesky(V)) <= phi * (1 + 1e-7)


# -- the package -------------------------------------------------------------------------------


def model(N=60, seed=1, *, a=1.2, sigma=0.1, **options):
    gen = np.random.default_rng(seed)
    x, w = gen.standard_normal((2, N, 2))
    u = gen.standard_normal((N, 1))
    A, B = np.array([[a, 0.3], [0.0, 0.7]]), np.array([[0.5], [1.0]])
    data = se.Trajectories.from_pairs(x, u, x @ A.T + u @ B.T + sigma * w)
    return se.identify(data, **opts(**{"sigma": sigma, **options}))


def test_from_data_to_a_tube():
    loop = se.gain(model(), 1.0, 1.0)
    assert np.abs(loop.E).max() < 1.0
    np.testing.assert_allclose(loop([1.0, 2.0]), loop.K @ [1.0, 2.0])
    proof = loop.certificate(0.05)
    assert proof.status == "certified"
    assert proof.check()
    assert proof.margin > 1.0
    assert re.search(r"certified for every system of the region \(95 %\)", repr(proof))
    tube = proof.tube([1.0, 0.0], 20, noise=0.05)
    assert (tube.components[1:] >= tube.model[1:, :2]).all()
    assert (tube.components[0] == 0).all()
    assert tube.settles(0.01) > tube.settles(0.1) >= 1
    assert tube.settles(1e-9) is None
    assert "90 % with noise" in repr(tube)
    for one in (loop, proof, tube):
        again = type(one).from_dict(one.to_dict())
        assert repr(again) == repr(one)
        assert one._repr_html_()
    # the same from a file; one whose proof was changed is refused
    changed = proof.to_dict()
    changed["proof"][0][0] *= 0.5
    with pytest.raises(InputError, match="do not prove"):
        LoopCertificate.from_dict(changed)
    assert len(tube.plot().axes) == 3
    assert isinstance(tube, Tube)


def test_gains_with_a_guarantee():
    one = model(N=25)
    plain, sure, wide = se.gain(one, 1.0, 1.0), se.gain(one, 1.0, 1.0, guarantee=0.05), se.gain(one)
    assert np.trace(sure.S) > np.trace(plain.S)
    margins = [loop.certificate(0.05).margin for loop in (plain, wide)]
    assert margins[1] > margins[0]
    assert wide.S is None
    assert wide.parameter >= margins[1] * 0.999
    # the same region made by hand, and another one
    region = one.region(0.05, frobenius=True)
    assert plain.certificate(region).region is region
    assert plain.certificate(0.01).margin < margins[0]


def test_as_python_control_has_it():
    control = pytest.importorskip("control")
    A, B = RIG[:, :4], RIG[:, 4:]
    loop = se.gain((A, B), *WEIGHTS)
    K, S, E = control.dlqr(A, B, *WEIGHTS)
    np.testing.assert_allclose(loop.K, -K, rtol=1e-8)
    np.testing.assert_allclose(loop.S, S, rtol=1e-8)
    np.testing.assert_allclose(np.sort_complex(loop.E), np.sort_complex(E), rtol=1e-6)


def test_what_the_data_do_not_determine():
    """One feedback in all runs: only that one can be certified."""
    gen = np.random.default_rng(5)
    x, w = gen.standard_normal((2, 80, 2))
    own = np.array([[-0.5, -0.3]])
    A, B = np.array([[1.1, 0.3], [0.0, 0.7]]), np.array([[0.5], [1.0]])
    data = se.Trajectories.from_pairs(x, x @ own.T, x @ (A + B @ own).T + 0.05 * w)
    with pytest.warns(se.exceptions.DataWarning, match="do not determine"):
        one = se.identify(data, noise=se.Noise(sigma=0.05))
    other = se.gain(se.System(A, B), 1.0, 1.0).K
    region = one.region(0.05)
    assert _core.Feedback(region.core, own).status == "certified"
    assert _core.Feedback(region.core, np.ascontiguousarray(other)).status == "undetermined"
    loop = se.feedback.Loop(one.A, one.B, other, None, "least squares", None, one.labels, None, one)
    proof = loop.certificate(0.05)
    assert proof.status == "undetermined"
    assert "do not determine the system along" in repr(proof)
    assert not np.isfinite(proof.tube([1.0, 0.0], 5).radii[1:]).any()
    assert proof.holds((-1.0, 1.0), [1.0, 0.0]) == 0.0
    with pytest.raises(SolverError, match="do not determine"):
        se.gain(one)
    # a plan off the feedback leaves what the data determine
    tube = _core.Feedback(region.core, own).tube(np.ones(2), 3, np.ones((1, 1)), 0.0, None)
    assert not np.isfinite(tube[3][1:]).any()
    # a region for one start alone
    full = model()
    few = full.region(0.05, x0=[1.0, 0.0]) if full.design == "independent" else None
    if few is not None:
        assert se.gain(full, 1.0, 1.0).certificate(few).status == "undetermined"


def test_an_offset_leaves_no_statement_for_all_time():
    gen = np.random.default_rng(6)
    x, u, w = gen.standard_normal((3, 60, 1))
    data = se.Trajectories.from_pairs(x, u, 1.1 * x + u + 0.3 + 0.05 * w)
    proof = se.gain(
        se.identify(data, intercept=True, noise=se.Noise(sigma=0.05)), 1.0, 1.0
    ).certificate(0.05)
    assert proof.status == "certified"
    tube = proof.tube([1.0], 20)
    assert np.isfinite(tube.radii).all()
    assert np.isinf(tube.later).all()
    assert np.isinf(tube.reach).all()
    assert tube.settles(10.0) is None
    with pytest.raises(InputError, match="a loop that rests at 0, without intercept"):
        proof.holds((-9.0, 9.0), [0.1])
    assert np.isfinite(proof.tube([1.0], 20, rest=proof.rest()).reach).all()


def of_runs(count=20, error=0.0, sigma=0.05, seed=0, **options):
    """A model of an oscillator, whose states are read with an error that is not declared."""
    rng = np.random.default_rng(seed)
    A, B = np.array([[1.0, 0.1], [-0.1, 0.8]]), np.array([[0.0], [1.0]])
    u = rng.standard_normal((count, 8, 1))
    x = np.empty((count, 9, 2))
    x[:, 0] = rng.standard_normal((count, 2))
    for k in range(8):
        noise = sigma * rng.standard_normal((count, 2))
        x[:, k + 1] = x[:, k] @ A.T + u[:, k] @ B.T + noise
    x += error * rng.standard_normal(x.shape)
    return se.identify(se.Trajectories(x, u), **opts(checks=False, **options))


def test_nothing_holds_where_the_data_are_doubted():
    """The core proves that the region is stable, but the true system is not in it."""
    with pytest.warns(se.exceptions.DataWarning, match="read with error"):
        doubted = of_runs(300, error=0.3)
    proof = se.gain(doubted, 1.0, 1.0).certificate(0.05)
    assert proof.status == "undetermined"
    assert proof.reason
    tube = proof.tube([1.0, 0.0], 15, noise=0.05)
    for bound in (tube.radii, tube.later, tube.reach, tube.noise, tube.noise_radius):
        assert np.isinf(bound).all()
    assert repr(tube) == "<Tube: 15 steps, unbounded>"
    assert proof.holds((-1.0, 1.0)) == 0.0


def test_a_row_that_is_known():
    nan = np.nan
    model = of_runs(sigma=0.05, known=([[1.0, 0.1], [nan, nan]], [[0.0], [nan]]))
    proof = se.gain(model, 1.0, 1.0).certificate(0.05)
    assert proof.status == "certified"
    assert proof.check()
    again = LoopCertificate.from_dict(proof.to_dict())
    assert again.check()
    assert again.norm == proof.norm


def test_files_prove_what_they_say():
    proof = se.gain(of_runs(), 1.0, 1.0).certificate(0.05)
    fields = proof.to_dict()
    for norm in (1e-6, -1.0, 0.0, 0.9 * proof.norm):
        with pytest.raises(InputError, match="do not prove"):
            LoopCertificate.from_dict({**fields, "norm": norm})
    stable = fields | {"status": "refuted", "proof": None, "member": proof.region.centre.tolist()}
    for forged in (stable, stable | {"member": None}):
        with pytest.raises(InputError, match="an unstable system of the region"):
            LoopCertificate.from_dict(forged)


def forged(value):
    """What a file may have in place of an array or a number: each must be refused."""
    own = np.asarray(value, dtype=float)
    yield from (np.full(own.shape, bad) for bad in (np.nan, np.inf, -np.inf, -1e308))
    yield -np.abs(own) if own.any() else own - 1.0
    yield np.ones((*own.shape, 2))
    if own.ndim:
        yield own.ravel()[:-1]


@pytest.mark.parametrize(
    "path",
    [
        ("region", "centre"), ("region", "delta"), ("region", "frobenius"), ("region", "noise"),
        *(("region", "parts", 0, name) for name in ("white", "root", "ratio", "shape", "factor")),
        ("K",), ("norm",), ("least",), ("spectral_radius",), ("proof",), ("multipliers",),
        ("residual",), ("degrees",),
    ],
)  # fmt: skip
def test_every_field_of_a_forged_file_is_checked(path):
    """A negative or infinite covariance of the noise was taken, and `check()` said True."""
    model = of_runs()
    if path[0] in ("residual", "degrees"):
        pairs = se.Trajectories.from_pairs(*of_runs().data.pairs())
        model = se.identify(pairs, checks=False, noise=se.Noise(design="independent"))
    loop = se.gain(model, 1.0, 1.0)
    fields = loop.certificate(model.region(0.05, frobenius="parts" not in path)).to_dict()
    *above, last = path
    parent = fields
    for key in above:
        parent = parent[key]
    true = parent[last]
    assert true is not None
    for value in forged(true):
        if np.array_equal(value, true) or (
            last == "proof" and np.array_equal(value, -np.abs(true))
        ):
            continue  # a root with other signs may prove it too
        if path == ("region", "centre") and np.isfinite(value).all() and value.min() > -1e307:
            continue  # another region is checked as such
        parent[last] = value.tolist()
        with pytest.raises((InputError, NonFiniteError, InputTypeError)):
            LoopCertificate.from_dict(fields)


def test_bounds_are_rounded_outwards():
    for seed in range(8):
        proof = se.gain(of_runs(seed=seed), 1.0, 1.0).certificate(0.05)
        said = float(re.search("margin at least ([^,>]*)", repr(proof))[1])
        assert 0.99 * proof.margin < said <= proof.margin
        tube = proof.tube([1.0, 0.0], 9)
        within = float(re.search("within ([^ ]*)", repr(tube))[1])
        assert tube.radii.max() <= within < 1.01 * tube.radii.max()
    assert "(99.9999 %)" in repr(se.gain(of_runs(), 1.0, 1.0).certificate(1e-9))
    with pytest.raises(InputError, match="`noise` must be below 1 - delta"):
        se.gain(of_runs(), 1.0, 1.0).certificate(0.45).tube([1.0, 0.0], 5, noise=0.6)


def test_regions_of_other_models_are_refused():
    loop, other = se.gain(of_runs(), 1.0, 1.0), of_runs(seed=1)
    with pytest.raises(InputError, match="another centre"):
        loop.certificate(other.region(0.05))
    for weights in ([1.0, -0.01], [[1.0, 2.0], [2.0, 1.0]]):
        with pytest.raises(InputError, match="`Q` must"):
            se.gain(of_runs(), weights, 1.0)


def test_limits_from_starts_of_any_size():
    proof = se.gain(of_runs(), 1.0, 1.0).certificate(0.05)
    for direction in ([1.0, 0.5], [-0.2, 1.0]):
        one = proof.holds((-1.0, 1.0), direction)
        assert 0.0 < one < np.inf
        for size in (1e-310, 1e-300, 1e-160, 1e-3, 1e160, 1e300):
            scale = proof.holds((-1.0, 1.0), size * np.array(direction))
            expected = min(one / size, np.finfo(float).max) if size > 1e-309 else scale
            assert scale == pytest.approx(expected, rel=1e-3)
            assert np.isfinite(scale)
