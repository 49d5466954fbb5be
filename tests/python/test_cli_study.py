"""`stochens study`, and the function that it runs."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import cli
from stochens_rs.cli import _workers
from stochens_rs.cli._output import grid
from stochens_rs.exceptions import InputError, ShapeError

A, B = np.array([[0.9, 0.2, 0.0], [0.1, 0.8, 0.3], [0.0, 0.1, 0.7]]), np.eye(3)[:, 1:]
X0, XF = np.array([1.0, -1.0, 2.0]), np.array([0.0, 0.5, 1.0])
SIZES = np.array([5, 40, 200])


@pytest.fixture
def problem(tmp_path: Path) -> str:
    path = tmp_path / "problem.json"
    values = {"A": A, "B": B, "x0": X0, "xf": XF}
    path.write_text(json.dumps({name: value.tolist() for name, value in values.items()}))
    return str(path)


def run(capsys: pytest.CaptureFixture[str], *args: str) -> tuple[int, dict[str, object], str]:
    code = cli.main(["study", *args, "--json"])
    said = capsys.readouterr()
    return code, json.loads(said.out) if said.out else {}, said.err


def test_what_is_zero_has_no_relative_error() -> None:
    function = se.studies.error((A, B), X0, np.zeros(3))
    assert set(function(se.Key(bytes(32)), size=SIZES, method="uniform")) == {
        "x0",
        "A",
        "control",
        "state",
    }
    again = pickle.loads(pickle.dumps(function))
    assert np.array_equal(
        again(se.Key(bytes(32)), size=SIZES, method="alse")["A"],
        function(se.Key(bytes(32)), size=SIZES, method="alse")["A"],
    )
    with pytest.raises(InputError, match="one of `system`, `x0` and `xf` must not be 0"):
        se.studies.error((np.zeros((3, 3)), B), np.zeros(3), np.zeros(3))
    with pytest.raises(ShapeError, match="`x0` must have shape"):
        se.studies.error((A, B), X0[:2], XF)


def test_the_same_command_goes_on(
    problem: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    path = str(tmp_path / "a.study")
    args = [problem, "--sizes", "5:200:log3", "--methods", "uniform,slse", "--seed", "4"]
    _, whole, _ = run(capsys, *args, "--replicates", "40")
    assert whole["status"] == "completed"
    code, first, _ = run(capsys, *args, "--replicates", "7", "--checkpoint", path)
    assert code == 0
    assert first["digest"] != whole["digest"]
    saved = tmp_path / "all.json"
    _, second, _ = run(
        capsys,
        *args,
        "--replicates",
        "40",
        "--checkpoint",
        path,
        "--workers",
        "2",
        "--out",
        str(saved),
    )
    assert second["digest"] == whole["digest"]
    assert json.loads(saved.read_text())["grid"]["size"] == [5, 32, 200]
    code, _, told = run(capsys, *args[:-1], "5", "--replicates", "40", "--checkpoint", path)
    assert code == 5
    assert told.startswith("stochens: `key` of ")
    code = cli.main(["study", *args, "--replicates", "40", "--checkpoint", path])
    text = capsys.readouterr().out.splitlines()
    assert text[0].startswith("completed: 240 of 240 replicates")
    assert len(text) == 2 + 2 * 6


def test_figures_and_facts_are_written(
    problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "out"
    args = [problem, "--sizes", "5,50", "--replicates", "5", "--out", str(out)]
    code, facts, told = run(capsys, *args)
    assert code == 0
    written = json.loads((out / "study.json").read_text())
    assert written["digest"] == facts["digest"]
    assert set(written["files"]) == {"study.json", "study.png", "study.svg"}
    assert told.count("written: ") == 3


# The command, which sends a signal to itself and its workers, as a terminal does, when so many
# blocks are there.
INTERRUPTED = """
import os, sys
from stochens_rs import cli
from stochens_rs.cli import _workers
from stochens_rs.studies.store import Table

def add(table, block, _add=Table.add, _seen=[]):
    _add(table, block)
    _seen.append(block)
    if len(_seen) == 5:
        os.killpg(0, int(sys.argv[1]))

