"""Systems of other packages in and out, checked against the packages themselves."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import System
from stochens_rs._base.names import Labels
from stochens_rs.exceptions import InputError

control = pytest.importorskip("control")
signal = pytest.importorskip("scipy.signal")
pd = pytest.importorskip("pandas")
xr = pytest.importorskip("xarray")

A = np.array([[0.0, 1.0, 0.0], [-2.0, -0.3, 0.5], [0.0, 0.4, -1.0]])
B = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
C, D = np.eye(3), np.zeros((3, 2))
STATES, INPUTS = ["p", "v", "T"], ["F", "P"]
UNITS = {"p": "m", "v": "m/s", "P": "W"}
PLANT = System(A, B, dt=0.1, name="rig", states=STATES, inputs=INPUTS, units=UNITS)
ORDERS = (["p", "v", "T"], ["T", "v", "p"], ["v", "T", "p"])


# -- into the package --------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(20))
def test_zero_order_hold_is_that_of_scipy_and_control(seed):
    gen = np.random.default_rng(seed)
    n, m = gen.integers(1, 7, 2)
    A, B = gen.standard_normal((n, n)) * 10 ** gen.uniform(-2, 1), gen.standard_normal((n, m))
    dt = float(10 ** gen.uniform(-3, 0))
    mine = System.from_any(signal.lti(A, B, np.eye(n), np.zeros((n, m))), dt=dt)
    theirs = signal.cont2discrete((A, B, np.eye(n), np.zeros((n, m))), dt, method="zoh")
    np.testing.assert_allclose(mine.A, theirs[0], rtol=1e-9, atol=1e-12 * abs(theirs[0]).max())
    np.testing.assert_allclose(mine.B, theirs[1], rtol=1e-9, atol=1e-12 * abs(theirs[1]).max())
    other = System.from_any(control.ss(A, B, np.eye(n), 0), dt=dt)
    np.testing.assert_array_equal(other.A, mine.A)
    assert System.from_any((A, B, 0), dt=dt) == System.from_any((A, B, 0.0), dt=dt) == mine
    assert mine.dt == dt
    assert mine.name == "zero-order hold"


def test_names_of_python_control_are_kept():
    given = control.ss(A, B, C, D, 0.1, states=STATES, inputs=INPUTS, name="rig")
    found = System.from_any(given)
    assert (found.state_names, found.input_names) == (tuple(STATES), tuple(INPUTS))
    assert (found.name, found.dt) == ("rig", 0.1)
    sampled = System.from_any(control.ss(A, B, C, D, 0, states=STATES, inputs=INPUTS), dt=0.1)
    assert sampled.labels == Labels(tuple(STATES), tuple(INPUTS))
    assert sampled.name == "zero-order hold"
    assert System.from_any(control.ss(A, B, C, D, 0, name="rig"), dt=0.1).name == (
        "rig, zero-order hold"
    )
    assert not System.from_any(control.ss(A, B, C, D, 0.1)).labels.given


RESPONSE = (np.array([1.0, 2.0]), np.array([1.0, 3.0, 5.0]))
TRANSFERS = {
    "control": (control.tf(*RESPONSE), control.ss(control.tf(*RESPONSE)), "control"),
    "scipy": (signal.TransferFunction(*RESPONSE), signal.lti(*RESPONSE).to_ss(), "scipy.signal"),
    "scipy, poles": (
        signal.ZerosPolesGain([-2.0], [-1.0, -2.5], 3.0),
        signal.ZerosPolesGain([-2.0], [-1.0, -2.5], 3.0).to_ss(), "scipy.signal",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", TRANSFERS)
def test_transfer_functions_are_realized_and_say_how(what):
    given, realized, package = TRANSFERS[what]
    found = System.from_any(given, dt=0.05)
    assert found.name == f"realized by {package} to_ss, zero-order hold"
    assert found == System.from_any(realized, dt=0.05)
    # the outputs of the discrete system under steps are those of the continuous one
    y = se.simulate(found, np.zeros(found.n), np.ones((200, 1))).states @ realized.C.T
    times = 0.05 * np.arange(201)
    wanted = signal.step(signal.StateSpace(realized.A, realized.B, realized.C, realized.D), T=times)
    np.testing.assert_allclose(y[:, 0], wanted[1], atol=1e-8)
    with pytest.raises(InputError, match=r"continuous time: discretize it, e\.g\. with System"):
        System.from_any(given)


# In python-control's issue 935, with poles from -600 to -6e-5 rad/s.
SPREAD = -np.array(
    [6e2, 6.28, 3, 3, 0.2, 0.12, 0.12, 0.07, 0.06, 0.1, 4.3e-3, 6e-4, 6e-4, 6e-5, 6.2e-5, 6.4e-5]
)


@pytest.mark.parametrize("package", ["control", "scipy"])
def test_a_realization_with_other_poles_is_named(package):
    zeros, poles = 1.1 * SPREAD[:10], SPREAD
    given = signal.ZerosPolesGain(zeros, poles, 1.0)
    if package == "control":
        given = control.tf(np.poly(zeros), np.poly(poles))
    with pytest.warns(
        se.exceptions.DataWarning, match=r"1\.00\d+ as largest modulus for 0\.9994; "
    ):
        System.from_any(given, dt=10.0)


def test_discrete_transfer_functions():
    for given in (control.tf([1.0], [1.0, -0.5], 0.1), signal.dlti([1.0], [1.0, -0.5], dt=0.1)):
        found = System.from_any(given)
        assert (found.dt, found.A[0, 0]) == (0.1, 0.5)
        assert found.name is not None
        assert found.name.endswith("to_ss")
    named = System.from_any(control.tf([1.0], [1.0, -0.5], 0.1, name="G", inputs="F"))
    assert (named.name, named.input_names) == ("G, realized by control to_ss", ("F",))


def test_the_own_dt_may_be_given():
    assert System.from_any(control.ss(A, B, C, D, 0.1), dt=0.1).dt == 0.1
    assert System.from_any(PLANT, dt=0.1) is PLANT


# -- tables ------------------------------------------------------------------------------------


def frames(rows, columns):
    of_A, of_B = PLANT.to_pandas()
    return of_A.loc[rows, columns], of_B.loc[columns, INPUTS[::-1]]


@pytest.mark.parametrize("rows", ORDERS)
@pytest.mark.parametrize("columns", ORDERS)
def test_tables_are_aligned(rows, columns):
    of_A, of_B = frames(rows, columns)
    found = System(of_A, of_B, dt=0.1)
    assert (found.state_names, found.input_names) == (tuple(rows), ("P", "F"))
    order = [STATES.index(name) for name in rows]
    np.testing.assert_array_equal(found.A, A[np.ix_(order, order)])
    np.testing.assert_array_equal(found.B, B[order][:, ::-1])
    same = System(of_A, of_B, dt=0.1, states=STATES, inputs=INPUTS)
    assert same == PLANT
    assert System.from_any((of_A, of_B, 0.1)) == found
    assert System.from_any((of_A, of_B, 0), dt=0.1) == System.from_any(
        (found.A, found.B, 0), dt=0.1
    )
    assert System.from_any((of_A, of_B, 0), dt=0.1).state_names == tuple(rows)


of_A, of_B = PLANT.to_pandas()


def test_data_sets_are_aligned_by_dimension_and_label():
    data = PLANT.to_xarray().sel(state=ORDERS[1], state_next=ORDERS[2], input=["P", "F"])
    found = System.from_any(data.transpose("input", "state", "state_next"))
    assert found.state_names == tuple(ORDERS[2])
    back = System(data.A, data.B.T, dt=0.1, states=STATES, inputs=INPUTS)
    assert back == PLANT
    with pytest.raises(InputError, match="has labels"):
        System(data.A.rename(state="from"), data.B)


X0 = pd.Series([1.0, 2.0, 3.0], index=STATES)
XF = xr.DataArray([0.0, 0.1, 0.2], coords={"state": STATES})
U = pd.DataFrame([[1.0, 0.0], [0.0, 2.0]], columns=INPUTS, index=[0.0, 0.1])
REFERENCE = pd.DataFrame(np.arange(12.0).reshape(4, 3) / 9, columns=STATES)
LIMITS = pd.Series([-1.0, -2.0], index=INPUTS), pd.Series([1.0, 2.0], index=INPUTS)


def model():
    gen = np.random.default_rng(1)
    x, u = gen.standard_normal((80, 3)), gen.standard_normal((80, 2))
    after = x @ (0.3 * A.T) + u @ B.T + 0.01 * gen.standard_normal((80, 3))
    data = se.Trajectories.from_pairs(x, u, after, state_names=STATES, input_names=INPUTS)
    return se.identify(data)


def ran(stream):
    stream.step(5)
    return stream.u


MODEL = model()
USES = {
    "control": lambda x, y, u, r, low: se.control(PLANT, x, y).u,
    "control over steps": lambda x, y, u, r, low: se.control(PLANT, x, y, steps=4).u,
    "control with limits": lambda x, y, u, r, low: (
        se.control(PLANT, x, y, steps=4, limits=se.Limits(u=low, rate=low[1], previous=low[1])).u
    ),
    "reference": lambda x, y, u, r, low: (
        se.control(PLANT, x, steps=3, cost=se.Cost(reference=r, Q=1.0)).u
    ),
    "state limits": lambda x, y, u, r, low: (
        se.control(PLANT, x, y, steps=4, limits=se.Limits(x=(None, x + 1.0))).u
    ),
    "a model": lambda x, y, u, r, low: se.control(MODEL, x, y, steps=2, limits=low).u,
    "predict": lambda x, y, u, r, low: se.predict(MODEL, x, u).predicted_states,
    "steer": lambda x, y, u, r, low: se.steer(PLANT, x, y, 20, rng=1).u,
    "simulate": lambda x, y, u, r, low: se.simulate(PLANT, x, u).states,
    "simulate_ensemble": lambda x, y, u, r, low: se.simulate_ensemble(PLANT, x, u, 5, rng=1).mean,
    "track": lambda x, y, u, r, low: se.track(PLANT, r, 5, x0=x, rng=1).states,
    "regulate": lambda x, y, u, r, low: (
        se.regulate(PLANT, 3, y, limits=low, cost=se.Cost(Q=1.0))(x)
    ),
    "states": lambda x, y, u, r, low: se.control(PLANT, X0, XF, steps=2).states(PLANT, x),
    "error": lambda x, y, u, r, low: se.control(PLANT, X0, XF).error(PLANT, x, y).state,
    "error within limits": lambda x, y, u, r, low: (
        se.control(PLANT, X0, XF, limits=(-1, 1)).error(PLANT, x, y).state
    ),
    "realizations": lambda x, y, u, r, low: (
        se.realization_controls(PLANT, x, y, limits=low, cost=se.Cost(Q=np.eye(3)))
    ),
    "required_samples": lambda x, y, u, r, low: (
        se.required_samples(PLANT, x, y, 0.5, rng=1).size
    ),
    "Stream": lambda x, y, u, r, low: ran(se.Stream(PLANT, x, y, rng=1)),
    "theory": lambda x, y, u, r, low: (
        se.theory.moments.trajectory_covariance(PLANT, x, u)
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", USES)
def test_named_vectors_are_aligned(what):
    use = USES[what]
    plain = [X0.to_numpy(), XF.to_numpy(), U.to_numpy(), REFERENCE.to_numpy()]
    expected = use(*plain, tuple(side.to_numpy() for side in LIMITS))
    named = (X0, XF, U, REFERENCE, LIMITS)
    shuffled = (
        X0[["T", "p", "v"]], XF.sel(state=["v", "T", "p"]), U[["P", "F"]],
        REFERENCE[["v", "p", "T"]], tuple(side[["P", "F"]] for side in LIMITS),
    )  # fmt: skip
    for given in (named, shuffled):
        np.testing.assert_array_equal(use(*given), expected)


def test_a_system_without_names_takes_no_other_order():
    plain = System(A, B, dt=0.1)
    with pytest.raises(InputError, match=r"`x0` must have the labels .*\.to_numpy\(\) if"):
        se.control(plain, X0, np.zeros(3))
    numbered = pd.Series([3.0, 1.0, 2.0], index=["x[2]", "x[0]", "x[1]"])
    np.testing.assert_array_equal(
        se.control(plain, numbered, np.zeros(3)).u,
        se.control(plain, [1.0, 2.0, 3.0], np.zeros(3)).u,
    )


def test_rows_in_time_must_be_in_order():
    late = U.set_axis([0.1, 0.0])
    for bad in (late, U.set_axis(["a", "b"]), U.set_axis([0.0, 0.0])):
        with pytest.raises(InputError, match="has labels"):
            se.simulate(PLANT, X0, bad)
    dated = U.set_axis(pd.date_range("2020", periods=2))
    np.testing.assert_array_equal(
        se.simulate(PLANT, X0, dated).states, se.simulate(PLANT, X0, U.to_numpy()).states
    )


# -- out of the package ------------------------------------------------------------------------


def test_round_trip_through_python_control():
    made = PLANT.to_control()
    assert isinstance(made, control.StateSpace)
    assert (made.dt, made.name) == (0.1, "rig")
    assert (made.state_labels, made.input_labels) == (STATES, INPUTS)
    assert made.output_labels == STATES
    back = System.from_any(made)
    assert back == PLANT
    assert (back.name, back.state_names) == ("rig", PLANT.state_names)
    u = np.ones((30, 2))
    theirs = control.forced_response(made, inputs=u.T, initial_state=[1.0, 0.0, 2.0])
    mine = se.simulate(PLANT, [1.0, 0.0, 2.0], u).states
    np.testing.assert_allclose(theirs.states.T, mine[:-1], rtol=1e-12)
    for system in (System(A, B), System(A, B, dt=True, name="1.5 kW")):
        again = System.from_any(system.to_control())
        assert again.dt is True
        assert not again.labels.given
    assert System(A, B, name="1.5 kW").to_control().name == "1_5 kW"


def test_round_trip_through_pandas_and_xarray(tmp_path):
    of_A, of_B = PLANT.to_pandas()
    again = System(of_A, of_B, dt=PLANT.dt, units=PLANT.units)
    assert again == PLANT
    assert again.labels == PLANT.labels
    of_A.iloc[:] = 0.0
    assert PLANT.A.any()
    data = PLANT.to_xarray()
    assert data.A.sel(state_next="v", state="p") == A[1, 0]
    assert data.attrs["dt"] == 0.1
    data.to_netcdf(tmp_path / "rig.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "rig.nc", engine="h5netcdf") as read:
        for found in (System.from_any(data), System.from_any(read)):
            assert found == PLANT
            assert (found.labels, found.name) == (PLANT.labels, "rig")
    plain = System.from_any(System(A, B).to_xarray())
    assert plain == System(A, B)
    assert not plain.labels.given
