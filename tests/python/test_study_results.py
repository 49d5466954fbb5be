"""Results of studies: summaries, tables, data sets, files, figures."""

from __future__ import annotations

import dataclasses
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputError
from study_functions import GRID, fused, noise, sometimes

pandas = pytest.importorskip("pandas")
xarray = pytest.importorskip("xarray")
RESULTS = se.Study(fused, GRID, replicates=25, rng=2, shared=["method"]).run()
FAILING = se.Study(sometimes, {"scale": [1.0, 2.0]}, replicates=40, rng=8).run()


def test_the_summary_is_that_of_the_numbers() -> None:
    columns = RESULTS.summary().columns
    assert len(columns["mean"]) == 6 * 5  # an error and four entries of an estimate
    rows = RESULTS.values["error"][1, 0]  # size 10, uniform
    at = 2
    assert [columns[k][at] for k in ("size", "method", "name")] == [10, "uniform", "error"]
    assert columns["mean"][at] == pytest.approx(rows.mean())
    assert columns["standard_error"][at] == pytest.approx(rows.std(ddof=1) / math.sqrt(25))
    assert columns["median"][at] == np.median(rows)
    assert columns["q10"][at] == np.quantile(rows, 0.1)
    text = str(RESULTS.summary()).splitlines()
    assert text[0].split()[:3] == ["size", "method", "name"]
    assert len(text) == 31


def test_infinite_numbers_are_counted() -> None:
    def bound(key):
        return {"x": math.inf if key.generator().random() < 0.2 else 1.0}

    found = se.Study(bound, {}, replicates=50, rng=1).run()
    columns = found.summary().columns
    infinite = int(np.isinf(found.values["x"]).sum())
    assert 0 < infinite < 50
    assert columns["infinite"] == [infinite]
    assert columns["mean"] == columns["standard_error"] == [math.inf]
    assert columns["median"] == [1.0]


def test_failures_are_left_out_and_counted() -> None:
    table = FAILING.summary().to_pandas()
    assert table["failed"].sum() == len(FAILING.failures)
    assert (table["done"] + table["failed"] == 40).all()
    own = FAILING.values["x"][0][FAILING.done[0]]
    assert table["mean"][0] == pytest.approx(own.mean())
    assert repr(FAILING).endswith(f"80 of 80 ran, {len(FAILING.failures)} failed>")
    assert FAILING.select(scale=2.0).failures == [
        one for one in FAILING.failures if one.configuration["scale"] == 2.0
    ]


def test_a_summary_of_nothing() -> None:
    made = se.Study(noise, {"scale": [1.0]}, replicates=3, rng=1)
    assert made.results.summary().columns["mean"] == []
    assert made.results.values == {}
    assert len(made.results.to_pandas()) == 0
    part = se.Study(noise, {"scale": [1.0, 2.0]}, replicates=3, rng=1).run(time_limit=1e-9)
    assert part.status == "time_limit"
    infinite = se.Study(lambda key: {"x": math.inf}, {}, replicates=3, rng=1).run()
    assert infinite.summary().columns["mean"] == [math.inf]


def test_no_axis_has_a_name_that_results_use() -> None:
    """It would be overwritten, or overwrite something."""
    names = {*RESULTS.summary().columns, *RESULTS.about, *RESULTS.to_dict(), "replicate", "self"}
    names |= {field.name for field in dataclasses.fields(se.studies.Results)}
    for name in sorted(names - set(GRID) - {"about"}):
        with pytest.raises(InputError, match=f"`grid` must not have an axis '{name}'"):
            se.Study(noise, {name: [1.0]}, replicates=3, rng=1)


def test_the_figure_of_a_part_says_how_many_replicates_it_shows() -> None:
    pytest.importorskip("matplotlib")
    calls: list[float] = []

    def ends(key: se.Key, scale: float) -> dict[str, float]:
        calls.append(scale)
        if len(calls) > 8:
            raise KeyboardInterrupt
        return noise(key, scale)

    part = se.Study(ends, {"scale": [1.0, 2.0, 3.0]}, replicates=400, rng=1).run()
    assert part.status == "interrupted"

    def said(results: se.studies.Results) -> list[str]:
        ax = results.plot("scale", "x")
        legend = ax.get_legend() or ax.figure.legends[0]
        return [one.get_text() for one in legend.get_texts()]

    assert said(part) == ["10-90 % of 2 to 3 of 400 replicates"]
    whole = se.Study(noise, {"scale": [1.0, 2.0, 3.0]}, replicates=9, rng=1).run()
    assert said(whole) == ["10-90 % of 9 replicates"]
    assert said(FAILING)[0].endswith(" of 40 replicates")


def test_tables_are_tidy() -> None:
    table = RESULTS.to_pandas()
    entries = [f"estimate[{i},{j}]" for i in (0, 1) for j in (0, 1)]
    assert list(table.columns) == ["size", "method", "replicate", "error", *entries]
    assert len(table) == 150
    one = table[(table["size"] == 30) & (table["method"] == "alse") & (table["replicate"] == 7)]
    assert one["error"].item() == RESULTS.values["error"][2, 1, 7]
    assert one["estimate[1,0]"].item() == RESULTS.values["estimate"][2, 1, 7, 1, 0]
    assert table.attrs["key"] == RESULTS.about["key"]
    assert table["size"].dtype.kind == "i"