if __name__ == "__main__":
    Table.add = add
    sys.exit(cli.main(sys.argv[2:]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="SIGINT cannot be sent on Windows")
@pytest.mark.parametrize(
    ("workers", "number", "code"),
    [("1", signal.SIGINT, 130), ("2", signal.SIGINT, 130), ("1", signal.SIGTERM, 143)],
)
def test_ctrl_c_loses_nothing(
    problem: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    workers: str,
    number: int,
    code: int,
) -> None:
    path, script = tmp_path / "a.study", tmp_path / "script.py"
    script.write_text(INTERRUPTED)
    args = [problem, "--sizes", "5,20", "--replicates", "400", "--checkpoint", str(path)]
    command = [sys.executable, str(script), str(number), "study", *args, "--workers", workers]
    done = subprocess.run(
        [*command, "--json"], capture_output=True, text=True, start_new_session=True, timeout=300
    )
    assert done.returncode == code, done.stderr
    facts = json.loads(done.stdout)
    assert facts["status"] == "interrupted"
    assert "Traceback" not in done.stderr
    kept = int(se.Study.resume(path).results.done.sum())
    assert 0 < kept < 1600
    assert sum(facts["summary"]["done"][:4]) == kept
    _, resumed, _ = run(capsys, *args)
    _, whole, _ = run(capsys, *args[:-2])
    assert resumed["digest"] == whole["digest"]


# A pool whose workers are busy, or wait for work; it prints who they are.
POOL = """
import os, sys, time
from stochens_rs.cli._workers import pool

if __name__ == "__main__":
    made = pool(2)
    print(made.submit(os.getpid).result(), *made._processes, flush=True)
    made.submit(time.sleep, 60.0)
    time.sleep(60.0)
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes of Linux")
def test_no_worker_outlives_the_command(tmp_path: Path) -> None:
    script = tmp_path / "pool.py"
    script.write_text(POOL)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as made:
        assert made.stdout is not None
        workers = {int(pid) for pid in made.stdout.readline().split()}
        assert len(workers) == 2
        assert all(map(lives, workers))
        made.kill()
    end = time.monotonic() + 20.0
    while any(map(lives, workers)) and time.monotonic() < end:
        time.sleep(0.05)
    left = [pid for pid in workers if lives(pid)]
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert not left


def lives(pid: int) -> bool:
    """Whether it runs; one that has ended may wait for its parent to notice."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_what_did_not_get_to_its_end_has_an_exit_code_of_its_own(
    problem: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    args = [
        problem,
        "--sizes",
        "5",
        "--replicates",
        "40",
        "--checkpoint",
        str(tmp_path / "a.study"),
    ]
    code, facts, told = run(capsys, *args, "--time-limit", "1e-9")
    assert (code, facts["status"]) == (4, "time_limit")
    assert "the same command continues" in told

    class Dead(ThreadPoolExecutor):
        def submit(self, fn, /, *args, **kwargs):  # type: ignore[no-untyped-def]
            raise BrokenExecutor

    monkeypatch.setattr(_workers, "pool", lambda workers: Dead(workers))
    code, facts, told = run(capsys, *args, "--workers", "2")
    assert (code, facts["status"]) == (6, "workers_lost")
    code, facts, _ = run(capsys, *args)
    assert (code, facts["status"]) == (0, "completed")
    assert cli.main(["stream", "--case", "ieee14", "--tol", "1e-9%", "--time-limit", "1e-9"]) == 4
    capsys.readouterr()
    for command, codes in (("study", ("4 time limit", "6 workers lost")), ("stream", ("4 time",))):
        assert cli.main([command, "--help"]) == 0
        said = " ".join(capsys.readouterr().out.split())
        assert all(one in said for one in codes)


@pytest.mark.parametrize(
    ("args", "code", "word"),
    [
        (["--sizes", "5,3"], 2, "--sizes"),
        (["--sizes", "1:1000"], 2, "--sizes"),
        (["--sizes", "1:1000:lin"], 2, "--sizes"),
        (["--sizes", "0,5"], 2, "--sizes"),
        (["--sizes", "1:1e12:log"], 2, "--sizes"),
        (["--methods", "uniform,uniform"], 2, "--methods"),
        (["--methods", "ales"], 2, "'ales'"),
        (["--workers", "0"], 2, "--workers"),
        (["--time-limit", "0"], 2, "--time-limit"),
        (["--checkpoint", "no/such/folder/a.study"], 5, "no/such/folder"),
    ],
)
def test_bad_options(
    problem: str, args: list[str], code: int, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["study", problem, "--replicates", "2", *args]) == code
    told = capsys.readouterr().err
    assert word in told
    assert told.count("\n") == 1


def test_a_missing_dask_is_named(
    problem: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert cli.main(["study", problem, "--dask", "tcp://127.0.0.1:1"]) == 2
    assert "stochens_rs[dask]" in capsys.readouterr().err


def test_a_narrow_terminal_gets_tables_with_the_same_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [["name", "size", "mean", "median"], ["state", "10", "0.25", "0.125"]]
    wide = ["name   size  mean  median", "state    10  0.25   0.125"]
    monkeypatch.setenv("COLUMNS", "25")
    assert grid(rows, keys=2) == wide
    monkeypatch.setenv("COLUMNS", "20")
    narrow = [*(line[:17] for line in wide), "", *(line[:11] + line[17:] for line in wide)]
    assert grid(rows, keys=2) == narrow
