"""Plans near a reference after logs with feedback: the core against plain NumPy, and refusals."""

from __future__ import annotations

import pickle
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.stats import chi2, norm

import stochens_rs as se
from coverage_study import at_most, exactly, sets
from feedback_logs import CASES, Case, courses, outputs, states
from stochens_rs import _core
from stochens_rs.exceptions import InputError, SolverError
from twin import sharper as twin

Array = np.ndarray
DELTA = 0.05


# -- the core against plain NumPy ------------------------------------------------------------------


def way(model: Any, Theta: Array, T: Array, root: Array, x0: Array, u: Array, K: Any) -> Any:
    """The loop of (y; x), what its error sees, and what it sees of the plan."""
    J, ABc, G = model.regressors.loop(Theta)
    n, p, m = len(ABc), len(Theta), u.shape[1]
    gain = np.zeros((m, n)) if K is None else K
    joined = np.vstack([np.eye(n), gain, np.zeros((ABc.shape[1] - n - m, n))])
    A = np.hstack([np.zeros((p + n, p)), np.vstack([Theta @ J, ABc]) @ joined])
    E = np.hstack([np.zeros((len(T), p)), T @ J @ joined])
    x, c = x0, []
    for one in u:
        z = np.concatenate([x, one, np.ones(ABc.shape[1] - n - m)])
        c.append(T @ J @ z)
        x = ABc @ z
    return twin.Followed(A, np.vstack([np.eye(p), G]) @ root, E, np.array(c))


def rates(A: Array, steps: int) -> list[float]:
    """Those of the core: about how fast A grows over so many steps."""
    sizes = [np.linalg.norm(np.linalg.matrix_power(A, k + 1)) for k in range(steps)]
    half = (steps - 1) // 2
    grown = (sizes[-1] / sizes[half]) ** (1.0 / max(steps - 1 - half, 1))
    if grown < 1.0:
        near = [1.0 - share * (1.0 - max(grown, 0.05)) for share in (-1.0, 0.25, 0.5, 0.75, 0.9)]
    else:
        near = [many * grown for many in (1.0, 1.02, 1.1, 1.2, 1.3)]
    return [*near, 0.9, 1.0, 1.05]


class Sides(NamedTuple):
    """Of the model and of noise, by the core and by plain NumPy, (steps, p)."""

    core: tuple[Array, Array]
    twin: tuple[Array, Array]


def sides(case: Case, seed: int, noise: bool, *, followed: bool = True) -> Sides:
    data = case.log(np.random.default_rng(seed))
    model = case.models(data, followed)
    plan, pilot, K = case.plan(model), model.pilot, None
    if followed:
        K = se.gain(model, *case.weights).K
    x0 = plan.predicted_states[0]
    n, d = model.coefficients.shape
    fit, N = model.piloted, len(model.rows)
    known = case.known
    radii, first, later, of_noise = (0.1, 0.38, 0.08, 0.44) if noise else (0.1, 0.8, 0.1, 0.0)
    share = DELTA * (1.0 if known else 0.88)
    spectral = np.sqrt(_core.wishart_quantile(n, d, radii * share / 2, 1))
    frobenius = np.sqrt(chi2.isf(radii * share / 2, n * d))
    S = case.covariance
    if not known:
        z, y = np.split(model.rows, [d], axis=1)
        H_LS = np.linalg.lstsq(z, y, rcond=None)[0].T
        left, V = y - z @ H_LS.T, z.T @ z
        spent = twin.Spent(fit.centre, fit.white, fit.white, z, V, H_LS, left.T @ left)
        lowest = _core.smallest_quantile(n, N, 0.12 * DELTA, 1)
        S = twin.covariance_bound(spent, spectral, lowest)
    root = np.linalg.cholesky(S)
    T0 = np.linalg.inv(pilot.root).T / np.sqrt(N)
    own = way(model, fit.centre, fit.white, root, x0, plan.u, K)
    other = way(model, pilot.model, T0, root, pilot.start, pilot.inputs, pilot.follow)
    steps, rows = len(plan.u), np.eye(n, len(own.A))
    at = twin.Levels(spectral, frobenius, first * share, later * share)
    _, rest = twin.near(own, other, rows, at, rates(other.A, steps), known=known)
    linear = [[least(twin.X(own, h, k), twin.X(other, h, k), z, at) for h in rows]
              for k, z in enumerate(quantiles(at.first, steps, n), 1)]  # fmt: skip
    wide = np.zeros_like(rest)
    if noise:
        z = quantiles(of_noise * share, steps, n)
        wide = np.array(z)[:, None] * deviations(own, rows, spectral)
    law = model.assumptions.covariance, model.assumptions.known
    found = fit.followed(*courses(model, plan, K), law, DELTA, noise)
    assert (found[0][0] == 0).all()
    assert (found[1][0] == 0).all()
    return Sides((found[0][1:], found[1][1:]), (np.array(linear) + rest, wide))


