"""The commands on measured runs, `identify` and `control`: numbers, files, and one-line errors."""

from __future__ import annotations

import json

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import cli
from test_cli_commands import failed
from test_cli_snapshots import A, B, log

COLUMNS = ["--states", "angle,rate", "--inputs", "torque"]
OPTIONS = [*COLUMNS, "--by", "run", "--time", "t"]


@pytest.fixture(autouse=True)
def _wide(monkeypatch):
    """No line is broken, whatever the terminal of the tests is."""
    monkeypatch.setenv("COLUMNS", "1000")


@pytest.fixture(scope="module")
def lines():
    return log(30, 20, np.random.default_rng(1))


@pytest.fixture
def table(tmp_path, lines):
    path = tmp_path / "runs.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def ran(capsys, *args):
    """Output of a command that succeeds, parsed."""
    code = cli.main([*map(str, args), "--json"])
    captured = capsys.readouterr()
    assert code == 0, captured.err
    return json.loads(captured.out)


def in_python(table):
    """The same runs, read by NumPy."""
    cells = np.genfromtxt(table, delimiter=",", skip_header=1, usecols=(2, 3, 4)).reshape(30, 21, 3)
    return se.Trajectories(cells[:, :, :2], cells[:, :-1, 2:], dt=0.1)


def changed(lines, row, column, text):
    cells = lines[row].split(",")
    cells[column] = text
    return [*lines[:row], ",".join(cells), *lines[row + 1 :]]


def test_from_runs_to_a_certified_control(table, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    file, out = tmp_path / "model.safetensors", tmp_path / "out"
    ran(capsys, "identify", table, *OPTIONS, "--sigma", 0.01, "--out", file, "--out", out)
    where = ["--from", "-1,0", "--to", "0,0.5", "--steps", 4]
    found = ran(capsys, "control", file, *where, "--delta", "1%", "--out", out)
    model = se.identify(in_python(table), noise=se.Noise(sigma=0.01))
    plan = se.control(model, [-1.0, 0.0], [0.0, 0.5], steps=4)
    bound = plan.bound(0.01)
    assert np.array_equal(found["u"], plan.u)
    assert found["certificate"] == bound.to_dict()
    end = se.simulate((A, B), [-1.0, 0.0], np.array(found["u"])).states[-1]
    assert np.linalg.norm(end - [0.0, 0.5]) <= bound.target < 0.1
    for name in ("identify", "control"):
        assert {f"{name}.{kind}" for kind in ("json", "png", "svg")} <= {
            path.name for path in out.iterdir()
        }
    noisy = ran(capsys, "control", file, *where, "--noise")["certificate"]
    assert noisy == plan.bound(0.05, noise=True).to_dict()
    assert "--force" in failed(capsys, "control", file, *where, "--out", out)


@pytest.fixture
def read(table, tmp_path, capsys):
    """A model of the angle alone, and a log of what just happened, its last input not known yet."""
    file, now = tmp_path / "read.safetensors", tmp_path / "now.csv"
    columns = ["--outputs", "angle", "--inputs", "torque", *OPTIONS[4:], "--window", 5]
    ran(capsys, "identify", table, *columns, "--out", file)
    now.write_text("\n".join(log(1, 11, np.random.default_rng(5))) + "\n")
    return file, now


def test_the_record_is_what_follows_on_each_other(read, tmp_path, capsys):
    file, now = read
    where = ["control", file, "--steps", 6, "--record"]
    whole = ran(capsys, *where, now, "--time", "t")["u"]
    lines = now.read_text().splitlines()
    cut = tmp_path / "cut.csv"

    def given(lines, *more):
        cut.write_text("\n".join(lines) + "\n")
        return [*where, cut, *more]

    # a gap that leaves five rows, or four
    assert np.allclose(ran(capsys, *given([*lines[:7], *lines[8:]], "--time", "t"))["u"], whole)
    short = given([*lines[:8], *lines[9:]], "--time", "t")
    assert "--record needs 5 rows of outputs and 4 of inputs" in failed(capsys, *short)
    missing = changed(lines, 7, 4, "")  # an input
    assert np.allclose(ran(capsys, *given(missing))["u"], whole)
    last = given(changed(lines, len(lines) - 1, 2, ""))
    assert "all outputs in its last row" in failed(capsys, *last)
    assert "'angle'" in failed(capsys, *given([lines[0].replace("angle", "a"), *lines[1:]]))
    assert "--from" in failed(capsys, *given(lines, "--from", "1"))
    assert "--steps must be 5 at least" in failed(capsys, *where[:2], "--record", now)
