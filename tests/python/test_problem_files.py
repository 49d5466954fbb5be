"""Problems from .npz, .json and .mat files: the same problem, and hostile files refused."""

from __future__ import annotations

import json
import struct
import tracemalloc

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


@pytest.mark.parametrize("seed", range(30))
def test_matlab_numbers_are_those_that_scipy_reads(tmp_path, seed):
    gen, path = np.random.default_rng(seed), tmp_path / "a.mat"
    n, m = (int(k) for k in gen.integers(1, 9, 2))
    kind = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", ">f8", "bool"][seed % 12]
    made = [np.asarray(abs(gen.normal(0, 60, shape)), dtype=kind) for shape in ((n, n), (n, m))]
    names = [f"{'ä' * (seed % 3)}state {k}" * int(gen.integers(1, 5)) for k in range(n)]
    mapped = {"A": made[0], "B": made[1], "x0": made[0][0], "states": cells(names)}
    sio.savemat(path, mapped, do_compression=bool(seed % 2), oned_as="row")
    found, wanted = se.cases.from_file(path), sio.loadmat(path)
    np.testing.assert_array_equal(found.system.A, wanted["A"])
    np.testing.assert_array_equal(found.system.B, wanted["B"])
    np.testing.assert_array_equal(found.x0, wanted["x0"][0])
    assert found.system.state_names == tuple(text[0] for text in wanted["states"][0])


MAT = {
    "an unknown variable": ({"A": A, "B": B, "Q": A}, "got also 'Q'"),
    "outputs": ({"A": A, "B": B, "C": A}, "no variable C: a problem has states and inputs, no out"),
    "a log": ({"u": A, "y": A, "Ts": 0.1}, r"also 'u', as a log has: .* Trajectories\.from_csv"),
    "a struct of arrays": ({"sys": {"A": A, "B": B}}, "got a struct in sys: .* '-struct', 'sys'"),
    "a struct": ({"A": {"a": 1.0}, "B": B}, "A as an array of numbers, got struct"),
    "cells of numbers": ({"A": cells([1.0, 2.0]), "B": B}, "array of numbers, got cell"),
    "text": ({"A": "text", "B": B}, "A as an array of numbers, got char"),
    "names as numbers": ({"A": A, "B": B, "states": [1.0, 2.0]}, "states as a cell of text, got"),
    "names in cells of cells": (
        {"A": A, "B": B, "states": cells([cells(["p", "q"]), "v"])}, "text in all cells of states"
    ),
    "names in cells of numbers": (
        {"A": A, "B": B, "states": cells([1.0, "v"])}, "text in all cells of states"
    ),
    "no B": ({"A": A}, "B is missing"),
    "three dimensions": ({"A": np.ones((2, 2, 2)), "B": B}, r"`A` must have shape \(n, n\)"),
    "wrong rows": ({"A": A, "B": B[:1]}, r"`B` must have shape \(2, m\)"),
    "complex": ({"A": A * 1j, "B": B}, "real numbers in A, got complex ones"),
    "empty": ({"A": np.zeros((0, 0)), "B": B}, "must have numbers in A, got shape"),
    "nan": ({"A": A * np.nan, "B": B}, r"`A\[0, 0\]` is nan"),
    "two steps": ({"A": A, "B": B, "dt": [0.1, 0.2]}, "`dt` must be a real number"),
    "continuous time": ({"A": A, "B": B, "dt": 0.0}, "continuous time"),
    "x0 as a matrix": ({"A": A, "B": B, "x0": A}, r"`x0` must have shape \(2,\)"),
    "the same name twice": (
        {"A": A, "B": B, "states": cells(["p", "p"])}, "`states` must be different names, got 'p'"
    ),
    "too few units": ({"A": A, "B": B, "units": cells(["m"])}, "`units` must have 4 texts"),
}  # fmt: skip


@pytest.mark.parametrize("what", MAT)
def test_bad_matlab_files_are_refused(tmp_path, what):
    made, said = MAT[what]
    sio.savemat(tmp_path / "a.mat", made)
    with pytest.raises(StochensError, match=said):
        se.cases.from_file(tmp_path / "a.mat")


