"""Problems from .npz, .json and .mat files: the same problem, and hostile files refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import cli
from stochens_rs.exceptions import InputError, StochensError

sio = pytest.importorskip("scipy.io")

A, B = np.array([[1.0, 0.1], [-0.2, 0.9]]), np.array([[0.0, 1.0], [0.1, 0.0]])
X0, XF = np.array([2.0, -1.0]), np.array([0.5, 0.0])
STATES, INPUTS, UNITS = ["p", "v"], ["F", "T_m3"], {"p": "m", "T_m3": "N m"}
TEXTS = ["m", "", "", "N m"]
WHOLE = {"A": A, "B": B, "x0": X0, "xf": XF, "dt": 0.1}
SYSTEM = se.System(A, B, dt=0.1, states=STATES, inputs=INPUTS, units=UNITS)


def cells(texts):
    return np.array(texts, dtype=object)


def write(path, **more):
    """The problem as a file of this kind."""
    if path.suffix == ".npz":
        np.savez(path, **WHOLE, states=STATES, inputs=INPUTS, units=TEXTS, **more)
    elif path.suffix == ".mat":
        texts = {"states": cells(STATES), "inputs": cells(INPUTS), "units": cells(TEXTS)}
        sio.savemat(path, {**WHOLE, **texts, **more}, do_compression=True)
    else:
        lists = {name: np.asarray(value).tolist() for name, value in WHOLE.items()}
        names = {"states": STATES, "inputs": INPUTS, "units": UNITS}
        path.write_text(json.dumps({**lists, **names, **more}))
    return path


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".json", ".txt", ".MAT"])
def test_every_kind_is_the_same_problem(tmp_path, suffix):
    path = write(tmp_path / f"a{suffix.lower()}").rename(tmp_path / f"a{suffix}")
    found = se.cases.from_file(path)
    assert found.system == SYSTEM
    assert found.system.labels == SYSTEM.labels
    np.testing.assert_array_equal(found.x0, X0)
    np.testing.assert_array_equal(found.xf, XF)


def test_matlab_as_matlab_writes_it(tmp_path):
    """Vectors are columns or rows, text is rows of characters, integers and booleans are kept."""
    path = tmp_path / "a.mat"
    for form in ("column", "row"):
        for packed in (False, True):
            made = {"A": A, "B": B, "x0": X0, "dt": 0.1, "states": ["pos", "v"]}
            sio.savemat(path, made, oned_as=form, do_compression=packed)
            found = se.cases.from_file(path)
            assert found.system == SYSTEM
            np.testing.assert_array_equal(found.x0, X0)
            assert found.system.state_names == ("pos", "v")
    sio.savemat(path, {"A": np.array([[2]], dtype=np.int8), "B": np.array([[True]])})
    assert se.cases.from_file(path).system == se.System([[2.0]], [[1.0]])
    sio.savemat(path, {"A": [[2.0]], "B": [[1.0]], "states": "T", "inputs": cells(["P"])})
    assert se.cases.from_file(path).system.labels.states == ("T",)


def test_ts_is_the_step(tmp_path):
    sio.savemat(tmp_path / "a.mat", {"A": A, "B": B, "Ts": 0.1})
    assert se.cases.from_file(tmp_path / "a.mat").system == se.System(A, B, dt=0.1)


def test_other_and_damaged_matlab_files_are_refused_by_name(tmp_path):
    """Each byte of a compressed file is guarded by its checksum; variables may be cut off whole."""
    path = tmp_path / "a.mat"
    sio.savemat(path, {"A": A, "B": B, "x0": X0}, do_compression=True)
    whole = path.read_bytes()
    hdf5 = b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\x02IM"
    damaged = [whole[:at] + bytes([whole[at] ^ 0x5A]) + whole[at + 1 :] for at in range(140, 220)]
    cut = [whole[:end] for end in range(1, 230)]
    for content in (b"", b"text", bytes(500), hdf5, whole + whole[128:], *damaged, *cut):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"a\.mat must (be a|have the entries)"):
            se.cases.from_file(path)


# -- .npz and JSON -------------------------------------------------------------------------------


def test_entries_of_json_that_appear_twice_are_refused(tmp_path):
    path = tmp_path / "a.json"
    for text in ('"states": ["p"], "states": ["q"]', '"units": {"x[0]": "m", "x[0]": "s"}'):
        path.write_text(f'{{"A": [[1]], "B": [[1]], {text}}}')
        with pytest.raises(InputError, match="appears twice"):
            se.cases.from_file(path)


def test_bad_names_in_archives_are_refused(tmp_path):
    path = tmp_path / "a.npz"
    for names, said in (
        (np.array([b"p", b"v"]), "`states` must be a string"),
        (np.array([1.0, 2.0]), "`states` must be a string"),
        (np.array("p"), "`states` must be a list"),
        (np.array([["p", "v"]]), "`states` must be a string"),
    ):
        np.savez(path, A=A, B=B, states=names)
        with pytest.raises(StochensError, match=said):
            se.cases.from_file(path)
    np.savez(path, A=A, B=B, states=np.array(["p", object()], dtype=object))
    with pytest.raises(InputError, match="archive of numeric arrays"):
        se.cases.from_file(path)


# -- commands ------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".json"])
def test_commands_read_every_kind_with_its_names(tmp_path, capsys, suffix):
    path = str(write(tmp_path / f"a{suffix}"))
    assert cli.main(["control", path, "--steps", "3"]) == 0
    assert "T_m3" in capsys.readouterr().out
