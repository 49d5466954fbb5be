"""Measured runs: what is taken, what is refused, and what the pairs are."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import stochens_rs as se
from stochens_rs.data.trajectories import pooled
from stochens_rs.exceptions import InputError, InputTypeError, NonFiniteError
from twin import triangle as tr


def some_runs(gen, lengths=(3, 1, 5), n=2, m=1):
    shapes = [((T + 1, n), (T, m)) for T in lengths]
    return [tuple(gen.standard_normal(shape) for shape in run) for run in shapes]


def made(runs, **options):
    return se.Trajectories([x for x, _ in runs], [u for _, u in runs], **options)


def test_pairs_are_those_of_the_twin(gen):
    runs = some_runs(gen)
    data = made(runs)
    x, u, y = data.pairs()
    z, outcomes = tr.pairs(runs)
    np.testing.assert_array_equal(np.hstack([x, u]), z)
    np.testing.assert_array_equal(y, outcomes)
    assert (len(data), data.size, data.n, data.m) == (3, 9, 2, 1)
    for mine, given in zip(data.runs, runs, strict=True):
        np.testing.assert_array_equal(mine[0], given[0])
        np.testing.assert_array_equal(mine[1], given[1])


def test_last_pairs_are_those_of_the_twin(gen):
    runs = some_runs(gen)
    x, u, y = made(runs).last_pairs().pairs()
    z, outcomes = tr.last_pairs(runs)
    np.testing.assert_array_equal(np.hstack([x, u]), z)
    np.testing.assert_array_equal(y, outcomes)


def test_one_run_and_arrays_of_runs(gen):
    x, u = gen.standard_normal((4, 5, 2)), gen.standard_normal((4, 4, 1))
    assert se.Trajectories(x, u) == se.Trajectories(list(x), list(u))
    assert se.Trajectories(x[0], u[0]) == se.Trajectories([x[0]], [u[0]])
    assert se.Trajectories(x[0].tolist(), u[0].tolist()) == se.Trajectories(x[:1], u[:1])
    assert se.Trajectories(x.tolist(), u.tolist()) == se.Trajectories(x, u)


# -- parts and pools -------------------------------------------------------------------------------


def test_parts_keep_whole_runs(gen):
    data = made(some_runs(gen, range(1, 9)))
    first, second = data.split(0.5, rng=3)
    assert (len(first), len(second)) == (4, 4)
    assert sorted([*first.lengths, *second.lengths]) == list(range(1, 9))
    assert list(first.lengths) == sorted(first.lengths)  # in their order
    again, _ = data.split(4, rng=3)
    assert again == first
    assert data.split(4, rng=4)[0] != first
    assert data[2:4].lengths.tolist() == [3, 4]
    np.testing.assert_array_equal(data[-1][0], data.runs[-1][0])
    with pytest.raises(InputError, match="at least one run"):
        data[5:5]


def test_pooled_sets_are_one_after_the_other(gen):
    runs = some_runs(gen)
    assert pooled([made(runs[:1]), made(runs[1:])]) == made(runs)
    with pytest.raises(InputError, match=r"`data\[1\]` must have the states, inputs and dt"):
        pooled([made(runs), made(runs, dt=0.1)])
    with pytest.raises(InputTypeError, match="`data` must be a list"):
        pooled(runs[0][0][0, 0])
    with pytest.raises(InputError, match="empty list"):
        pooled([])


# -- tables ----------------------------------------------------------------------------------------


def table(**changes):
    columns = {
        "run": ["a", "a", "a", "b", "b"],
        "t": [0.0, 0.1, 0.2, 5.0, 5.1],
        "x": [1.0, 2.0, 3.0, 4.0, 5.0],
        "v": [0.0, 0.5, 1.0, 1.5, 2.0],
        "u": [7.0, 8.0, np.nan, 9.0, np.nan],
    }
    return {**columns, **changes}


def read(columns, **options):
    options = {"by": "run", "time": "t", **options}
    return se.Trajectories.from_table(columns, states=["v", "x"], inputs=["u"], **options)


@pytest.mark.parametrize("kind", [dict, pd.DataFrame])
def test_a_table_is_read_by_its_names(kind):
    data = read(kind(table()))
    assert (data.state_names, data.input_names, data.dt) == (("v", "x"), ("u",), 0.1)
    assert data.lengths.tolist() == [2, 1]
    np.testing.assert_array_equal(data.pairs()[0], [[0, 1], [0.5, 2], [1.5, 4]])
    np.testing.assert_array_equal(data.pairs()[1][:, 0], [7, 8, 9])
    np.testing.assert_array_equal(data.pairs()[2], [[0.5, 2], [1, 3], [2, 5]])


def test_the_order_of_columns_and_of_runs_in_a_frame_makes_no_difference():
    frame = pd.DataFrame(table())
    other = frame[["u", "x", "t", "v", "run"]].set_index(pd.Index(list("vwxyz")))
    assert read(other) == read(frame) == read(frame.iloc[[0, 3, 1, 4, 2]])


@pytest.mark.parametrize("labels", [[1, 1, True, True], [0, 0, False, False], [1, 1, "1", "1"]])
def test_runs_with_different_labels_are_different_runs(labels):
    columns = {"run": labels, "x": [1.0, 2, 3, 4], "v": [1.0] * 4, "u": [1.0] * 4}
    for one in (columns, {**columns, "run": np.array(labels, dtype=object)}, pd.DataFrame(columns)):
        assert read(one, time=None).lengths.tolist() == [1, 1]
    same = {**columns, "run": [1, 1.0, 1, np.int64(1)]}
    assert read(same, time=None).lengths.tolist() == [3]


BAD_TABLES = {
    "order": (table(t=[0.0, 0.2, 0.1, 5.0, 5.1]), "goes back by 0.1 s behind row 1 of run a: "),
    "an infinite state": (table(x=[1.0, np.inf, 3, 4, 5]), "`table['x']` is inf in run a at time"),
    "no column": ({"x": [1.0]}, "`states` names str 'v', but the columns of `table` are x"),
    "missing time": (table(t=[0.0, np.nan, 0.2, 5.0, 5.1]), "`time` is missing in row 1"),
    "missing run": (table(run=["a", "a", None, "b", "b"]), "`by` is missing in row 2"),
    "labels": (
        table(x=pd.Series([1.0] * 5, index=list("edcba"))), "`table['x']` has labels (index: 'e'"
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD_TABLES)
def test_bad_tables_are_refused_with_run_and_time(what):
    columns, said = BAD_TABLES[what]
    with pytest.raises((InputError, InputTypeError)) as caught:
        read(columns)
    assert said in str(caught.value)
    assert len(str(caught.value)) < 300


def test_a_column_of_nan_hints_at_outputs() -> None:
    x, u = np.ones((4, 2)), np.ones((3, 1))
    x[1, 1] = np.nan
    with pytest.raises(NonFiniteError, match=r"`states\[1, 1\]` is nan"):
        se.Trajectories(x, u)
    x[:, 1] = np.nan
    with pytest.raises(NonFiniteError, match=r"column of nan.*outputs=True"):
        se.Trajectories(x, u)
