"""Files that were refused in different ways, and what the search for more of them would notice."""

from __future__ import annotations

import inspect
import random
import sys
from pathlib import Path

import numpy as np
import pytest

import stochens_rs as se
from test_docs import PUBLIC, unwrap

ROOT = Path(__file__).resolve().parents[2]


sys.path.insert(0, str(ROOT / "fuzz"))
import readers  # noqa: E402

CORPUS = ROOT / "fuzz" / "corpus"


WRITERS = {"save", "save_figures", "to_c", "run"}


def readers_of_files():
    """The public functions with an argument that names files to read, each where it is defined."""
    found = {}
    for path, obj in PUBLIC.items():
        of_class = [getattr(obj, name) for name in dir(obj)] if inspect.isclass(obj) else []
        for one in map(unwrap, [obj, *of_class]):
            if inspect.isfunction(one) and one.__name__ not in WRITERS and one.__name__[0] != "_":
                named = inspect.signature(one).parameters.values()
                if any("path" in f"{p.name} {p.annotation}".lower() for p in named):
                    found[one.__qualname__] = path
    return found


def test_every_reader_is_fuzzed():
    """A new one needs an example and what is then done with it in READERS of fuzz/readers.py."""
    found = readers_of_files()
    assert {"from_file", "read_matpower", "Durable.load", "Study.resume"} <= set(found)
    text = Path(readers.__file__).read_text("utf-8")
    missing = [name for name in found if f".{name.rpartition('.')[2]}(" not in text]
    assert missing == [], "give these readers a line in READERS of fuzz/readers.py, then make fuzz"


@pytest.mark.parametrize("name", readers.READERS)
def test_an_example_is_read(name, tmp_path):
    assert readers.outcome(name, readers.example(name), tmp_path) == ""


@pytest.mark.parametrize("name", readers.READERS)
def test_files_of_the_corpus_are_read_or_refused(name, tmp_path):
    files = sorted((CORPUS / name).iterdir())
    found = {readers.outcome(name, path.read_bytes(), tmp_path) for path in files}
    assert len(files) >= 5
    assert len(found) >= len(files) // 3  # they are kept since each is refused in another way


@pytest.mark.parametrize("name", readers.READERS)
def test_changed_files_are_read_or_refused(name, tmp_path, seed):
    draw, kind, good = random.Random(seed), readers.READERS[name][1], readers.example(name)
    files = (readers.changed(kind, good, draw) for _ in range(100))
    found = {readers.outcome(name, file, tmp_path) for file in files}
    assert len(found) >= 3


def test_the_search_notices_what_lets_a_foreign_exception_out(monkeypatch, tmp_path, capsys):
    suffix, kind, write, read = readers.READERS["problem"]

    def careless(path):
        try:
            read(path)
        except se.exceptions.ShapeError as error:
            raise KeyError("A") from error

    monkeypatch.setitem(readers.READERS, "problem", (suffix, kind, write, careless))
    monkeypatch.setattr(readers, "CORPUS", tmp_path)
    with pytest.raises(KeyError):
        readers.search("problem", 30.0, 3)
    said = capsys.readouterr().err
    assert [path for path in (tmp_path / "problem").iterdir() if str(path) in said]


def test_an_archive_whose_entries_begin_before_it_is_refused(tmp_path):
    content = readers.example("archive")
    at = content.index(b"PK\1\2") + 42  # where the first entry begins, in the list at the end
    damaged = bytearray(content[:at] + b"\xff\xff\xff\x7f" + content[at + 4 :])
    end = damaged.rindex(b"PK\5\6") + 16  # where that list begins
    damaged[end : end + 4] = (int.from_bytes(damaged[end : end + 4], "little") + 2**30).to_bytes(
        4, "little"
    )
    path = tmp_path / "damaged.npz"
    path.write_bytes(damaged)
    with pytest.raises(se.exceptions.InputError, match=r"damaged\.npz must be an archive"):
        se.cases.from_file(path)


def test_a_label_of_two_lines_gives_a_message_of_one(tmp_path):
    path = tmp_path / "runs.csv"
    path.write_text('t,x,u,run\n0,1,1,"a\nb"\n')
    with pytest.raises(se.exceptions.InputError, match=r"^run a\?b of .* has no two"):
        se.Trajectories.from_csv(path, states=["x"], inputs=["u"], by="run", time="t")


@pytest.mark.parametrize("largest", [1e155, 1e308])
def test_squares_that_overflow_are_refused(largest):
    rows = np.random.default_rng(1).standard_normal((20, 2))
    rows[4, 0] = largest
    with pytest.raises(se.exceptions.NonFiniteError, match="the sum of squares of the data"):
        se.identify(se.Trajectories([rows], [np.ones((19, 1))]))
    rows[4, 0] = 1e150
    with pytest.warns(se.exceptions.DataWarning):
        se.identify(se.Trajectories([rows], [np.arange(19.0)[:, None]]))