def test_data_sets_have_named_dimensions() -> None:
    data = RESULTS.to_xarray()
    assert data["estimate"].dims == ("size", "method", "replicate", "estimate_0", "estimate_1")
    found = data["error"].sel({"size": 10, "method": "alse", "replicate": 3}).item()
    assert found == RESULTS.values["error"][1, 1, 3]
    assert data.attrs["key"] == RESULTS.about["key"]
    part = RESULTS.select(method="alse").to_xarray()
    assert part["error"].dims == ("size", "replicate")
    assert part.attrs["method"] == "alse"
    assert part["error"].equals(data["error"].sel({"method": "alse"}).drop_vars("method"))


def test_files_have_all_numbers(tmp_path: Path) -> None:
    for package in ("pyarrow", "h5netcdf"):
        pytest.importorskip(package)
    for suffix in ("parquet", "nc", "json"):
        RESULTS.save(tmp_path / f"a.{suffix}")
    table = pandas.read_parquet(tmp_path / "a.parquet")
    assert table.equals(RESULTS.to_pandas())
    assert table.attrs["key"] == RESULTS.about["key"]
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as data:
        assert data.identical(RESULTS.to_xarray())
    written = json.loads((tmp_path / "a.json").read_text())
    assert np.array_equal(written["values"]["estimate"], RESULTS.values["estimate"])
    assert written == json.loads(json.dumps(RESULTS.to_dict()))
    assert {one.name for one in tmp_path.iterdir()} == {"a.parquet", "a.nc", "a.json"}
    with pytest.raises(
        InputError,
        match=r"must be one of '.parquet', '.csv', '.nc', '.json', '.tex', got str '.xls",
    ):
        RESULTS.save(tmp_path / "a.xls")


@pytest.mark.parametrize(
    ("package", "call"),
    [
        ("pandas", lambda path: RESULTS.to_pandas()),
        ("pandas", lambda path: RESULTS.summary().to_pandas()),
        ("xarray", lambda path: RESULTS.to_xarray()),
        ("pyarrow", lambda path: RESULTS.save(path / "a.parquet")),
        ("h5netcdf", lambda path: RESULTS.save(path / "a.nc")),
    ],
)
def test_a_missing_package_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str, call: object
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"{package}: install the extra .*stochens_rs\[tables\]"):
        call(tmp_path)  # type: ignore[operator]


def test_optional_packages_are_imported_when_used() -> None:
    code = (
        "import sys, stochens_rs as se\n"
        "made = se.Study(lambda key, a: {'x': a}, {'a': [1, 2]}, replicates=3, rng=1)\n"
        "print(made.run().summary())\n"
        "names = 'pandas xarray pyarrow h5netcdf distributed dask loky matplotlib'.split()\n"
        "assert not set(names) & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_results_are_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        RESULTS.values["error"][0, 0, 0] = 1.0
    with pytest.raises(InputError, match=r"`size` must be one of 3, 10, 30, got int 7"):
        RESULTS.select(size=7)
    with pytest.raises(InputError, match="`axis` must be one of 'size', 'method', got str 'sizes'"):
        RESULTS.select(sizes=3)


def test_figures_show_medians_and_bands() -> None:
    pytest.importorskip("matplotlib")
    ax = RESULTS.plot("size", "error", "method")
    uniform, alse = ax.get_lines()
    rows = RESULTS.values["error"]
    assert np.allclose(uniform.get_ydata(), np.median(rows[:, 0], axis=1))
    assert np.allclose(alse.get_ydata(), np.median(rows[:, 1], axis=1))
    labels = [line.get_label() for line in (uniform, alse)]
    assert labels == ["method = uniform", "method = alse"]
    assert alse.get_color() != uniform.get_color()
    band = ax.collections[0].get_paths()[0].vertices
    assert band[:, 1].min() == pytest.approx(np.quantile(rows[:, 0], 0.1, axis=1).min())
    assert band[:, 1].max() == pytest.approx(np.quantile(rows[:, 0], 0.9, axis=1).max())
    assert ax.get_yscale() == "log"
    across = RESULTS.plot("method", "estimate[0,1]", "size")
    assert [tick.get_text() for tick in across.get_xticklabels()] == ["uniform", "alse"]
    assert [line.get_label() for line in across.get_lines()] == [
        "size = 3",
        "size = 10",
        "size = 30",
    ]
    one = RESULTS.select(method="uniform").plot("size", "error", ax=ax)
    assert one is ax
    with pytest.raises(
        InputError, match=r"leave the axis 'method' with 2 labels: fix one by select"
    ):
        RESULTS.plot("size", "error")
    with pytest.raises(InputError, match="`y` must be one of"):
        RESULTS.plot("size", "errors", "method")


def test_notebooks_show_a_table() -> None:
    shown = RESULTS._repr_html_()
    assert RESULTS.about["key"] in shown
    assert shown.count("<tr>") >= 30
    assert "uniform" in RESULTS.summary()._repr_html_()


def test_results_are_saved_as_text_and_for_latex(tmp_path):
    study = se.Study(lambda key, size: {"error_a": 1.0 / size}, {"size": [10, 20]}, replicates=2)
    found = study.run()
    found.save(tmp_path / "r.csv")
    assert (tmp_path / "r.csv").read_text().splitlines()[:2] == [
        "size,replicate,error_a",
        "10,0,0.1",
    ]
    found.save(tmp_path / "r.tex")
    lines = (tmp_path / "r.tex").read_text().splitlines()
    assert lines[0] == r"\begin{tabular}{llrrrrrrrr}"
    assert lines[4].startswith(r"10 & error\_a & 2 & 0 & 0 & 0.1 & ")
    assert lines[-1] == r"\end{tabular}"