def quantiles(delta: float, steps: int, rows: int) -> list[float]:
    """Of the rows of each step."""
    return [twin.quantile_at(k, steps, rows, delta) for k in range(1, steps + 1)]


def least(X: Array, X0: Array, z: float, at: Any) -> float:
    """The least over s of the bound of first order, on a fine grid and where X is nearest."""
    nearest = np.sum(X * X0) / max(np.sum(X0 * X0), 1e-300)
    shares = [*np.linspace(0.0, 1.5, 61), nearest, 0.5 * nearest]
    off = [(abs(s) * z * np.linalg.norm(X0), X - s * X0) for s in shares]
    return min(
        by + min(at.spectral * np.linalg.norm(D, "nuc"), at.frobenius * np.linalg.norm(D))
        for by, D in off
    )


def deviations(own: Any, rows: Array, rho: float) -> Array:
    """Of the noise, in the units in which D has rows of length 1, as the core takes alpha."""
    sizes = np.linalg.norm(own.D, axis=1)
    units = np.where(sizes > 0.0, sizes, 1e8)
    A, D, E = own.A * units / units[:, None], own.D / units[:, None], own.E * units
    scaled = twin.Followed(A, D, E, own.c)
    return twin.deviations(scaled, rows, rho, D @ D.T) * units[: len(rows)]


