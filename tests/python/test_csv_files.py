"""CSV files as loggers and spreadsheets write them: read as the plain one is, or refused."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone

import numpy as np
import pandas as pd
import pytest

import stochens_rs as se
from stochens_rs._base.names import titled
from stochens_rs.data.table import SECONDS, unit_of
from stochens_rs.exceptions import DataWarning, InputError, InputTypeError, ShapeError

T = 12
GEN = np.random.default_rng(8)
CELLS = {
    "t": [f"{0.02 * k:.2f}" for k in range(T)],
    **{name: [f"{v:.3f}" for v in GEN.standard_normal(T)] for name in ("p", "v", "F")},
}
HEAD = ",".join(CELLS)
ROWS = [",".join(row) for row in zip(*CELLS.values(), strict=True)]
PLAIN = "\n".join([HEAD, *ROWS])
COMMA = PLAIN.replace(",", ";").replace(".", ",")
COLUMNS = {"states": ["p", "v"], "inputs": ["F"], "time": "t"}


def read(folder, text, **options):
    path = folder / "log.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return se.Trajectories.from_csv(path, **(COLUMNS | options))


def stamped(stamps, title="t"):
    rows = [f"{stamp},{row.partition(',')[2]}" for stamp, row in zip(stamps, ROWS, strict=False)]
    return "\n".join([HEAD.replace("t", title, 1), *rows])


# -- text ------------------------------------------------------------------------------------------

AS_PLAIN = {
    "semicolons": (PLAIN.replace(",", ";"), {}),
    "tabs": (PLAIN.replace(",", "\t"), {}),
    "blanks": (PLAIN.replace(",", "   "), {}),
    "bars": (PLAIN.replace(",", " | "), {}),
    "a separator of one's own": ("sep=^\n" + PLAIN.replace(",", "^"), {}),
    "semicolons, decimal commas": (COMMA, {}),
    "tabs, decimal commas": (COMMA.replace(";", "\t"), {}),
    "bars, decimal commas": (COMMA.replace(";", " | "), {}),
    "semicolons in a text": (
        "\n".join([HEAD + ',"a; b"', *(row + ',"c; d"' for row in ROWS)]), {}
    ),
    "commas in names": (
        "\n".join(["t, s;p;v, w;F", *COMMA.split("\n")[1:]]),
        {"time": "t, s", "states": ["p", "v, w"]},
    ),
    "what Excel says first": ("sep=;\n" + COMMA, {}),
    "comments": ("# of a rig, 1, 2\n#\n\n% by a script\n" + PLAIN, {}),
    "names in a comment": ("# " + PLAIN, {}),
    "lines to skip": ("Scope 12, 4 channels, a\nb\n" + PLAIN, {"skip": 2}),
    "empty lines": (PLAIN.replace("\n", "\n\n"), {}),
    "empty columns and rows at the end": (PLAIN.replace("\n", ",,\n") + ",\n,,,,,\n,,,\n", {}),
    "blanks around cells": (PLAIN.replace(",", " , "), {}),
    "lines of Windows": (PLAIN.replace("\n", "\r\n"), {}),
    "lines of old Macs": (PLAIN.replace("\n", "\r"), {}),
    "UTF-16": (PLAIN.encode("utf-16"), {}),
    "UTF-16 without a mark": (PLAIN.encode("utf-16-be"), {}),
    "UTF-8 with a mark": (PLAIN.encode("utf-8-sig"), {}),
    "columns of pandas": (
        "\n".join([",0,1,2", *ROWS]),
        {"time": "", "states": ["0", "1"], "inputs": ["2"]},
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", AS_PLAIN)
def test_it_is_read_as_the_plain_file(tmp_path, what):
    text, options = AS_PLAIN[what]
    data, plain = read(tmp_path, text, **options), read(tmp_path, PLAIN)
    assert (data.dt, data.size) == (0.02, T - 1)
    np.testing.assert_array_equal(data.rows, plain.rows)


@pytest.mark.parametrize(
    ("names", "units"),
    [
        (HEAD, "s,m,m/s,N"),
        (HEAD, "[s],(m),m/s,N"),
        ("t,p [m],v,F", "s,mm,m/s,N"),
        (HEAD, " s,m,m/s,N"),
    ],
)
def test_a_row_of_units_becomes_part_of_the_names(tmp_path, names, units):
    data = read(tmp_path, "\n".join([names, units, *ROWS]))
    assert (data.state_names, data.input_names) == (("p [m]", "v [m/s]"), ("F [N]",))
    in_ms = read(tmp_path, "\n".join([names, units.replace("s", "ms", 1), *ROWS]))
    assert in_ms.dt == pytest.approx(2e-5)


@pytest.mark.parametrize(
    "word",
    ["", " ", "nan", "NA", "n/a", "NULL", "None", "#N/A", "<NA>", "-1.#IND", "-", "--", "---"],
)
def test_words_for_a_missing_number(tmp_path, word):
    text = PLAIN.replace(CELLS["v"][4], word)
    assert read(tmp_path, text).pieces.tolist() == [3, 6]


def test_latin_1_is_read(tmp_path):
    data = read(tmp_path, PLAIN.replace("p", "p [\u00b5m]").encode("latin-1"))
    assert data.state_names == ("p [\u00b5m]", "v")


REFUSED = {
    "no names": ("\n".join(ROWS), {}, r"got '0.00': .*pandas\.read_csv\("),
    "names further down": ("Scope,12\n" + PLAIN, {}, "4 cells, not 2, in line 2: .* pass `skip`"),
    "words above the names": ("Scope 12\nSerial: 77\n\n" + PLAIN, {}, "in line 4: .* pass `skip`"),
    "a word below": (PLAIN + "\nEnd of log", {}, "1 cells, not 4, in line 14: complete the row"),
    "names again": (
        "\n".join([HEAD, *ROWS[:5], HEAD, *ROWS[5:]]),
        {},
        "got 'p' in line 7, the names of the columns again: split the file there",
    ),
    "decimal commas between commas": (COMMA.replace(";", ","), {}, "4, in line 2: decimal"),
    "a comma that may be decimal or divide thousands": (
        f"{HEAD.replace(',', chr(9))}\n0\t1,234\t2\t3\n1\t2,345\t5\t7\n", {},
        "'1,234' in line 2: decimal commas are read where ; or a tab",
    ),
    "points among decimal commas": (
        COMMA.replace(";0,", ";1.0,"), {}, r"got '1\.0,\d+' in line \d+, where others have"
    ),
    "a word": (PLAIN + "\n\n# end\n", {}, r"a comment among its rows, in line 15: delete it"),
    "a row as a comment": (PLAIN.replace("\n0.06", "\n#0.06"), {}, "comment .* in line 5"),
    "a word behind empty lines": (
        "# a\n\n" + PLAIN.replace("\n", "\n\n") + "\n\n1,1,fast,2", {}, "'v', got 'fast' in line 29"
    ),
    "a unit of two lines": (
        "\n".join([HEAD, 's,"m\nm",m,N', *ROWS]), {}, r"one line of text .* got 'p \[m\\nm\]'"
    ),
    "names that are the same with their units": (
        "\n".join(["p,p [m],v,F", "m,m,m,N", *ROWS]), {}, "has the column 'p .m.' twice"
    ),
    "an underscore": (PLAIN + "\n0.24,1,1_5,2", {}, "got '1_5' in line 14"),
    "no text": (b"PK\3\4\0\0a,b\n", {}, "text in UTF-8, UTF-16 or Windows-1252"),
    "a negative number of lines": (PLAIN, {"skip": -1}, "`skip` must be"),
    "more lines than there are": (PLAIN, {"skip": 40}, "is empty"),
    "a state without readings": (
        "\n".join([HEAD, *(row.replace(row.split(",")[2], "", 1) for row in ROWS)]),
        {},
        "`v` has no number in .*: pass what was measured as outputs=",
    ),
    "rows of two logs": (
        "\n".join([HEAD, *(f"0.{k + 10}," + (",,3", "1,2,")[k % 2] for k in range(20))]),
        {},
        "has no complete row, as where the rows of two logs are merged.*merge_asof",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_it_is_refused_with_the_cure(tmp_path, what):
    text, options, said = REFUSED[what]
    with pytest.raises((InputError, InputTypeError), match=said) as caught:
        read(tmp_path, text, **options)
    assert "\n" not in str(caught.value)


# -- columns of tables -----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [dict, pd.DataFrame])
def test_a_table_has_units_behind_its_names_as_a_file_has(kind):
    table = {
        f"{name}{unit}": np.array(cells, dtype=float)
        for (name, cells), unit in zip(CELLS.items(), (" [s]", " [m]", "(m/s)", "[N]"), strict=True)
    }
    data = se.Trajectories.from_table(kind(table), **COLUMNS)
    assert (data.state_names, data.input_names, data.dt) == (("p [m]", "v(m/s)"), ("F[N]",), 0.02)


@pytest.mark.parametrize(
    "titles", [["x[0]", "x[1]"], ["x(-1)", "y"], ["x [m]", "x [mm]"], ["x(+1)"]]
)
def test_names_that_are_no_names_with_a_unit(titles):
    assert titled("x", titles) == "x"


@pytest.mark.parametrize("time", [None, "t"])
def test_columns_of_unequal_length_are_named(time):
    table = {"x": np.arange(5.0), "u": np.ones(4), "t": np.arange(5.0)}
    with pytest.raises(ShapeError, match=r"got 5 rows of str 'x' and 4 of str 'u': the last row"):
        se.Trajectories.from_table(table, states=["x"], inputs=["u"], time=time)


# -- time ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("titles", "unit"),
    [
        ("t;time;Time [s];t(sec);t_s;timestamp;Timestamps;status;items;ts;Lap_times;x_d_a", 1.0),
        ("t [ms];t[ms];Time (ms);t_ms;time.ms;t ms;tms;timeMs;ms;millis;T (milliseconds)", 1e-3),
        ("TimeUS;time_us;t [\u00b5s];t(\u03bcs);usec;timestamp_us;timeus;stampMicros", 1e-6),
        ("Timestamp[nanosec];t_ns;recvTimeNs;time (nanoseconds);header.stamp.nsecs", 1e-9),
        ("t (min);t_min;Time[minutes];TimeMin", 60.0),
        ("Time[h];t (hours);t_hr;h", 3600.0),
        ("t [d];time_days", 86400.0),
    ],
)  # fmt: skip
def test_the_unit_of_a_column_of_times(titles, unit):
    for title in titles.split(";"):
        times, parts = SECONDS[unit_of(title) or "s"]
        assert times / parts == unit, title


@pytest.mark.parametrize("loader", ["csv", "table"])
@pytest.mark.parametrize(
    ("title", "begin", "step", "dt"),
    [
        ("Time (ms)", 7e3, 20.0, 0.02),
        ("t_us", 0, 2e4, 0.02),
        ("Timestamp[nanosec]", 0, 2e7, 0.02),
        ("Time[h]", 0, 1 / 180, 20.0),
        ("t", 1709632800123, 20, 0.02),  # since 1970, in ms
        ("t", 1709632800123456789, 20_000_000, 0.02),
    ],
)
def test_times_are_converted_to_seconds(tmp_path, loader, title, begin, step, dt):
    stamps = [begin + k * step for k in range(T)]
    if loader == "csv":
        data = read(tmp_path, stamped([f"{one!r}" for one in stamps], title), time=title)
    else:
        table = {name: np.array(cells, dtype=float) for name, cells in CELLS.items()}
        data = se.Trajectories.from_table(table | {title: stamps}, **(COLUMNS | {"time": title}))
    assert data.dt == pytest.approx(dt, rel=1e-4)
    assert data.size == T - 1


HOUR, START = timedelta(hours=1), datetime(2024, 5, 1, 1, 59, 59, 900000)
BERLIN = [START + timedelta(seconds=0.02 * k) for k in range(T)]
DATES = {
    "ISO": [one.isoformat() for one in BERLIN],
    "a blank": [str(one) for one in BERLIN],
    "a comma": ['"' + str(one).replace(".", ",") + '"' for one in BERLIN],
    "Z": [f"{one.isoformat()}Z" for one in BERLIN],
    "UTC": [f"{one} UTC" for one in BERLIN],
    "an offset": [f"{one}+02:00" for one in BERLIN],
    "an hour set back": [
        f"{one - HOUR * (k > 5)}+0{2 - (k > 5)}00" for k, one in enumerate(BERLIN)
    ],
}  # fmt: skip


@pytest.mark.parametrize("what", DATES)
def test_dates_and_times_are_read_with_their_zones(tmp_path, what):
    data = read(tmp_path, stamped(DATES[what]))
    assert (data.dt, data.size) == (0.02, T - 1)
    table = {name: np.array(cells, dtype=float) for name, cells in CELLS.items()}
    assert (
        se.Trajectories.from_table(table | {"t": [c.strip('"') for c in DATES[what]]}, **COLUMNS).dt
        == 0.02
    )


@pytest.mark.parametrize(
    "column",
    [
        pd.Series(pd.to_datetime(BERLIN)).dt.tz_localize("UTC"),
        pd.Series(pd.to_datetime(BERLIN)).dt.tz_localize("Europe/Berlin"),
        pd.Series(BERLIN, dtype=object),
        pd.Series([one.replace(tzinfo=timezone.utc) for one in BERLIN], dtype=object),
        pd.Series(DATES["an offset"]),
        pd.Series(pd.to_timedelta([0.02 * k for k in range(T)], unit="s")),
    ],
    ids=range(6),
)
def test_columns_of_dates_of_a_frame(column):
    """Warnings of NumPy about zones are errors here."""
    frame = pd.DataFrame({name: np.array(cells, dtype=float) for name, cells in CELLS.items()})
    assert se.Trajectories.from_table(frame.assign(t=column), **COLUMNS).dt == 0.02


AT_50_HZ = np.arange(60) * 0.02
TWO_CLOCKS = np.cumsum(np.tile([0.006, 0.014], 30))
STAMPS = {
    "twice": (np.insert(AT_50_HZ, 30, AT_50_HZ[29]), "twice, in rows 29 and 30 .* other cells"),
    "rounded": (np.floor(AT_50_HZ), "58 of 59 stamps equal .* in rows 0 and 1 .* declare `dt`"),
    "Excel": ([float(f"{9.0274527e13 + 2e7 * k:.5E}") for k in range(60)], "they are rounded"),
    "set back": (
        AT_50_HZ - 0.5 * (np.arange(60) > 39),
        "goes back by 0.48 s behind row 39 of the table: the clock was set back .* sorted, rows",
    ),
    "set back by half a step": (AT_50_HZ - 0.51 * (np.arange(60) > 39), "the clock was set back"),
    "out of order": (AT_50_HZ[np.r_[0:20, 21, 20, 22:60]], "behind row 20 .* sort them by time"),
    "backwards": (AT_50_HZ[::-1], "out of order, sort them by time"),
    "another unit": (1e12 * (1 + AT_50_HZ) * 50, "the table begins at 5e.13: .* as t .ns."),
    "two clocks": (TWO_CLOCKS, "steps that alternate in the table, 0.006 and 0.014 s.*merge_asof"),
    "in ms, declared in s": (1e3 * AT_50_HZ, "20 s in the median: .* are in ms, name"),
}  # fmt: skip


def with_stamps(times, **options):
    gen = np.random.default_rng(3)
    columns = {name: gen.standard_normal(len(times)) for name in "pvF"} | {"t": np.asarray(times)}
    return se.Trajectories.from_table(columns, **(COLUMNS | options))


@pytest.mark.parametrize("what", STAMPS)
def test_what_is_wrong_with_stamps_has_its_own_words(what):
    stamps, said = STAMPS[what]
    with pytest.raises(InputError, match=said):
        with_stamps(stamps, dt=0.02 if "declared" in what else None)


def test_rows_that_are_copies_are_left_out_and_counted(tmp_path):
    """In several files at once; empty cells are equal, too."""
    gen = np.random.default_rng(3)
    columns = {name: gen.standard_normal(60) for name in "pvF"} | {"t": AT_50_HZ}
    columns["v"][50] = np.nan
    frame = pd.DataFrame(columns)
    copied = frame.iloc[np.sort(np.r_[0:60, 30, 50])]
    for name, rows in {"1": frame, "2": copied, "3": copied}.items():
        rows.to_csv(tmp_path / f"{name}.csv", index=False)
    said = "4 rows were left out, copies of the row before: lines 32 and 33 of .*2.csv, ..."
    with pytest.warns(DataWarning, match=said):
        data = se.Trajectories.from_csv(tmp_path, **COLUMNS)
    once = se.Trajectories.from_csv(tmp_path / "1.csv", **COLUMNS)
    assert data.size == 3 * once.size
    np.testing.assert_array_equal(data[1:2].rows, once.rows)
    assert data.pieces.tolist() == 3 * once.pieces.tolist()


def test_every_third_row_lost_is_no_merged_log():
    kept = AT_50_HZ[np.arange(60) % 3 > 0]
    assert with_stamps(kept).size == 20
    columns = {
        "p": np.repeat(np.arange(20.0) ** 2, 2),
        "v": np.arange(40.0),
        "F": kept % 0.1,
        "t": kept,
    }
    with pytest.raises(InputError, match="steps that alternate"):  # every second row repeats p
        se.Trajectories.from_table(columns, **COLUMNS)


DATE = "2024-03-05 10:00:00"
BAD_TIMES = {
    "another unit": (stamped(CELLS["t"], "t (UTC)"), "'t .UTC.' of .* is in 'utc': name s, ms"),
    "months first": (
        stamped([f"03/05/2024 10:00:{k:02d}" for k in range(T)]),
        "got '03/05/2024 10:00:00' in line 2: .* 2024-03-05 10:00:00.5, .*pandas.to_datetime",
    ),
    "a word among dates": (stamped([DATE, DATE.replace("00", "01"), "soon"]), "'soon' in line 4"),
    "zones of some": (stamped([f"{DATE}Z", DATE]), "zone or none, got .* in line 3"),
    "the name of a zone": (stamped([f"{DATE} CET"]), "got '2024-03-05 10:00:00 CET' in line 2"),
    "now": (stamped(["now", "today"]), "got 'now' in line 2"),
    "a missing date": (stamped([DATE, "", DATE]), "`time` is missing in line 3"),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD_TIMES)
def test_times_that_are_none_are_refused(tmp_path, what):
    text, said = BAD_TIMES[what]
    title = text.partition(",")[0]
    with pytest.raises(InputError, match=said):
        read(tmp_path, text, time=title)


# -- readings at the end of a range ----------------------------------------------------------------


def step_response(rest=25):
    volt = np.r_[np.zeros(rest), np.full(100, 6.0), np.full(75, 3.0), np.full(100, 9.0)]
    speed = np.zeros(len(volt))
    for k in range(1, len(volt)):
        speed[k] = 0.82 * speed[k - 1] + 0.36 * volt[k - 1]
    return {"speed": speed, "volt": volt}


def load(kind, table, path):
    if kind == "arrays":
        return se.Trajectories(
            table["speed"][:, None], table["volt"][:-1, None], state_names=["speed"]
        )
    if kind == "from_table":
        return se.Trajectories.from_table(table, states=["speed"], inputs=["volt"])
    pd.DataFrame(table).to_csv(path, index=False)
    return se.Trajectories.from_csv(path, states=["speed"], inputs=["volt"])


@pytest.mark.parametrize("kind", ["arrays", "from_table", "from_csv"])
def test_rest_before_a_step_is_read_and_the_end_of_a_range_is_said(tmp_path, kind):
    """Warnings are errors here."""
    table, path = step_response(), tmp_path / "log.csv"
    data = load(kind, table, path)
    with pytest.warns(DataWarning):
        model = se.identify(data)
    np.testing.assert_allclose([model.A[0, 0], model.B[0, 0]], [0.82, 0.36], atol=1e-6)
    table["speed"] = np.minimum(table["speed"], 11.0)
    clipped = int((table["speed"] == 11.0).sum())
    said = f"`speed` reads 11, its largest value, in {clipped} rows: no harm if"
    with pytest.warns(DataWarning, match=said):
        load(kind, table, path)


# -- short logs ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (24, "must be longer, .* got 6 pairs in the first quarter, .* needs 8"),
        (60, "must be longer, .* got 60 pairs, and needs 68 to choose one"),
        *((rows, "") for rows in (80, 100, 300, 500)),
    ],
)
def test_a_short_log_has_a_short_window_or_is_said_to_be_too_short(rows, said):
    A, B, gen = np.array([[0.9, 0.1], [-0.1, 0.8]]), np.array([0.1, 1.0]), np.random.default_rng(3)
    u, x = gen.uniform(-1, 1, rows), np.zeros((rows + 1, 2))
    for k in range(rows):
        x[k + 1] = A @ x[k] + B * u[k] + 0.05 * gen.standard_normal(2)
    y = x[:, :1] + 0.01 * gen.standard_normal((rows + 1, 1))
    data = se.Trajectories(y, u[:, None], outputs=True)
    if said:
        with pytest.raises(InputError, match=f"`data` {said}"):
            se.identify(data)
        return
    model = se.identify(data, checks=False)
    assert model.window.found is not None
    assert model.window.fill < rows / 4
    assert np.isfinite(model.region(0.05).radius)