def test_ts_is_the_step(tmp_path):
    sio.savemat(tmp_path / "a.mat", {"A": A, "B": B, "Ts": 0.1})
    assert se.cases.from_file(tmp_path / "a.mat").system == se.System(A, B, dt=0.1)


@pytest.mark.parametrize("old", [True, False])
@pytest.mark.parametrize(("kind", "said"), [
    ("ss", r"got an object ss in G: of an ss object save .* = ssdata\(G\)"),
    ("iddata", r"got an object iddata in G: t = G\.SamplingInstants; .* Trajectories\.from_csv"),
    ("tf", "got an object tf in G"),
])  # fmt: skip
def test_objects_of_matlab_are_refused_with_the_cure(tmp_path, kind, said, old):
    """Of an older class: flags, shape, name, class; of a classdef: flags, name, system, class."""
    flags, name = element(6, struct.pack("<II", 3 if old else 17, 0)), element(1, b"G")
    parts = (
        (element(5, np.array([1, 1], "<i4").tobytes()), name)
        if old
        else (name, element(1, b"MCOS"))
    )
    head = b"MATLAB 5.0".ljust(124) + struct.pack("<H", 0x100) + b"IM"
    whole = head + element(
        14, flags + b"".join(parts) + element(1, kind.encode()) + element(6, b"")
    )
    (tmp_path / "a.mat").write_bytes(whole)
    with pytest.raises(InputError, match=said):
        se.cases.from_file(tmp_path / "a.mat")


def test_sparse_matrices_are_refused_with_the_cure(tmp_path):
    sparse = pytest.importorskip("scipy.sparse")
    sio.savemat(tmp_path / "a.mat", {"A": sparse.csc_matrix(A), "B": B})
    with pytest.raises(InputError, match=r"got sparse: save full\(A\)"):
        se.cases.from_file(tmp_path / "a.mat")


def test_variables_that_appear_twice_are_refused(tmp_path):
    path = tmp_path / "a.mat"
    sio.savemat(path, {"A": A, "B": B})
    whole = path.read_bytes()
    path.write_bytes(whole + whole[128:])  # the header of a file has 128 bytes
    with pytest.raises(InputError, match="must have the variable 'A' once"):
        se.cases.from_file(path)


def test_new_matlab_files_are_refused_with_the_cure(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.mat"
    with h5py.File(path, "w") as file:
        file["A"] = A
    with pytest.raises(InputError, match=r"got 7\.3 \(HDF5\): save it again with save\(name"):
        se.cases.from_file(path)
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64" + path.read_bytes())
    with pytest.raises(InputError, match=r"got 7\.3"):
        se.cases.from_file(path)


@pytest.mark.parametrize("compressed", [True, False])
def test_cut_and_damaged_matlab_files_raise_one_kind_of_error(tmp_path, compressed):
    """A file that is cut between two variables is a whole one with fewer of them."""
    path = tmp_path / "a.mat"
    made = {"A": A, "B": B, "states": cells(STATES), "inputs": ["F", "T"], "x0": X0}
    sio.savemat(path, made, do_compression=compressed)
    whole, gen, refused, fewer = path.read_bytes(), np.random.default_rng(3), 0, 0
    for cut in range(len(whole)):
        path.write_bytes(whole[:cut])
        try:
            fewer += se.cases.from_file(path).x0 is None
        except StochensError:
            refused += 1
    assert fewer <= 3
    assert refused + fewer == len(whole)
    refused = 0
    for _ in range(500):
        data = bytearray(whole)
        for k in gen.integers(120, len(whole), int(gen.integers(1, 4))):
            data[k] = int(gen.integers(256))
        path.write_bytes(data)
        try:
            se.cases.from_file(path)
        except StochensError:
            refused += 1
    assert refused > (450 if compressed else 150)


def element(kind, data):
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matlab_array(kind, dims, name, *parts):
    """An array as MATLAB writes it, of any class and shape."""
    shape = np.array(dims, "<i4").tobytes()
    head = (element(6, struct.pack("<II", kind, 0)), element(5, shape), element(1, name))
    return element(14, b"".join(head + parts))


DOUBLE, CHARS, CELL, MOST = 6, 4, 1, 2**31 - 1
ONE, NONE = element(9, struct.pack("<d", 1.0)), element(16, b"")
HUGE_SHAPES = {
    "rows of no text": matlab_array(CHARS, (20_000_000, 0), b"units", NONE),
    "a cell of rows of no text": matlab_array(
        CELL, (1, 1), b"states", matlab_array(CHARS, (20_000_000, 0), b"", NONE)
    ),
    "dimensions": matlab_array(DOUBLE, (1,) * 100_000, b"x0", ONE),
    "large dimensions": matlab_array(DOUBLE, (MOST,) * 100_000, b"x0", ONE),
    "dimensions of cells": matlab_array(CELL, (MOST,) * 100_000, b"states"),
    "no numbers": matlab_array(DOUBLE, (MOST, MOST, 0), b"x0", element(9, b"")),
}


@pytest.mark.parametrize("what", HUGE_SHAPES)
def test_shapes_that_no_bytes_stand_behind_are_refused(tmp_path, what):
    """9.6 s and 758 MB for the first one before."""
    path = tmp_path / "a.mat"
    known = (matlab_array(DOUBLE, (1, 1), name, ONE) for name in (b"A", b"B"))
    head = b"MATLAB 5.0".ljust(124) + struct.pack("<H", 0x100) + b"IM"
    path.write_bytes(head + b"".join(known))
    assert se.cases.from_file(path).system.m == 1
    path.write_bytes(path.read_bytes() + HUGE_SHAPES[what])
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=r"without characters|dimensions|got shape"):
            se.cases.from_file(path)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