CHECKED = {
    "states": lambda: (CASES["unstable"](), True),
    "states, unknown": lambda: (CASES["unstable, unknown"](), True),
    "units": lambda: (CASES["units"](), True),
    "states, open": lambda: (CASES["unstable"](), False),
    "offset": lambda: (CASES["offset"](), True),
    "one step": lambda: (CASES["unstable"]()._replace(steps=1), True),
    "readings": lambda: (outputs(7, known=True, runs=40, steps=5), True),
    "readings, unknown": lambda: (outputs(11, known=False, steps=7), True),
    "filters": lambda: (outputs(11, known=True, steps=5)._replace(filters=(0.5, 3)), True),
    "readings, open": lambda: (outputs(11, known=True, steps=4), False),
}


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")  # of the filters
@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("name", CHECKED)
def test_the_core_is_not_below_plain_numpy(
    name: str, noise: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the same rates; its gains are rounded up to a list, its horizons to parts of the whole.

    The last c acts on no f of the horizon: the core leaves it out of ``||c||_t``, so does this.
    """
    plain = twin.beta

    def beta(plan: Any, T: Array, rho: float, phi: float, t: float, k: int) -> float:
        short = rho * twin.gain(plan, t, k) * twin.length(plan.c[: k - 1], t)
        return min(plain(plan, T, rho, phi, t, k), short)

    monkeypatch.setattr(twin, "beta", beta)
    case, followed = CHECKED[name]()
    for seed in range(sets(20, 2)):
        core, other = sides(case, seed, noise, followed=followed)
        for by, lower in zip(core, other, strict=True):
            assert (by >= lower * (1 - 1e-6)).all()
            assert (by <= 1.2 * lower).all()


def test_readings_of_any_region_against_plain_numpy() -> None:
    """Of a followed plan without reference: first order, the rest on the ball, and noise."""
    case = outputs(7, known=True, runs=40, steps=8)
    data = case.log(np.random.default_rng(1))
    model = case.plain(data)
    plan, K = case.plan(model), se.gain(model, *case.weights).K
    region = model.region(DELTA)
    J, ABc, G = map(np.ascontiguousarray, model.regressors.loop(model.coefficients))
    system, S = (ABc, J, G, plan.u.shape[1]), np.ascontiguousarray(region.noise)
    x0 = np.ascontiguousarray(plan.predicted_states[0])
    *_, mean, read = _core.output_tube(region.core, system, x0, plan.u, K, (S, 0.01), None)
    part = region.core.parts[0]
    rho, phi = np.sqrt(part.factor), region.core.frobenius or np.inf
    white, shape = part.white, part.S
    own = way(model, model.coefficients, white, np.linalg.cholesky(shape), x0, plan.u, K)
    p, steps = len(shape), len(plan.u)
    rows = np.eye(p, len(own.A))
    found = twin.tube(*own, rows, rho, phi, ts=rates(own.A, steps))
    assert (mean[1][1:] >= found.first * (1 - 1e-6)).all()
    assert (mean[1][1:] <= 1.2 * (found.first + found.rest)).all()
    # each step and row of the noise has an equal share
    z = norm.isf(0.01 / (2 * steps * p))
    assert read is not None
    wide = z * deviations(own, rows, rho)
    assert (read[1] - mean[1])[1:] == pytest.approx(wide, rel=1e-3)
    # no member of the region leaves
    gen, nearest = np.random.default_rng(2), 0.0
    for trial in range(sets(2000, 100)):
        one = gen.standard_normal((p, len(white)))
        if trial % 2:
            X = twin.X(own, rows[trial % p], 1 + trial % steps)
            U, _, V = np.linalg.svd(X, full_matrices=False)
            one = U @ V + 0.05 * one * np.linalg.norm(X) / np.linalg.norm(one)
        one *= min(rho / np.linalg.norm(one, 2), phi / np.linalg.norm(one))
        off = np.abs(twin.orders(own, one)[0][:, :p])
        assert (off <= mean[1] * (1 + 1e-9)).all()
        nearest = max(nearest, (off[1:] / mean[1][1:]).max())
    assert nearest > 0.8


# -- weights after the past ------------------------------------------------------------------------

Design = Any
FIRST, LATER = 20, 120


def designs() -> dict[str, tuple[Array, Array, Any]]:
    """[A B c], the root of Sigma, and the input of all sets from (t, x, last noise, dither)."""
    turn = 1.02 * np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    double = np.array([[1.0, 0.1, 0.005], [0.0, 1.0, 0.1]])
    mixed = np.array([[0.3, 0.0], [0.1, 0.05]])

    def stopped(t: int, x: Array, w: Array, v: Array) -> Array:
        return v * (np.abs(w[:, :1]) < 0.4)

    return {
        "unit root, offset": (np.array([[1.0, 0.5, 0.2]]), np.eye(1) * 0.3, lambda t, x, w, v: v),
        "relay": (
            np.array([[1.3, 1.0]]), np.eye(1) * 0.2,
            lambda t, x, w, v: np.clip(-0.9 * x, -1, 1) - 0.3 * np.sign(x) + 0.3 * v,
        ),
        "excited by noise": (
            double, mixed, lambda t, x, w, v: -x @ [[2.0], [2.0]] + v * np.abs(w[:, :1]) * 5,
        ),
        "switched off": (np.array([[0.8, 1.0]]), np.eye(1) * 0.3, stopped),
        "turning": (
            np.hstack([turn, [[0.0], [1.0]]]), mixed,
            lambda t, x, w, v: np.tanh(-x @ [[0.3], [0.4]]) + 0.5 * v,
        ),
    }  # fmt: skip


def logs(
    name: str, count: int, seed: int, later: int = LATER
) -> tuple[Array, Array, Array, Array, Array]:
    """Theta, the root of Sigma, z (count, N, d), y and noise (count, N, n)."""
    Theta, root, act = designs()[name]
    n, gen = len(Theta), np.random.default_rng([seed, len(name)])
    offset = np.ones((count, Theta.shape[1] - n - 1))
    x, w, rows = gen.standard_normal((count, n)), np.zeros((count, n)), []
    for t in range(FIRST + later):
        u = act(t, x, w, gen.standard_normal((count, 1)))
        w = gen.standard_normal((count, n)) @ root.T
        z = np.hstack([x, u, offset])
        x = z @ Theta.T + w
        rows.append((z, x, w))
    z, y, w = (np.stack(each, axis=1) for each in zip(*rows, strict=True))
    return Theta, root, z, y, w


def weighted(z: Array, y: Array) -> _core.Pilot:
    first = np.linalg.lstsq(z[:FIRST], y[:FIRST], rcond=None)[0].T
    root = np.linalg.qr(z[:FIRST], mode="r") / np.sqrt(FIRST)
    rows = np.ascontiguousarray(np.hstack([z[FIRST:], y[FIRST:]]))
    return _core.Pilot.after(rows, np.ascontiguousarray(first), root, FIRST, 1, 1)


@pytest.mark.parametrize("name", designs())
def test_the_law_of_weights_after_the_past(name: str) -> None:
    """``||Gamma||_F^2`` is chi^2 and the covariance and the model are in their bounds.

    4000 sets, in `make test` 250, three levels: a count is refused by chance once in 100 000 times.
    """
    count = sets(4000, 250)
    Theta, root, z, y, _ = logs(name, count, 7)
    S = root @ root.T
    levels = np.array([0.5, 0.2, 0.05])
    outside, missed = np.zeros(3, int), np.zeros((2, 3), int)
    for one, after in zip(z, y, strict=True):
        try:
            fit = weighted(one, after)
        except SolverError:  # a relay that lost the pole
            assert np.abs(one).max() > 1e12
            continue
        Gamma = np.linalg.solve(root, fit.centre - Theta) @ np.linalg.inv(fit.white)
        outside += np.sum(Gamma**2) > chi2.isf(levels, Gamma.size)
        for at, delta in enumerate(levels):
            region = fit.region(("full", None), delta, True)
            missed[0, at] += not region.contains(np.ascontiguousarray(Theta))
            bound = region.noise
            if bound is not None:
                missed[1, at] += np.linalg.eigvalsh(bound - S)[0] < 0.0
    for at, delta in enumerate(levels):
        exactly(outside[at], count, delta)
        at_most(missed[0, at], count, delta)
        at_most(missed[1, at], count, 0.12 * delta + 0.88 * delta)


def test_a_long_unit_root_has_weights() -> None:
    """Its forecast is spent early: of 600 pairs behind 20, each log has its law."""
    Theta, root, z, y, _ = logs("unit root, offset", sets(2000, 120), 9, 600)
    outside = 0
    for one, after in zip(z, y, strict=True):
        fit = weighted(one, after)
        Gamma = np.linalg.solve(root, fit.centre - Theta) @ np.linalg.inv(fit.white)
        outside += np.sum(Gamma**2) > chi2.isf(0.2, Gamma.size)
    exactly(outside, len(z), 0.2)


@pytest.mark.parametrize("name", list(designs())[1:])
def test_the_error_is_what_the_weights_make_of_the_noise(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``H - Theta = W' Q T``, Q by plain NumPy that starts its blocks where the core does.

    So many pairs that no block starts within the last d. The room of the core for rounding moves
    its weights by up to 1 %.
    """

    def starts(N: int, blocks: int) -> set[int]:
        shares = 1.0 - (1.0 - np.arange(blocks) / blocks) ** 2
        return set(np.ceil(shares * (N - d)).astype(int).tolist())

    monkeypatch.setattr(twin, "starts_of_blocks", starts)
    Theta, _, z, y, w = logs(name, 3, 8, 600)
    d = Theta.shape[1]
    for one, after, noise in zip(z, y, w, strict=True):
        fit, main = weighted(one, after), one[FIRST:]
        root = np.linalg.qr(one[:FIRST], mode="r") / np.sqrt(FIRST)
        q = twin.spend(main @ np.linalg.inv(root), FIRST)
        T = np.linalg.inv(main.T @ q)
        size = np.abs(T).max()
        assert fit.white == pytest.approx(T, abs=0.02 * size)
        assert fit.centre - Theta == pytest.approx(noise[FIRST:].T @ q @ T, abs=0.02 * size)


# -- through `identify`: what is refused, what is infinite, what is kept ---------------------------

UNSTABLE = CASES["unstable"]()
Runs = list[Array]


def given(seed: int = 0) -> tuple[Runs, Runs]:
    """States and inputs of the runs of a log, to be changed."""
    data = UNSTABLE.log(np.random.default_rng(seed))
    x, u = zip(*data.runs, strict=True)
    return [np.array(one) for one in x], [np.array(one) for one in u]


def first_part() -> tuple[Any, Any]:
    """The plan and the gain of the first runs alone."""
    first = se.identify(se.Trajectories(*(of[: UNSTABLE.k] for of in given())), **options())
    return UNSTABLE.plan(first), se.gain(first, *UNSTABLE.weights)


def options(**others: Any) -> dict[str, Any]:
    return {**UNSTABLE.options(), **others}


PLAN, GAIN = first_part()


def model_of(x: Runs, u: Runs, **others: Any) -> se.Model:
    pilot = {"source": UNSTABLE.k, "reference": PLAN, "gain": GAIN, "lengths_fixed": False}
    pilot.update((name, others.pop(name)) for name in pilot if name in others)
    near = se.Pilot(pilot.pop("source"), inputs="any", **pilot)
    return se.identify(se.Trajectories(x, u), pilot=near, **options(**others))


def bound_of(model: se.Model, delta: float = DELTA, noise: bool = True) -> se.Certificate:
    own = se.gain(model, *UNSTABLE.weights)
    return UNSTABLE.plan(model).bound(delta, gain=own, noise=noise)


def test_it_is_near_a_reference_and_smaller() -> None:
    x, u = given()
    model = model_of(x, u)
    bound = bound_of(model, noise=False)
    assert "near a reference" in str(bound)
    assert "order of time" in bound.assumption
    assert "reference fixed" in bound.assumption
    assert bound.target < bound_of(UNSTABLE.plain(model_data(x, u)), noise=False).target
    assert bound.target < bound_of(model).target
    # by other steps: that of any plan
    longer = se.control(model, *UNSTABLE.task, steps=7)
    assert "near a reference" not in str(longer.bound(gain=se.gain(model, *UNSTABLE.weights)))


def model_data(x: Runs, u: Runs) -> se.Trajectories:
    return se.Trajectories(x, u)


def test_saved_and_pickled_models_have_the_same_bounds(tmp_path: Any) -> None:
    cases = UNSTABLE, CASES["readings, unknown"]()
    for case in cases:
        model = case.models(case.log(np.random.default_rng(4)))
        model.save(tmp_path / "model.npz")
        others = [se.Model.load(tmp_path / "model.npz"), pickle.loads(pickle.dumps(model))]
        plans = [case.plan(one) for one in (model, *others)]
        plans.append(pickle.loads(pickle.dumps(plans[0])))
        gain = se.gain(model, *case.weights)
        for noise in (False, True):
            bounds = [plan.bound(DELTA, gain=gain, noise=noise) for plan in plans]
            for other in bounds[1:]:
                assert other.target == bounds[0].target
                for name in ("tube", "readings" if case.lags else "components"):
                    assert (other[name].radius == bounds[0][name].radius).all()


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
def test_runs_that_determine_nothing_have_infinite_bounds() -> None:
    x, u = given()
    k = UNSTABLE.k
    main = range(k, len(x))
    for still in ([1.0 + 0.0 * one for one in u], [one * (i < k) for i, one in enumerate(u)]):
        bound = bound_of(model_of(x, still))
        assert np.isinf(bound.target)
    nothing = [one * (i not in main) for i, one in enumerate(x)]
    silent = [one * (i not in main) for i, one in enumerate(u)]
    assert np.isinf(bound_of(model_of(nothing, silent)).target)
    # a row that was not the plant's: the log contradicts the declared noise
    broken = [one.copy() for one in x]
    broken[k + 1][3] = 1e3
    model = model_of(broken, u)
    assert "jump there and back" in model.warnings[0]
    assert np.isinf(bound_of(model).target)


def test_few_runs() -> None:
    x, u = given()
    k = UNSTABLE.k
    few = model_of(
        [*x[:k], x[k][:7]], [*u[:k], u[k][:6]], lengths_fixed=True
    )  # twice as many pairs as unknowns
    wide = bound_of(few).target
    assert wide > 3.0 * bound_of(model_of(x, u)).target
    for steps in (1, 2, 5):
        with pytest.raises(InputError, match=r"got \d for 3"):
            bound_of(
                model_of([*x[:k], x[k][: steps + 1]], [*u[:k], u[k][:steps]], lengths_fixed=True)
            )
    for count in (1, k):
        with pytest.raises(InputError, match="must leave runs for the model"):
            model_of(x[:count], u[:count])


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
@pytest.mark.parametrize("run", [0, 8])
def test_values_that_cannot_be(value: float, run: int) -> None:
    x, u = given()
    x[run][3] = value
    with pytest.raises(InputError), np.errstate(over="ignore"):
        bound_of(model_of(x, u))


def test_a_first_part_that_determines_nothing() -> None:
    x, u = given()
    k = UNSTABLE.k
    same = [np.ones_like(one) if i < k else one for i, one in enumerate(x)]
    none = [one * (i >= k) for i, one in enumerate(u)]
    with pytest.raises(InputError, match="`source` must be more runs: the first 5, 60 pairs"):
        model_of(same, none)


def test_a_tail_is_refused() -> None:
    """The weights know the noise alone; a region that leaves out the tail would be too small."""
    y, u = np.random.default_rng(1).standard_normal((2, 12, 30, 1))
    data = se.Trajectories(list(y), list(u[:, :-1]), outputs=True)
    pilot = se.Pilot(4, inputs="any")
    with pytest.raises(InputError, match="`tail` of `window` must be 0"):
        se.identify(data, window=se.Window(lags=2, tail=0.1), pilot=pilot)


def test_what_all_runs_say_is_refused() -> None:
    x, u = given()
    every = UNSTABLE.plain(se.Trajectories(x, u))
    with pytest.raises(InputError, match="`reference` must not come from the runs of the model"):
        model_of(x, u, reference=UNSTABLE.plan(every))
    with pytest.raises(InputError, match="`gain` must not come from the runs of the model"):
        model_of(x, u, gain=se.gain(every, *UNSTABLE.weights))
    with pytest.raises(InputError, match="`gain` must be a Loop"):
        model_of(x, u, gain=GAIN.K)
    with pytest.raises(InputError, match="`source` must be a share or a number"):
        model_of(x, u, source=True)
    with pytest.raises(InputError, match="Gaussian noise"):
        model_of(x, u, noise=se.Noise("sub-gaussian", sigma=0.1))
    case = CASES["readings, unknown"]()
    data = case.log(np.random.default_rng(0))
    near = se.Pilot(case.k, inputs="any", reference=([0.0], [0.0], 3))
    with pytest.raises(InputError, match="must be a Plan for outputs"):
        se.identify(data, pilot=near, **case.options())


def test_runs_may_start_where_others_ended() -> None:
    """Starts that the past decides are allowed, which a pilot in open loop refuses."""
    case = CASES["starts"]()
    data = case.log(np.random.default_rng(0))
    ends = {run[0][-1].tobytes() for run in data.runs}
    assert any(run[0][0].tobytes() in ends for run in data.runs)
    assert np.isfinite(bound_of(case.models(data)).target)
    with pytest.raises(InputError, match="starts where another ended"):
        se.identify(data, pilot=se.Pilot(case.k), **case.options())


def test_noise_that_moves_one_state() -> None:
    """A nearly singular covariance: what it hardly moves is known as well."""
    case = states([[0.9, 0.2], [0.0, 0.8]], [[0.0], [1.0]], [1e-8, 0.1], [[-0.3, -0.2]])
    data = case.log(np.random.default_rng(0))
    model = case.models(data)
    gain, plan = se.gain(model, *case.weights), case.plan(model)
    rows = model.piloted.followed(*courses(model, plan, gain.K), law_of(model), DELTA, True)
    assert rows is not None
    assert rows[0][1, 0] < 1e-6
    assert rows[1][1, 0] < 1e-6
    assert 0.1 < rows[1][1, 1] < 1.0


def law_of(model: se.Model) -> Any:
    return model.assumptions.covariance, model.assumptions.known


@pytest.mark.parametrize(("n", "m", "steps"), [(12, 3, 10), (20, 5, 10), (2, 1, 400)])
def test_large_models_and_long_plans(n: int, m: int, steps: int) -> None:
    """Where matrices would be too large, the bound of any design; it ends in time either way."""
    gen = np.random.default_rng(n)
    A = gen.standard_normal((n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    case = states(A, gen.standard_normal((n, m)), 0.05, np.zeros((m, n)), runs=60, steps=steps)
    model = case.models(case.log(gen))
    bound = case.plan(model).bound(DELTA, gain=se.gain(model, *case.weights), noise=True)
    assert np.isfinite(bound.target)


def test_runs_of_unequal_length_need_a_declaration() -> None:
    """The number of pairs must not be decided by the noise: also where rows are lost."""
    x, u = given()
    x[-1], u[-1] = x[-1][:6], u[-1][:5]
    with pytest.raises(InputError, match="lengths_fixed"):
        model_of(x, u)
    table = {name: np.zeros(0) for name in ("run", "time", "a", "b", "u")}
    for run, (states_of, inputs_of) in enumerate(zip(*given(), strict=True)):
        at = np.arange(len(states_of))
        rows = run + 0.0 * at, 0.1 * at, *states_of.T, np.append(inputs_of[:, 0], np.nan)
        kept = (run != 8) | (at != 5)
        for name, column in zip(table, rows, strict=True):
            table[name] = np.append(table[name], column[kept])
    data = se.Trajectories.from_table(table, states=["a", "b"], inputs=["u"], by="run", time="time")
    with pytest.raises(InputError, match="lengths_fixed"):
        se.identify(data, pilot=se.Pilot(UNSTABLE.k, inputs="any"), **options())
    declared = se.Pilot(UNSTABLE.k, inputs="any", lengths_fixed=True)
    assert se.identify(data, pilot=declared, **options()).data.size > 100


def test_powers_that_overflow_have_an_infinite_bound() -> None:
    case = states(8.0, 1.0, 0.1, -7.8, steps=200)
    model = case.models(case.log(np.random.default_rng(0)))
    bound = case.plan(model).bound(DELTA, gain=se.gain(model, *case.weights))
    assert np.isinf(bound.target)
