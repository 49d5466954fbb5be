"""Tables with labelled rows and columns are matched by label or refused."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs._base import validation
from stochens_rs.exceptions import InputError, InputTypeError
from test_validation import assert_one_short_line

pd = pytest.importorskip("pandas")
xr = pytest.importorskip("xarray")

A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0, 0.0], [0.5, 1.0]])
X0, XF = np.array([1.0, 2.0]), np.array([0.5, 0.0])

LABELLED = {
    "names": (pd.Series(X0, index=["speed", "angle"]), "index: 'speed', 'angle'"),
    "names as columns": (pd.DataFrame(A, columns=["a", "b"]), "columns: 'a', 'b'"),
    "permuted": (pd.Series(X0, index=[1, 0]), "index: 1, 0"),
    "counted from 1": (pd.Series(X0, index=[1, 2]), "index: 1, 2"),
    "rows and columns": (
        pd.DataFrame(A, index=["b", "a"], columns=["x", "y"]),
        "index: 'b', 'a'; columns: 'x', 'y'",
    ),
    "long names": (
        pd.DataFrame(A, index=["b" * 99, "a" * 99], columns=["x" * 99, "y" * 99]),
        f"index: '{'b' * 29}",
    ),
    "all coordinates": (
        xr.DataArray(A, coords={"to": ["a", "b"], "from": ["b", "a"]}, dims=["to", "from"]),
        "dims: 'to', 'from'; to: 'a', 'b'; from: 'b', 'a'",
    ),
    "coordinates": (xr.DataArray(X0, coords={"state": ["b", "a"]}), "state: 'b', 'a'"),
    "permuted dimensions": (xr.DataArray(A).T, "dims: 'dim_1', 'dim_0'"),
    "in a list": ([pd.Series(row, index=["b", "a"]) for row in A], "index: 'b', 'a'"),
    "polars, by its attributes": (
        SimpleNamespace(columns=["x", "y"], to_numpy=lambda: A, __array__=lambda: A),
        "columns: 'x', 'y'",
    ),
    "pyarrow, by its attributes": (
        SimpleNamespace(column_names=["x", "y"], columns=[1, 2]), "columns: 1, 2"
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", LABELLED)
def test_labels_are_refused_with_the_cure(what):
    value, said = LABELLED[what]
    with pytest.raises(InputError, match=r"pass X\.to_numpy\(\) if the order is right") as caught:
        validation.array("X", value, ndim=(1, 2, 3))
    assert f"has labels ({said}" in str(caught.value)
    assert "A.loc[states, states].to_numpy(), x0[states].to_numpy()" in str(caught.value)
    assert_one_short_line(caught.value)


UNLABELLED = {
    "series": (pd.Series(X0), X0),
    "frame": (pd.DataFrame(A), A),
    "list of series": ([pd.Series(row) for row in A], A),
    "data array": (xr.DataArray(A), A),
    "data array with one named dimension": (xr.DataArray(X0, dims="state"), X0),
    "counted coordinates": (xr.DataArray(X0, coords={"x": [0, 1]}), X0),
}


@pytest.mark.parametrize("what", UNLABELLED)
def test_default_labels_are_none(what):
    value, expected = UNLABELLED[what]
    got = validation.array("X", value, ndim=(1, 2))
    assert type(got) is np.ndarray
    np.testing.assert_array_equal(got, expected)


x0 = pd.Series(X0, index=["speed", "angle"])
frame = pd.DataFrame(A, columns=["a", "b"], index=["a", "b"])


OVEN = se.System(A, B[:, :1], states=["front", "back"], inputs=["heat"], units={"front": "K"})


def test_a_dict_of_numbers_is_a_vector_by_name():
    plain = se.control(OVEN, X0, XF, steps=5, limits=(-9.0, 9.0)).u
    named = {"back": X0[1], "front": X0[0]}, {"back": XF[1], "front": XF[0]}
    assert np.array_equal(se.control(OVEN, *named, steps=5, limits=(-9.0, 9.0)).u, plain)
    fleet = se.SystemEnsemble.from_systems([OVEN, OVEN])
    made = [se.control_fleet(fleet, *both, 5).u for both in (named, (X0, XF))]
    assert np.array_equal(*made)
    for wrong, what in (
        ({"back": 1.0}, "'front' is missing"),
        (named[0] | {"side": 1.0}, "got 'side'"),
    ):
        with pytest.raises(InputError, match=f"`x0` must have the labels .*{what}.*: rename"):
            se.control(OVEN, wrong, XF)
    with pytest.raises(InputTypeError, match="an object of type dict"):
        se.control(OVEN, {"back": [1.0, 2.0], "front": [1.0, 2.0]}, XF)


@pytest.mark.parametrize(
    ("names", "same"),
    [
        (["front [K]", "back [K]"], True),
        (["back", "front [K]"], True),
        (["front [degC]", "back"], False),
        (["front", "side"], False),
    ],
)
def test_names_with_units_are_those_of_a_system_with_the_same_units(names, same):
    rng = np.random.default_rng(1)
    x, u = rng.standard_normal((40, 2)), rng.standard_normal((40, 1))
    order = [0, 1] if names[0].startswith("front") else [1, 0]
    after = x @ A.T + u @ B[:, :1].T + 0.1 * rng.standard_normal((40, 2))
    rows = x[:, order], u, after[:, order]
    data = se.Trajectories.from_pairs(*rows, state_names=names, input_names=["heat [kW]"])
    noise = se.Noise(sigma=0.1, design="independent")
    if not same:
        with pytest.raises(InputError, match=r"`ensemble` must have the states .* 'front"):
            se.fuse([OVEN, OVEN], "alse", data=data, noise=noise)
        return
    fused = se.fuse([OVEN, OVEN], "alse", data=data, noise=noise)
    assert np.abs(fused.A[np.ix_(np.argsort(order), np.argsort(order))] - A).max() < 0.1


def test_runs_in_one_array_of_xarray_are_refused_for_their_labels_not_for_their_number():
    xarray = pytest.importorskip("xarray")
    states = xarray.DataArray(np.zeros((5, 11, 2)), dims=("run", "time", "state"))
    with pytest.raises(InputError, match=r"`states\[0\]` has labels"):
        se.Trajectories(states, np.zeros((5, 10, 1)))
