"""Data sets and tables of records: dimensions, names, units, keys, and what goes back in."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputError, ShapeError
from test_records import PARTS, PLANS, SYSTEM, X0, A, B, key

pandas = pytest.importorskip("pandas")
xarray = pytest.importorskip("xarray")
ALL = PLANS | PARTS
CUBES = [name for name, make in ALL.items() if hasattr(make(), "to_xarray")]
ONE_EACH = {type(ALL[name]()): name for name in CUBES}.values()


def test_which_records_have_axes() -> None:
    kinds = {type(ALL[name]()).__name__ for name in CUBES}
    timed = {"Plan", "Trajectory", "EnsembleTrajectory"}
    assert kinds == timed | {"SystemEnsemble", "FleetPlan", "Tracking"}
    assert {type(ALL[name]()).__name__ for name in CUBES if hasattr(ALL[name](), "to_pandas")} == (
        timed | {"FleetPlan"}
    )


def test_the_command_of_a_fleet_is_a_table_of_its_inputs() -> None:
    B = np.array([[[1.0]], [[1.2]]])
    units = [se.System(0.5 * b, b, dt=0.1, inputs=["force"]) for b in B]
    plan = se.control_fleet(units, [0.0], [1.0], 3, limits=(-1.0, 1.0))
    table = plan.to_pandas()
    assert list(table.columns) == ["force"]
    assert table.index.name == "time"
    np.testing.assert_array_equal(table["force"][:-1], plan.u[:, 0])
    np.testing.assert_allclose(table.index, 0.1 * np.arange(4))
    assert np.isnan(table["force"].iloc[-1])
    assert table.attrs["status"] == plan.status


@pytest.mark.parametrize("name", ONE_EACH)
def test_every_data_set_can_be_written(name: str, tmp_path: Path) -> None:
    pytest.importorskip("h5netcdf")
    made = ALL[name]().to_xarray()
    assert {"stochens_rs", "python", "numpy", "platform"} <= set(made.attrs)
    made.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as back:
        assert made.equals(back.load())
        assert {k: str(v) for k, v in back.attrs.items()} == {
            k: str(v) for k, v in made.attrs.items()
        }


def test_a_trajectory_has_names_units_and_times() -> None:
    path = se.simulate(SYSTEM, X0, [[1.0], [0.0], [2.0]])
    made = path.to_xarray()
    assert made["states"].dims == ("time", "state")
    assert made["inputs"].dims == ("time", "input")
    assert made["time"].attrs == {"units": "s"}
    assert made["inputs"].attrs == {"units": "N"}
    assert made["states"].attrs == {}  # of two units
    assert made["state_unit"].to_numpy().tolist() == ["", "m/s"]
    np.testing.assert_array_equal(made["states"].sel(state="v"), path.states[:, 1])
    np.testing.assert_array_equal(made["inputs"][:-1], path.inputs)
    assert np.isnan(made["inputs"][-1]).all()
    np.testing.assert_array_equal(made["time"], path.times)
    bare = se.simulate((A, B), X0, [[1.0]]).to_xarray()
    assert bare["states"].dims == ("step", "state")
    assert bare["state"].to_numpy().tolist() == ["x[0]", "x[1]"]
    assert "state_unit" not in bare.coords
    assert bare["step"].to_numpy().tolist() == [0, 1]


def test_all_states_of_one_unit_give_it_to_the_variable() -> None:
    system = se.System(A, B, states=["a", "b"], units={"a": "K", "b": "K"})
    assert se.simulate(system, X0, [[1.0]]).to_xarray()["states"].attrs == {"units": "K"}


def test_the_table_of_a_trajectory_goes_back_into_identification() -> None:
    path = se.simulate(SYSTEM, X0, np.random.default_rng(1).standard_normal((30, 1)))
    table = path.to_pandas()
    assert list(table.columns) == ["Größe", "v", "F"]
    assert table.index.name == "time"
    assert table.attrs["units"] == {"v": "m/s", "F": "N"}
    runs = se.Trajectories.from_table(
        table.reset_index(), states=["Größe", "v"], inputs=["F"], time="time"
    )
    (states, inputs) = runs.runs[0]
    np.testing.assert_array_equal(states, path.states)
    np.testing.assert_array_equal(inputs, path.inputs)
    assert runs.dt == pytest.approx(0.1)


def test_the_moments_of_an_ensemble() -> None:
    path = PARTS["runs"]()
    made = path.to_xarray()
    assert made["runs"].dims == ("run", "step", "state")
    assert made["covariance"].dims == ("step", "state", "other_state")
    np.testing.assert_array_equal(made["covariance"], path.covariance)
    np.testing.assert_array_equal(made["runs"].mean("run"), path.runs.mean(axis=0))
    assert made.attrs["key"] == path.key.hex
    assert made.attrs["sampled"] == "A, B, x0"
    table = path.to_pandas()
    assert list(table.columns) == ["x[0]", "x[1]", "u[0]", "variance[x[0]]", "variance[x[1]]"]
    np.testing.assert_array_equal(table["variance[x[1]]"], path.variance[:, 1])
    assert "key" not in PARTS["models"]().to_xarray().attrs


def test_a_plan_has_its_control_limits_and_keys() -> None:
    plan = PLANS["limits"]()
    made = plan.to_xarray()
    np.testing.assert_array_equal(made["u"][:-1], plan.u)
    np.testing.assert_array_equal(made["predicted_states"], plan.predicted_states)
    np.testing.assert_array_equal(made["active"][:-1], plan.limited.active)
    assert made["high"][:-1].to_numpy().tolist() == [[2.0]] * 4
    assert made.attrs["key_A"] == key("A").hex
    assert made.attrs["size_x0"] == 50
    table = plan.to_pandas()
    assert list(table.columns)[:5] == ["x[0]", "x[1]", "u[0]", "low[u[0]]", "high[u[0]]"]
    named = PLANS["steer"]()
    assert list(named.to_pandas().columns) == ["Größe", "v", "F"]
    assert named.to_xarray().attrs["key"] == named.info["key"].hex
    of_model = PLANS["plan of a model"]().to_xarray()
    assert of_model["time"].to_numpy().tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_runs_are_an_axis_where_there_are_some() -> None:
    reference = [[1.0, 1.0], [1.1, 1.0]]
    one, several = (se.track(SYSTEM, reference, 10, rng=1, runs=R) for R in (None, 3))
    assert one.to_xarray()["errors"].dims == one.to_xarray()["residuals"].dims
    data = several.to_xarray()
    assert data["states"].dims[0] == "run"
    np.testing.assert_array_equal(data["inputs"][:, :-1], several.inputs)
    assert np.isnan(data["residuals"][0])
    with pytest.raises(ShapeError, match="`inputs` must have shape"):
        replace(several, inputs=one.inputs)


def test_two_columns_of_one_name_are_refused() -> None:
    system = se.System(A, B, states=["v", "variance[v]"])
    path = se.simulate_ensemble(system, X0, [[1.0]], 9, rng=1)
    with pytest.raises(InputError, match="two columns would be"):
        path.to_pandas()
    assert path.to_xarray()["variance"].shape == (2, 2)


@pytest.mark.parametrize(("call", "package"), [("to_xarray", "xarray"), ("to_pandas", "pandas")])
def test_a_missing_package_is_named(call: str, package: str, monkeypatch: Any) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"need {package}: .*stochens_rs\[tables\]"):
        getattr(PARTS["trajectory"](), call)()
