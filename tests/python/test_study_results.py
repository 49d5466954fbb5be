"""Results of studies: summaries, tables, data sets, files, figures."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputError, InputTypeError
from study_functions import GRID, fused, noise, sometimes

xarray = pytest.importorskip("xarray")
RESULTS = se.Study(fused, GRID, replicates=25, rng=2, shared=["method"]).run()
FAILING = se.Study(sometimes, {"scale": [1.0, 2.0]}, replicates=40, rng=8).run()


def test_text_and_html_are_a_table_of_medians() -> None:
    head, names, *rows = str(RESULTS).splitlines()
    assert head == repr(RESULTS)
    assert names.split()[:4] == ["size", "method", "done", "failed"]
    assert len(rows) == 6
    median = np.median(RESULTS.values["error"][1, 0])  # size 10, uniform
    assert rows[2].split()[:5] == ["10", "uniform", "25", "0", f"{median:.4g}"]
    shown = RESULTS._repr_html_()
    assert RESULTS.about["key"] in shown
    assert f"{median:.4g}" in shown
    done = FAILING.values["x"][0][FAILING.done[0]]
    assert f"{np.median(done):.4g}" in str(FAILING).splitlines()[2]
    assert repr(FAILING).endswith(f"80 of 80 ran, {len(FAILING.failures)} failed>")


def test_results_of_nothing() -> None:
    made = se.Study(noise, {"scale": [1.0]}, replicates=3, rng=1)
    assert made.results.values == {}
    assert list(made.results.columns()) == ["scale", "replicate"]
    assert str(made.results).splitlines()[2].split() == ["1", "0", "0"]
    part = se.Study(noise, {"scale": [1.0, 2.0]}, replicates=3, rng=1).run(time_limit=1e-9)
    assert part.status == "time_limit"


def test_columns_are_tidy() -> None:
    table = RESULTS.columns()
    entries = [f"estimate[{i},{j}]" for i in (0, 1) for j in (0, 1)]
    assert list(table) == ["size", "method", "replicate", "error", *entries]
    assert {len(one) for one in table.values()} == {150}
    at = (table["size"] == 30) & (table["method"] == "alse") & (table["replicate"] == 7)
    assert table["error"][at] == [RESULTS.values["error"][2, 1, 7]]
    assert table["estimate[1,0]"][at] == [RESULTS.values["estimate"][2, 1, 7, 1, 0]]
    assert table["size"].dtype.kind == "i"
    assert len(FAILING.columns()["x"]) == 80


def test_data_sets_have_named_dimensions_and_units() -> None:
    data = RESULTS.to_xarray()
    assert data["estimate"].dims == ("size", "method", "replicate", "estimate_0", "estimate_1")
    found = data["error"].sel({"size": 10, "method": "alse", "replicate": 3}).item()
    assert found == RESULTS.values["error"][1, 1, 3]
    assert data.attrs["key"] == RESULTS.about["key"]

    def fall(key: se.Key, time: float) -> dict[str, object]:
        return {"height": [5.0 * time**2, 1.0], "count": 3}

    fall.units = {"height": "m", "time": "s", "count": "1"}  # type: ignore[attr-defined]
    results = se.Study(fall, {"time": [1.0, 2.0]}, replicates=3, rng=1).run()
    assert results.units == results.to_dict()["units"] == fall.units  # type: ignore[attr-defined]
    attrs = {name: results.to_xarray()[name].attrs for name in results.units}
    assert attrs == {name: {"units": unit} for name, unit in results.units.items()}
    fall.units = "m"  # type: ignore[attr-defined]
    with pytest.raises(InputTypeError, match=r"`function.units` must be a mapping of names"):
        se.Study(fall, {}, replicates=1)


def test_files_have_all_numbers(tmp_path: Path) -> None:
    pytest.importorskip("h5netcdf")
    for suffix in ("csv", "nc", "json"):
        RESULTS.save(tmp_path / f"a.{suffix}")
    head, *rows = csv.reader((tmp_path / "a.csv").read_text().splitlines())
    for name, column in zip(head, zip(*rows, strict=True), strict=True):
        own = RESULTS.columns()[name]
        assert np.array_equal(np.array(column, dtype=own.dtype), own)
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as data:
        assert data.identical(RESULTS.to_xarray())
    written = json.loads((tmp_path / "a.json").read_text())
    assert np.array_equal(written["values"]["estimate"], RESULTS.values["estimate"])
    assert written == json.loads(json.dumps(RESULTS.to_dict()))
    assert {one.name for one in tmp_path.iterdir()} == {"a.csv", "a.nc", "a.json"}
    with pytest.raises(InputError, match=r"must be one of '.csv', '.nc', '.json', got str '.xls"):
        RESULTS.save(tmp_path / "a.xls")
