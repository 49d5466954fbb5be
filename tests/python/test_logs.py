"""Logs as they are: folders, lost rows, stamps, delays, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import DataWarning, InputError, InputTypeError
from twin.battery import far_cells

LOGS = Path(__file__).parents[2] / "docs" / "data" / "logs"
RIG = {"states": ["position", "angle", "speed", "rate"], "inputs": ["force"], "time": "time"}
nan = float("nan")


def log(gen, rows=40, lost=0.0):
    """One run on a grid of 0.1 s, rows left out of its table by chance, and cells of its states."""
    there = gen.random(rows) >= lost
    there[:3] = True
    columns = {
        "t": 0.1 * np.arange(rows),
        "x": gen.standard_normal(rows),
        "v": gen.standard_normal(rows),
        "u": gen.standard_normal(rows),
    }
    columns["v"][gen.random(rows) < lost / 2] = nan
    columns["u"][gen.random(rows) < lost / 2] = nan
    columns["v"][:3] = columns["u"][:3] = 1.0
    return {name: column[there] for name, column in columns.items()}


def several(gen, runs=4, **options):
    logs = [log(gen, **options) for _ in range(runs)]
    found = {name: np.concatenate([one[name] for one in logs]) for name in logs[0]}
    return found | {"run": np.repeat(np.arange(runs), [len(one["t"]) for one in logs])}


def read(columns, **options):
    options = {"by": "run", "time": "t", **options}
    return se.Trajectories.from_table(columns, states=["x", "v"], inputs=["u"], **options)


def by_hand(columns, delay=0):
    """The pairs of each run with their steps, from a dictionary of complete rows."""
    found = []
    for run in dict.fromkeys(columns["run"].tolist()):
        own = columns["run"] == run
        at = {
            round(t / 0.1): k for k, t in zip(np.flatnonzero(own), columns["t"][own], strict=True)
        }
        pairs = []
        for step, k in at.items():
            after, acting = at.get(step + 1), at.get(step - delay)
            if after is None or acting is None:
                continue
            states = columns["x"][k], columns["v"][k]
            then = columns["x"][after], columns["v"][after]
            row = np.array([*states, columns["u"][acting], *then])
            if np.isfinite(row).all():
                pairs.append((step, row))
        found.append(pairs)
    return found


def one_step(pairs):
    return [k > 0 and pairs[k][0] == pairs[k - 1][0] + 1 for k in range(len(pairs))]


@pytest.mark.parametrize("delay", [-1, 0, 1, 3])
@pytest.mark.parametrize("lost", [0.0, 0.05, 0.3])
def test_pairs_and_pieces_are_those_by_hand(lost, delay):
    gen = np.random.default_rng(5)
    columns = several(gen, lost=lost)
    data, expected = read(columns, delay=delay), by_hand(columns, delay)
    np.testing.assert_array_equal(data.rows, [row for run in expected for _, row in run])
    assert data.lengths.tolist() == [len(run) for run in expected]
    pieces = [follows for run in expected for follows in one_step(run)]
    assert len(data.pieces) == pieces.count(False)
    assert data.pieces.sum() == data.size
    assert (data.lost > 0) is (lost > 0)
    for (x, u), run in zip(data.runs, expected, strict=True):  # nan where there is no pair
        first = run[0][0]
        assert len(x) == run[-1][0] - first + 2
        assert np.isfinite(u).sum() == len(run)
        for step, row in run:
            np.testing.assert_array_equal(x[step - first], row[:2])
            np.testing.assert_array_equal(x[step - first + 1], row[3:])
            np.testing.assert_array_equal(u[step - first], row[2:3])


def test_lost_rows_are_counted_once():
    """Row 2 left out, a cell of row 5 empty, the input of row 8 empty, the last input unused."""
    gen = np.random.default_rng(6)
    columns = {name: gen.standard_normal(12) for name in "xvu"} | {"t": 0.1 * np.arange(12)}
    columns["v"][5], columns["u"][8], columns["u"][11] = nan, nan, nan
    data = read({name: np.delete(column, 2) for name, column in columns.items()}, by=None)
    assert (data.lost, data.pieces.tolist(), len(data)) == (3, [1, 1, 2, 2], 1)
    assert repr(data) == "<Trajectories: 1 run in 4 pieces, 6 pairs, 3 rows lost, n=2 m=1 dt=0.1>"


# -- one run stays one run -------------------------------------------------------------------------


def test_what_counts_runs_counts_no_pieces():
    columns = several(np.random.default_rng(7), lost=0.15)
    data, expected = read(columns), by_hand(columns)
    assert len(data.pieces) > len(data) == 4
    last = data.last_pairs()
    np.testing.assert_array_equal(last.rows, [run[-1][1] for run in expected])
    assert last.single
    first, second = data.split(2, rng=1)
    assert (len(first), len(second), first.lost + second.lost) == (2, 2, data.lost)
    assert len(data[1:3].pieces) == sum(one_step(run).count(False) for run in expected[1:3])
    assert data[1:3].lengths.tolist() == [len(run) for run in expected[1:3]]
    with pytest.raises(InputError, match="must be 'adaptive' for runs of several steps"):
        se.identify(data, noise=se.Noise(design="independent"))
    with pytest.warns(DataWarning, match="pairs are equal to others to the last digit"):
        pooled = se.identify([data, data], checks=False).data
    assert (len(pooled), len(pooled.pieces)) == (8, 2 * len(data.pieces))


def test_a_run_with_gaps_is_no_held_out_run_and_no_design():
    gen = np.random.default_rng(12)
    data = read(several(gen, lost=0.2))
    plan = se.control((np.eye(2) / 2, np.ones((2, 1))), [1.0, 0.0], [0.0, 0.0], steps=2)
    with pytest.raises(InputError, match=r"`runs` must have no gaps, got \d+ gaps in 4 runs"):
        plan.validate(data)


def test_the_lag_test_reaches_over_no_gap():
    gen = np.random.default_rng(13)
    columns = several(gen, runs=3, rows=300, lost=0.1)
    model = se.identify(read(columns), checks=False)
    pieces = [row for run in read(columns).runs for row in cut(*run)]
    apart = se.identify(se.Trajectories(*zip(*pieces, strict=True)), checks=False)
    for name in ("memory", "dead time", "nonlinear"):
        assert model.tests[name] == pytest.approx(apart.tests[name])


def cut(x, u):
    """The pieces of a run with nan between them."""
    whole = np.isfinite(u).all(axis=1)
    ends = np.flatnonzero(np.diff(np.r_[False, whole, False].astype(int))).reshape(-1, 2)
    return [(x[a : b + 1], u[a:b]) for a, b in ends]


# -- stamps ----------------------------------------------------------------------------------------


def stamped(times, **options):
    gen = np.random.default_rng(len(times))
    columns = {name: gen.standard_normal(len(times)) for name in "xvu"}
    return read(columns | {"t": np.asarray(times, dtype=float)}, by=None, **options)


def test_the_step_is_the_mean_where_stamps_are_rounded():
    """60 Hz in whole milliseconds: the median, 17 ms, would put the steps of 16 ms off the grid."""
    data = stamped(np.round(np.arange(60) / 60.0, 3))
    assert data.dt == pytest.approx(1 / 60, rel=1e-3)
    assert data.pieces.tolist() == [59]


def test_jitter_needs_a_declared_step_and_drift_does_not_matter():
    gen = np.random.default_rng(15)
    times = 0.02 * (np.arange(200) + gen.uniform(-0.1, 0.1, 200))
    with pytest.raises(InputError, match=r"off by more than 5 % of one.* declare dt=0.02") as said:
        stamped(times)
    assert "of 199 are off" in str(said.value)
    assert stamped(times, dt=0.02).pieces.tolist() == [199]
    drifting = np.cumsum(np.linspace(0.0195, 0.0205, 400))  # 1 s off the grid at the end
    assert stamped(drifting).pieces.tolist() == [399]


def jittering(runs=12):
    """Runs of 150 rows at 50 Hz whose stamps are off by 2 %: just below what is refused."""
    gen = np.random.default_rng(16)
    t = np.tile(0.02 * np.arange(150), (runs, 1)) + 4e-4 * gen.standard_normal((runs, 150))
    columns = {name: gen.standard_normal(t.size) for name in "xvu"}
    return columns | {"t": t.ravel(), "run": np.repeat(np.arange(runs), 150)}


def test_rows_lost_for_their_stamps_are_said():
    columns = jittering()
    with pytest.warns(
        DataWarning, match=r"^\d+ rows dropped because the stamps jitter; .* dt=0.02$"
    ):
        data = read(columns)
    assert data.lost > 0.03 * len(columns["t"])
    assert read(columns, dt=0.02).lost == 0  # warnings are errors here


def test_stamps_off_the_grid_divide_and_no_input_reaches_over_them():
    times = np.r_[np.arange(20), np.arange(20) + 21.4] * 0.1
    assert stamped(times, dt=0.1).pieces.tolist() == [19, 19]
    assert stamped(times, dt=0.1, delay=3).pieces.tolist() == [16, 16]
    assert stamped(np.r_[np.arange(20), np.arange(20) + 20.6] * 0.1, dt=0.1).lost == 1
    on_grid = np.r_[np.arange(20), np.arange(20) + 21] * 0.1
    assert stamped(on_grid, delay=3).pieces.tolist() == [16, 2, 16]  # u(20) is lost


def test_a_row_that_is_logged_twice_follows_on_none():
    times = np.sort(np.r_[np.arange(40) * 0.1, 2.001])
    assert stamped(times, dt=0.1).pieces.tolist() == [20, 19]


def test_huge_gaps_take_no_memory():
    data = stamped(np.r_[np.arange(20), np.arange(20) + 1e12] * 0.1)
    assert data.pieces.tolist() == [19, 19]
    assert "1 run in 2 pieces" in repr(data)
    assert "<polyline" in data._repr_html_()


@pytest.mark.parametrize(
    ("times", "options", "said"),
    [
        ([0, 1, 4], {}, "`time` must have equal steps, got 2 of 1 to 3 s: declare `dt`"),
        ([-1.7e308, 1.7e308], {}, "`time` must have finite steps, got inf at time -1.7e+308"),
        (
            np.cumsum(1.0 + 0.8 * np.random.default_rng(3).random(50)),
            {"dt": 1.2},
            "irregular times",
        ),
        ([0, 1, 2, 3, 4, 5], {"dt": 0.5}, "steps of 0.5 s in every run, but most of the table are"),
        (
            [0, 1, 2, 5, 6, 7],
            {"on_gap": "raise"},
            "a gap of 3 steps behind the row at time 2: on_g",
        ),
        ([0, 1, 2], {"delay": 5}, "no two complete rows that are one step apart, 1 s, with an inp"),
    ],
)
def test_bad_stamps_are_refused_with_the_numbers(times, options, said):
    with pytest.raises(InputError) as caught:
        stamped(times, **options)
    assert said in str(caught.value)


def test_without_times_the_rows_are_the_steps():
    data = stamped(np.arange(9), time=None, dt=0.5, delay=1)
    assert (data.dt, data.size) == (0.5, 7)


# -- columns ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda c: c | {"u": np.full(40, 0.3)},
            "excite it, as by the rows before a step; or, for states, pass arrays to Trajectories, "
            "and B to identify as known=(None, B)",
        ),
        (lambda c: c | {"v": np.zeros(40)}, "`v` is constant (0) in all rows"),
        (lambda c: c | {"v": -57.29577951 * c["x"]}, "`x` and `v` are proportional in all rows"),
        (lambda c: c | {"x": np.where(c["x"] > 2, np.inf, c["x"])}, "`table['x']` is inf at time"),
    ],
)
def test_columns_that_are_no_signals_are_named(change, said):
    columns = change(log(np.random.default_rng(16)))
    with pytest.raises(InputError) as caught:
        read(columns, by=None)
    assert said in str(caught.value)


def test_a_constant_input_of_states_has_a_known_B():
    gen, x = np.random.default_rng(16), [np.zeros(1)]
    for _ in range(60):
        x.append(0.8 * x[-1] + 0.2 + 0.01 * gen.standard_normal(1))
    model = se.identify(se.Trajectories(np.array(x), np.ones((60, 1))), known=(None, [[0.2]]))
    assert not model.warnings
    assert model.region(0.05).contains([[0.8]], [[0.2]])


@pytest.mark.parametrize("unit", [0.01, 0.2])
def test_coarse_readings_of_a_swing_are_not_the_end_of_a_range(unit):
    t = np.arange(2000)
    gen = np.random.default_rng(17)
    swing = np.round(np.sin(0.05 * t) / unit) * unit
    columns = {"t": 0.1 * t, "x": swing, "v": np.cos(0.05 * t), "u": gen.standard_normal(2000)}
    assert read(columns, by=None).size == 1999


# -- files -----------------------------------------------------------------------------------------


def write(path, columns, names="t,x,v,u", lines=()):
    rows = np.column_stack([columns[name] for name in "txvu"]).tolist()
    cells = [",".join("" if np.isnan(cell) else repr(cell) for cell in row) for row in rows]
    path.write_text("\n".join([names, *cells, *lines]) + "\n")


@pytest.fixture
def folder(tmp_path):
    gen = np.random.default_rng(18)
    for number in (10, 2, 1):
        columns = log(gen, lost=0.1)
        columns["x"][0] = number
        write(tmp_path / f"run_{number}.csv", columns)
    (tmp_path / "notes.txt").write_text("no log")
    return tmp_path


def files(source, **options):
    options = {"time": "t", **options}
    return se.Trajectories.from_csv(source, states=["x", "v"], inputs=["u"], **options)


def test_a_folder_a_pattern_and_a_list_are_the_same_runs(folder):
    data = files(folder)
    assert [x[0, 0] for x, _ in data] == [1, 2, 10]
    assert files(str(folder / "run_*.csv")) == data
    named = [folder / f"run_{number}.csv" for number in (10, 1, 2)]
    assert [x[0, 0] for x, _ in files(named).runs] == [10, 1, 2]
    assert files(named[1]) == data[0:1]
    assert files(f"{folder}/") == data
    with pytest.raises(InputError, match=r"must name each file once, got .*run_10.csv twice"):
        files([str(folder), named[0]])


def test_a_file_is_read_as_a_table_is(folder):
    cells = np.genfromtxt(folder / "run_2.csv", delimiter=",", names=True)
    table = {name: cells[name] for name in cells.dtype.names}
    assert files(folder / "run_2.csv") == read(table, by=None)


def test_units_of_columns_must_agree(folder):
    for number in (1, 2, 10):
        path = folder / f"run_{number}.csv"
        path.write_text(path.read_text().replace("t,x,v,u", "t [s],x [m],v,u"))
    assert files(folder).state_names == ("x [m]", "v")
    path.write_text(path.read_text().replace("x [m]", "x [mm]"))
    with pytest.raises(InputError, match=r"run_10.csv has .*x \[mm\].* the same units"):
        files(folder)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (
            lambda p: p.write_text(p.read_text().replace("t,x,v,u", "t,x,w,u")),
            "of {} are t, x, w, u",
        ),
        (
            lambda p: p.write_text(p.read_text() + "9,1,fast,2\n"),
            "{} must have numbers in column 'v'",
        ),
        (lambda p: p.write_text("t,x,v,u\n0,1,2,3\n"), "{} has no two complete rows"),
        (lambda p: p.write_text(p.read_text() + ",1,2,3\n"), "`time` is missing in line "),
    ],
)
def test_errors_name_the_file(folder, spoil, said):
    path = folder / "run_2.csv"
    spoil(path)
    with pytest.raises(InputError) as caught:
        files(folder)
    assert said.format(path) in str(caught.value)


def test_missing_cells_are_named_if_gaps_are_to_raise(folder):
    columns = log(np.random.default_rng(19))
    columns["v"][7] = columns["u"][-1] = nan
    write(folder / "run_2.csv", columns)
    with pytest.raises(InputError, match=r"`v` is missing in .*run_2.csv at time 0.7: on_gap='spl"):
        files(folder / "run_2.csv", on_gap="raise")


# -- the logs of the documentation -----------------------------------------------------------------


def test_the_logs_of_the_rig():
    data = se.Trajectories.from_csv(LOGS, dt=0.02, delay=1, **RIG)
    assert (len(data), data.lost, data.dt) == (16, 30, 0.02)
    paths = sorted(LOGS.glob("*.csv"), key=lambda path: int(path.stem[4:]))
    starts = [float(path.read_text().splitlines()[2].split(",")[1]) for path in paths]
    assert [x[0, 0] for x, _ in data.runs] == starts  # the first row has no force before it
    model = se.identify(data)
    assert model.warnings == ()
    assert model.region(0.05).assumption.endswith("; rows lost by chance, not for what they read")
    last = se.identify(data.last_pairs(), checks=False)
    assert last.region(0.05).assumption.endswith("; rows lost by chance, not for what they read")


def test_a_column_of_another_rate_is_named(tmp_path):
    rows = [f"{0.01 * k:.2f},{k},{k if k % 8 == 0 else ''},1" for k in range(41)]
    (path := tmp_path / "slow.csv").write_text("\n".join(["t,motor,load,u", *rows]) + "\n")
    with pytest.raises(InputError, match=r"load is in 15% of its rows alone.*log them at one rate"):
        se.Trajectories.from_csv(path, outputs=["motor", "load"], inputs=["u"], time="t")


# -- codes of a missing value --------------------------------------------------------------------


def readings(cell=None, value=0.0, inputs=None, dead=()):
    """Eight runs of two readings of a plant, with one cell of (run, row, column) put to a value."""
    gen, runs = np.random.default_rng(8), []
    A, B = np.array([[0.9, 0.2], [0.0, 0.7]]), np.array([0.1, 1.0])
    for _ in range(8):
        y, u = np.zeros((61, 2)), gen.standard_normal(60) if inputs is None else inputs.copy()
        for k in range(60):
            y[k + 1] = A @ y[k] + B * u[k] + 0.02 * gen.standard_normal(2)
        runs.append((y, u[:, None]))
    if cell is not None:
        run, row, column = cell
        runs[run][column // 2][row, column % 2] = value
    for run in dead:
        runs[run][0][:], runs[run][1][:] = 1.0, 0.0
    names = {"state_names": ["pos", "speed"], "input_names": ["force"]}
    data = se.Trajectories(*zip(*runs, strict=True), outputs=True, dt=0.5, **names)
    return se.identify(data, window=se.Window(lags=2), checks=False)


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
@pytest.mark.parametrize("value", [-9999.0, 999.0, 32767.0])
@pytest.mark.parametrize("cell", [(r, k, c) for r in (0, 6) for k in (0, 1, 9) for c in range(3)])
def test_a_code_of_a_missing_value_is_named_wherever_it_stands(cell, value):
    """Also in the first rows, which tell the scale, and in those that only fill the window."""
    run, row, column = cell
    name = ("pos", "speed", "force")[column]
    where = f"at {0.5 * row:.6g} s of data[{run}] ({name} = {value:g})"
    doubts = readings(cell, value).doubts
    assert "cells are far from all others, " + where in doubts[0]


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
def test_any_reading_far_from_all_others_is_named():
    assert "at 0.5 s of data[0] (pos = 150)" in readings((0, 1, 0), 150.0).doubts[0]


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
def test_impulses_and_what_follows_them_are_no_codes():
    impulse = 0.001 * np.sin(np.arange(60.0))
    impulse[20] = 50.0
    assert "spikes" not in readings(inputs=impulse).tests
    fast = 0.01 * np.random.default_rng(2).standard_normal((8, 61, 1))
    fast[0, 21] += 50.0
    inputs = np.tile(0.001 * np.sin(np.arange(60.0))[:, None], (8, 1, 1))
    assert far_of(fast, inputs) == ([21], [0])
    inputs[0, 20] = 50.0
    assert far_of(fast, inputs) == ([], [])
    assert "spikes" not in readings().tests


def far_of(y, u, **about):
    """Pairs and columns of far cells."""
    data = se.Trajectories(list(y), list(u), outputs=True)
    model = se.identify(data, window=se.Window(lags=1), checks=False, **about)
    found = model._tested.get("spikes")
    if found is None or not len(found.each):  # only cells have columns
        return [], []
    return found.at.tolist(), found.each.astype(int).tolist()


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
@pytest.mark.parametrize("n", [1, 2])
def test_far_cells_are_those_of_the_plain_twin(n):
    """Codes, readings and pulses anywhere, of columns of numbers and of many equal ones."""
    gen, some = np.random.default_rng(n), 0
    values = [999.0, -9999.0, 32767.0, 1e30, 30.0, 12.0, 1.0]
    for seed in range(60):
        runs, steps = int(gen.integers(2, 7)), int(gen.integers(20, 60))
        y, u = gen.standard_normal((runs, steps + 1, n)), gen.standard_normal((runs, steps, 2))
        if seed % 3 == 0:
            y, u = y.round(), u.round()
        for _ in range(gen.integers(0, 4)):
            one = y if gen.random() < 0.6 else u
            one[tuple(gen.integers(0, one.shape))] = gen.choice(values)
        cells = np.concatenate([y[:, :-1], u], axis=2).reshape(-1, n + 2)
        wanted = far_cells(cells, n, np.tile(np.arange(steps), runs))
        assert far_of(y, u) == wanted
        some += bool(wanted[0])
    assert 15 < some < 55


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
@pytest.mark.parametrize(
    ("dead", "said"),
    [
        ((), None),
        ((3,), "data[3] never changes: leave such runs out; or declare Noise"),
        ((3, 6), "data[3] and data[6] never change: leave such runs out; or declare Noise"),
    ],
)
def test_runs_of_a_rig_that_was_off_are_named(dead, said):
    doubts = " ".join(readings(dead=dead).doubts)
    assert "never change" not in doubts if said is None else said in doubts


TEXTS = {
    "bad": "got str 'bad' in row 5: pass nan where nothing was measured",
    "4,5": r"got str '4,5' in row 5: a number as text: .*astype.float., after .*replace.',', '.'.",
}


@pytest.mark.parametrize("cell", TEXTS)
def test_a_text_in_a_column_of_numbers_is_named_with_its_row(cell):
    columns = several(np.random.default_rng(1))
    v: list[object] = columns["v"].tolist()
    v[5], v[7] = cell, None
    column = np.array(v, dtype=object)
    with pytest.raises(InputTypeError, match=r"`table\['v'\]` must contain real .*" + TEXTS[cell]):
        read(columns | {"v": column})


def test_numbers_as_text_say_how_to_make_them_numbers():
    columns = several(np.random.default_rng(1))
    with pytest.raises(InputTypeError, match=r"got str '1.0' in row 0: a number as text: col"):
        read(columns | {"v": columns["v"].astype(str)})
