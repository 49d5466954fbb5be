"""`Plan.typical`: the law of the misses, what it is shown with, and where it is refused."""

from __future__ import annotations

import pickle
import warnings

import numpy as np
import pytest
from scipy import stats

import stochens_rs as se
from coverage_study import sets
from declarations import opts
from stochens_rs import _core
from stochens_rs._base import show
from stochens_rs.controls import Typical
from stochens_rs.exceptions import DataWarning, InputError, SizeError
from stochens_rs.identification.model import estimate_law
from twin import typical as twin

pytestmark = pytest.mark.usefixtures("noise_by_formula")

A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.0], [1.0]])
KEY = bytes(range(32))


def data(runs: int = 6, steps: int = 6, seed: int = 1, c: float = 0.0) -> se.Trajectories:
    gen = np.random.default_rng(seed)
    x, u = np.empty((runs, steps + 1, 2)), gen.standard_normal((runs, steps, 1))
    x[:, 0] = gen.standard_normal((runs, 2))
    for k in range(steps):
        w = 0.1 * gen.standard_normal((runs, 2)) @ np.array([[1.0, 0.5], [0.0, 0.3]])
        x[:, k + 1] = x[:, k] @ A.T + u[:, k] @ B.T + c + w
    return se.Trajectories(x, u)


def planned(**options) -> se.Plan:
    options = {"checks": False, **options}
    runs = data(c=0.3 if "intercept" in options else 0.0)
    return se.control(se.identify(runs, **opts(**options)), [1.0, 0.5], [0.0, 0.2], steps=4)


LAWS = {
    "known": {"covariance": [[0.0125, 0.0015], [0.0015, 0.0009]]},
    "scalar": {"covariance": "scalar", "intercept": True},
    "diagonal": {"covariance": "diagonal", "known": (None, [[0.0], [1.0]])},
    "full": {},
}


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("kind", LAWS)
def test_the_law_of_the_misses(kind: str, noise: bool) -> None:
    """4000 draws of each code, in `make test` 1500: Kolmogorov and Smirnov's test at 1e-5."""
    count = sets(4000, 1500)
    plan = planned(**LAWS[kind])
    law = estimate_law(plan.basis.model)
    assert law[3] == kind
    what = law, plan.basis.x0, plan.u, plan.basis.xf
    found = _core.drawn_misses(*(law, plan.basis.x0, plan.u, plan.basis.xf), noise, count, KEY, 2)
    own = twin.misses(*what, noise, count, np.random.default_rng(3))
    assert stats.ks_2samp(found, own).pvalue > 1e-5
    # mutant: noise of half the size
    half = (*law[:2], law[2] / 4.0, *law[3:])
    wrong = twin.misses(half, *what[1:], noise, count, np.random.default_rng(3))
    assert stats.ks_2samp(found, wrong).pvalue < 1e-5
    if not noise:
        models = _core.estimate_draws(law, 50, KEY, 1).reshape(50, 2, -1)
        for miss, Theta in zip(found, models, strict=False):
            x = plan.basis.x0
            for u in plan.u:
                x = Theta @ np.concatenate([x, u, np.ones(Theta.shape[1] - 3)])
            assert miss == pytest.approx(np.linalg.norm(x - plan.basis.xf), rel=1e-9)


def test_it_is_an_order_statistic_and_repeats() -> None:
    plan = planned()
    found = plan.typical(0.1, draws=400, rng=7)
    key = bytes(se.rng.as_key(7).child("typical"))
    misses = np.sort(
        _core.drawn_misses(
            *(estimate_law(plan.basis.model), plan.basis.x0, plan.u, plan.basis.xf),
            False,
            400,
            key,
            1,
        )
    )
    assert found.miss == misses[361 - 1]  # ceil(.9 * 401)
    assert found.miss == plan.typical(0.1, draws=400, rng=7).miss
    assert found.miss != plan.typical(0.1, draws=400, rng=8).miss
    assert plan.typical(draws=19).miss >= plan.typical(0.5, draws=19).miss


def test_it_stands_beside_the_certificate(tmp_path) -> None:
    for noise in (False, True):
        plan = planned(sigma=0.1)
        found = plan.typical(noise=noise)
        assert found.certified == plan.bound(noise=noise).target
        assert found.miss < found.certified
        for shown in (repr(found), found._repr_html_()):
            wide = show.at_most(found.certified)
            assert f"certified {wide}, typical {found.miss:.3g}" in shown
        assert "approximate" in found._repr_html_()
        assert ("with noise" in repr(found)) == noise
    assert "known covariance" in found.assumption
    assert "fixed beforehand" in found.assumption
    assert "not tested" in found.assumption
    assert "without a warning" in planned(checks=True).typical().assumption
    found.save(tmp_path / "typical.state")
    for other in (
        pickle.loads(pickle.dumps(found)),
        Typical.from_dict(found.to_dict()),
        Typical.load(tmp_path / "typical.state"),
    ):
        assert repr(other) == repr(found)
    with pytest.raises(InputError, match="`miss` must be >= 0"):
        Typical(-1.0, 1.0, 0.05, 19, False, "")


def test_where_no_law_is_known_it_is_refused() -> None:
    model = planned().basis.model
    few = se.identify(data(2, 3), checks=False)
    stream = se.ModelStream(2, 1, noise=se.Noise(sigma=0.1))
    stream.update(data())
    gen = np.random.default_rng(1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        x = np.array([one for one, _ in data(40, 10).runs])
        noisy = se.identify(
            se.Trajectories(x + gen.standard_normal(x.shape), [u for _, u in data(40, 10).runs])
        )
        same = se.identify(
            se.Trajectories([np.ones((5, 2))], [np.ones((4, 1))]), noise=se.Noise(sigma=1.0)
        )
    assert noisy.warnings
    for plan, text in (
        (se.control((A, B), [1.0, 0.0], [0.0, 0.0], steps=3), "a model by `identify`"),
        (se.control(stream.model, [1.0, 0.0], [0.0, 0.0], steps=3), "a model by `identify`"),
        (se.control(model, se.Uncertain([1.0, 0.0], 0.1), [0.0, 0.0], steps=3), "exact x0"),
        (se.control(few, [1.0, 0.0], [0.0, 0.0], steps=3), "4 more pairs than unknowns"),
        (se.control(noisy, [1.0, 0.0], [0.0, 0.0], steps=3), "beside a warning"),
        (se.control(same, [1.0, 0.0], [0.0, 0.0], steps=3), "beside a warning"),
        (planned(noise="sub-gaussian", sigma=0.1), "Gaussian noise"),
        (planned(known=(None, [[0.0], [np.nan]])), "single known entries"),
    ):
        with pytest.raises(InputError, match=text):
            plan.typical()
    with pytest.raises(SizeError, match="`draws` must be at least 19"):
        planned().typical(draws=18)