def test_packed_files_are_not_unpacked_beyond_memory(tmp_path, monkeypatch):
    from stochens_rs._base import memory
    from stochens_rs.exceptions import ResourceError

    path = tmp_path / "a.mat"
    sio.savemat(path, {"A": np.zeros((1000, 1000)), "B": np.ones((1000, 1))}, do_compression=True)
    assert path.stat().st_size < 50_000
    wanted = []

    def need(what, size):
        wanted.append(size)
        if size > 10**6:
            raise ResourceError(what)

    monkeypatch.setattr(memory, "need", need)
    with pytest.raises(ResourceError, match="unpacked"):
        se.cases.from_file(path)
    assert max(wanted) > 8 * 10**6


def test_old_files_of_other_programs_are_refused(tmp_path):
    path = tmp_path / "a.mat"
    sio.savemat(path, {"A": A, "B": B}, format="4")
    for content in (path.read_bytes(), b"", b"text", b"\0" * 500):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"version 5 to 7\.2, got another file: save it again"):
            se.cases.from_file(path)


# -- .npz and JSON -------------------------------------------------------------------------------

JSON = {
    "units of nothing": ({"units": {"q": "m"}}, "`units` must name states and inputs"),
    "units as text": ({"units": "m"}, "`units` must be a list"),
    "units that are numbers": ({"units": {"p": 1}}, r"`units\['p'\]` must be a string"),
    "names as text": ({"states": "pv"}, "`states` must be a list"),
    "too many names": ({"states": ["a", "b", "c"]}, "`states` must have 2 names, got 3"),
    "numbers as names": ({"inputs": [1, 2]}, "`inputs` must be a string"),
    "names twice": ({"inputs": ["F", "F"]}, "different names, got 'F' twice"),
    "a name of both": ({"inputs": ["p", "F"]}, "must differ from `states`, got 'p'"),
    "nested names": ({"states": [["p"], ["v"]]}, "`states` must be a string"),
}


@pytest.mark.parametrize("what", JSON)
def test_bad_names_in_json_are_refused(tmp_path, what):
    more, said = JSON[what]
    with pytest.raises(StochensError, match=said):
        se.cases.from_file(write(tmp_path / "a.json", **more))


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
def test_commands_read_every_kind(tmp_path, capsys, suffix):
    path = str(write(tmp_path / f"a{suffix}"))
    for args in (
        ["plan", "--file", path, "--error", "50%", "--runs", "20"],
        ["control", path, "--steps", "3", "--json"],
        ["stream", "--file", path, "--tol", "0.5"],
        ["study", path, "--replicates", "3"],
    ):
        assert cli.main(args) == 0, args
        assert capsys.readouterr().out


def test_commands_use_the_names(tmp_path, capsys):
    path = str(write(tmp_path / "a.json"))
    assert cli.main(["control", path, "--steps", "3"]) == 0
    assert "T_m3" in capsys.readouterr().out
