"""Where two systems, or a system and a model, meet: one order by name, or a refusal.

The same cart is written with its states and inputs in two orders. Every route gives for the second
what it gives for the first, bit for bit.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import stochens_rs as se
from declarations import opts
from stochens_rs.exceptions import InputError

A = np.array([[1.0, 0.1, 0.02], [0.0, 0.93, 0.11], [0.05, -0.2, 0.8]])
B = np.array([[0.0, 0.31], [0.12, 0.02], [0.43, -0.2]])
STATES, INPUTS = ("p", "v", "i"), ("F", "U")
AT, ACTS = [2, 0, 1], [1, 0]  # the places in the other order
X0, XF, Q = [1.0, -0.4, 0.3], [0.1, 0.0, 0.2], [1.0, 2.0, 0.5]
LIMITS = ([-0.3, -0.5], [0.4, 0.6])


def system(factor: float, at=(0, 1, 2), acts=(0, 1), states=STATES, inputs=INPUTS) -> se.System:
    at, acts = list(at), list(acts)
    names: dict[str, Any] = {}
    if states is not None:
        names = {"states": [states[i] for i in at], "inputs": [inputs[j] for j in acts]}
    return se.System(factor * A[np.ix_(at, at)], factor * B[np.ix_(at, acts)], dt=0.1, **names)


def runs(factor: float, at=(0, 1, 2), acts=(0, 1), states=STATES, inputs=INPUTS, seed=1):
    """Measured runs of the system, with the same numbers in any order."""
    gen, at, acts = np.random.default_rng(seed), list(at), list(acts)
    x = np.zeros((41, 3))
    u = gen.standard_normal((40, 2))
    for k in range(40):
        x[k + 1] = factor * (A @ x[k] + B @ u[k]) + 0.01 * gen.standard_normal(3)
    names: dict[str, Any] = {}
    if states is not None:
        names = {"state_names": [states[i] for i in at], "input_names": [inputs[j] for j in acts]}
    return se.Trajectories(x[:, at], u[:, acts], dt=0.1, **names)


def model(factor: float, *order: Any, **names: Any):
    return se.identify(runs(factor, *order, **names, seed=2), intercept=True, checks=False)


FIRST = system(1.0)


def plan() -> se.Plan:
    return se.control(FIRST, X0, XF, steps=4, limits=LIMITS, cost=se.Cost(R=0.1))


def fleet(other: se.System) -> se.FleetPlan:
    options: Any = {"limits": LIMITS, "cost": se.Cost(Qf=Q), "risk": "worst"}
    return se.control_fleet([FIRST, other], X0, XF, 3, **options)


def ensemble(other: se.System) -> list[Any]:
    made = se.SystemEnsemble.from_systems([FIRST, other])
    return [made.A, made.B, made.mean().A, made.mean().state_names, made[1].state_names]


def regulated(other: Any) -> list[Any]:
    loop = se.regulate(
        FIRST, 4, XF, limits=se.Limits(u=LIMITS, rate=0.2, previous=0.0), cost=se.Cost(R=0.1)
    )
    loop(X0)
    loop.swap(other)
    again = pickle.loads(pickle.dumps(loop))
    return [loop(X0), loop(X0), again(X0), again(X0)]


def fused(given: list[Any], **options: Any) -> list[Any]:
    options = {"sigma": 0.01, "independent": True} | options
    found = se.fuse(given, "alse", **opts(data=runs(0.95), **options))
    return [found.weights, found.A, found.B, found.state_names, found.region(0.1).radius]


def streamed(given: Any) -> list[Any]:
    stream = se.ModelStream(3, 2, dt=0.1, state_names=STATES, input_names=INPUTS)
    stream.update(given)
    return [stream.model.A, stream.model.B]


def held_out(other: se.System) -> list[Any]:
    found = fleet(system(1.1)).validate([other, system(0.97)], 0.1)
    return [found.misses]


# what takes a system that may have the names in another order
ROUTES: dict[str, Callable[[se.System], Any]] = {
    "Plan.error": lambda b: [plan().error(b, X0, XF).state],
    "Plan.states": lambda b: [plan().states(b, X0)],
    "Plan.error without limits": lambda b: [
        se.control(FIRST, X0, XF, steps=3).error(b, X0, XF).state
    ],
    "control_fleet": lambda b: [fleet(b).u, fleet(b).misses, fleet(b).units.systems.A],
    "FleetPlan.validate": held_out,
    "SystemEnsemble.from_systems": ensemble,
    "Regulator.swap": regulated,
    "fuse": lambda b: fused([FIRST, b, system(0.9)]),
    "fuse an ensemble": lambda b: fused(
        se.SystemEnsemble.from_systems([b, system(0.9)])  # type: ignore[arg-type]
    ),
}
# what takes a model
OF_MODELS: dict[str, Callable[[Any], Any]] = {
    "control_fleet": lambda m: [
        se.control_fleet([model(1.0), m], X0, XF, 3, limits=LIMITS, risk="worst").u
    ],
    "Regulator.swap": regulated,
    "fuse": lambda m: fused([model(1.0), m], sigma=None),
}


def equal(found: list[Any], expected: list[Any]) -> None:
    for mine, its in zip(found, expected, strict=True):
        np.testing.assert_array_equal(mine, its)


# of `fuse`: which region is taken, and how far the models are from the data
FUSED = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")


@FUSED
@pytest.mark.parametrize("route", ROUTES)
def test_systems_are_brought_into_one_order(route: str) -> None:
    call = ROUTES[route]
    expected = call(system(1.05))
    equal(call(system(1.05, AT, ACTS)), expected)
    # without names by place, as it was; the same numbers in another order are another system
    numbers = call(system(1.05, states=None))
    equal(numbers, expected)
    moved = call(system(1.05, AT, ACTS, states=None))
    assert any(not np.array_equal(mine, its) for mine, its in zip(moved, expected, strict=True))
    for names in ({"states": ("p", "v", "j")}, {"inputs": ("F", "W")}):
        with pytest.raises(InputError, match=r"must have the (states|inputs) .* by name, got"):
            call(system(1.05, **names))


@FUSED
@pytest.mark.parametrize("route", OF_MODELS)
def test_models_are_brought_into_one_order(route: str) -> None:
    call = OF_MODELS[route]
    expected = call(model(1.05))
    for mine, its in zip(call(model(1.05, AT, ACTS)), expected, strict=True):
        if isinstance(its, tuple):
            assert mine == its
        else:  # least squares of columns in another order differ by rounding
            np.testing.assert_allclose(mine, its, rtol=1e-6, atol=1e-9)
    with pytest.raises(InputError, match="must have the states"):
        call(model(1.05, states=("p", "v", "j")))


def test_runs_reach_a_stream_in_its_order() -> None:
    equal(streamed(runs(1.0, AT, ACTS)), streamed(runs(1.0)))
    with pytest.raises(InputError, match="must have the states"):
        streamed(runs(1.0, states=("p", "v", "j")))


@pytest.mark.parametrize("noise", [None, [0.01, 0.0, 0.02]])
def test_a_controller_gets_the_states_in_its_order(noise) -> None:
    """The system that is simulated is the one in the other order; the rest follows it."""
    acts = np.argsort(ACTS)

    def run(made_for: se.System) -> se.simulation.Tracking:
        loop = se.regulate(
            made_for, 4, limits=LIMITS if made_for is FIRST else OTHER, cost=se.Cost(R=0.1)
        )
        rest, other = np.zeros((9, 3)), system(1.02, AT, ACTS)
        return se.track(other, rest, controller=loop, x0=np.array(X0)[AT], noise=noise, rng=1)

    OTHER = tuple(np.array(side)[ACTS] for side in LIMITS)
    mine, own = run(FIRST), run(system(1.0, AT, ACTS))
    np.testing.assert_allclose(mine.inputs, own.inputs, atol=1e-7)
    np.testing.assert_allclose(mine.states, own.states, atol=1e-7)
    np.testing.assert_array_equal(mine.info["limits"], OTHER)
    plain = se.regulate(FIRST, 4, limits=LIMITS, cost=se.Cost(R=0.1))(X0)
    np.testing.assert_array_equal(mine.inputs[0][acts], plain)
    with pytest.raises(InputError, match="`system` must have the states"):
        se.track(
            system(1.0, states=("p", "v", "j")),
            np.zeros((3, 3)),
            controller=se.regulate(FIRST, 4, limits=LIMITS),
        )


def test_a_law_is_declared_in_the_order_of_the_plan() -> None:
    draws = se.Ensemble.from_samples(A + 0.1 * np.random.default_rng(1).standard_normal((20, 3, 3)))
    made = se.control((draws, FIRST), X0, XF)
    for other in (FIRST, system(1.0, AT, ACTS)):
        with pytest.raises(InputError) as found:
            made.bound(0.1, system=other)
        assert "`system.B` differs" not in str(found.value)
    with pytest.raises(InputError, match=r"`system\.B` differs"):
        made.bound(0.1, system=system(1.0, AT, ACTS, states=None))


def test_the_names_of_an_ensemble_stay_with_it(tmp_path) -> None:
    made = se.SystemEnsemble.from_systems([FIRST, system(1.1, AT, ACTS)])
    assert made.labels == FIRST.labels
    assert made[:1].labels == FIRST.labels
    made.save(tmp_path / "units")
    again = se.SystemEnsemble.load(tmp_path / "units")
    assert (again.labels, again == made) == (made.labels, True)
    assert model(1.0).draw(20, rng=1).mean().state_names == STATES
    with pytest.raises(se.exceptions.ShapeError, match="`labels`"):
        se.SystemEnsemble(A[None, :2, :2], B[None, :2], labels=FIRST.labels)


def test_weights_are_tables_in_any_order(tmp_path):
    pandas = pytest.importorskip("pandas")
    A, names = np.array([[0.9, 0.2, 0.0], [-0.1, 0.8, 0.1], [0.0, 0.1, 0.7]]), ["a", "b", "c"]
    B, full = np.array([[1.0, 0.0], [0.5, 1.0], [0.2, 0.1]]), np.diag([3.0, 2.0, 1.0])
    full[0, 1] = full[1, 0] = 0.5
    system = se.System(A, B, states=names, inputs=["F", "G"])
    units = se.SystemEnsemble.from_systems([system, se.System(1.1 * A, B)])
    table = pandas.DataFrame(full, names, names)
    x0, xf, other = [1.0, -1.0, 2.0], np.zeros(3), ["b", "c", "a"]
    R = pandas.Series({"G": 0.2, "F": 0.1})
    for given, plain in (
        (pandas.Series({"c": 1.0, "a": 3.0, "b": 2.0}), [3.0, 2.0, 1.0]),
        (table, full),
        (table.loc[other], full),
        (table.loc[other, ["c", "b", "a"]], full),
        (table.rename_axis(index="i", columns="j").loc[other].stack().to_xarray(), full),
    ):
        cost, same = se.Cost(Q=given, Qf=given, R=R), se.Cost(Q=plain, Qf=plain, R=[0.1, 0.2])
        cost.save(tmp_path / "cost")
        expected = se.control(system, x0, xf, steps=3, cost=same).u
        for one in (cost, se.Cost.load(tmp_path / "cost")):
            found = se.control(system, x0, xf, steps=3, cost=one)
            np.testing.assert_array_equal(found.u, expected)
        fleets = [se.control_fleet(units, x0, xf, 3, cost=one).u for one in (cost, same)]
        np.testing.assert_array_equal(*fleets)
        gains = se.gain(system, given, R).K, se.gain(system, plain, [0.1, 0.2]).K
        np.testing.assert_array_equal(*gains)
    for wrong in (table.rename(index={"a": "z"}), table.iloc[:2]):
        with pytest.raises(InputError, match="`Q` must have the labels"):
            se.Cost(Q=wrong)
    foreign = se.Cost(Q=pandas.Series([1.0] * 3, list("abz")))
    for where in (system, (A, B)):
        with pytest.raises(InputError, match=r"`Q` .*labels"):
            se.control(where, x0, xf, cost=foreign)


def test_an_ensemble_is_simulated_with_its_names():
    pandas = pytest.importorskip("pandas")
    units = se.SystemEnsemble.from_systems(
        [se.System([[a, 0.2], [-0.1, 0.8]], np.eye(2), states=["p", "v"]) for a in (0.9, 0.8)]
    )
    x0 = pandas.Series({"v": 2.0, "p": 1.0})
    found = se.simulate_ensemble(units, x0, np.ones((3, 2)))
    np.testing.assert_array_equal(found.mean[0], [1.0, 2.0])
    each = se.simulate_ensemble(units, pandas.DataFrame([x0, 2.0 * x0], [0, 1]), np.ones((3, 2)))
    np.testing.assert_array_equal(each.mean[0], [1.5, 3.0])
    assert found.labels == units.labels
    assert found.to_xarray()["mean"].sel(state="v")[0] == 2.0
    u = pandas.DataFrame(np.ones((3, 2)), columns=["u[1]", "u[0]"])
    np.testing.assert_array_equal(se.simulate_ensemble(units, x0, u).mean, found.mean)
    with pytest.raises(InputError, match="`x0` must have the labels"):
        se.simulate_ensemble(units, x0.rename({"v": "w"}), np.ones((3, 2)))


def heater(P: str | None = "W", T: str | None = "K", effect: float = 8e-4) -> se.System:
    units = {name: unit for name, unit in (("T", T), ("P", P)) if unit is not None}
    return se.System([[0.9]], [[effect]], dt=300.0, states=["T"], inputs=["P"], units=units)


KW = heater("kW", effect=0.8)  # the same heater


def heaters(*others: se.System) -> list[se.System]:
    return [heater(effect=8e-4 + 1e-6 * k) for k in range(30)] + list(others)


@pytest.mark.parametrize(
    ("meet", "named"),
    [
        (lambda one: se.SystemEnsemble.from_systems(heaters(one)), r"systems\[30\]"),
        # the first ones say no unit: those that follow do
        (lambda one: se.SystemEnsemble.from_systems([heater(None, None), *heaters(one)]), "31"),
        (
            lambda one: se.control_fleet(heaters(one), [0.0], [20.0], 12, limits=(0.0, 3e3)),
            r"units\[30\]|systems\[30\]",
        ),
        (lambda one: se.control(heater(), [0.0], [20.0], steps=5).error(one, [0.0], [20.0]), ""),
        (lambda one: se.control(heater(), [0.0], [20.0], steps=5).states(one, [0.0]), ""),
        (lambda one: se.control(heater(), [0.0], [20.0], steps=5).validate([one] * 60), ""),
        (lambda one: se.regulate(heater(), 5, limits=(0.0, 3e3)).swap(one), "system"),
        (
            lambda one: se.track(
                one, np.zeros((5, 1)), controller=se.gain(heater(), 1.0, 1.0), x0=[1.0]
            ),
            "system",
        ),
    ],
)
def test_units_that_contradict_each_other_are_refused(meet: Callable[[Any], Any], named: str):
    """A plan in W on a system in kW missed by 19 918 K without a word."""
    with pytest.raises(InputError, match=f"{named}.* must have 'P' in 'W', got 'kW'"):
        meet(KW)
    with pytest.raises(InputError, match="must have 'T' in 'K', got 'degC'"):
        meet(heater(T="degC"))
    meet(heater())
    meet(heater(None))  # of this one no unit is known


def test_an_ensemble_has_the_units_of_all_its_systems():
    found = se.SystemEnsemble.from_systems([heater(None), heater(T=None)])
    assert dict(found.labels.units) == {"T": "K", "P": "W"}
    plain = se.System([[0.9]], [[8e-4]], dt=300.0, units={"x[0]": "m"})  # another name, or none
    assert se.SystemEnsemble.from_systems([heater(), plain]).labels == heater().labels
