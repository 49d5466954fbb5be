"""`stochens reproduce`: processes, interruptions at any time, and how an unfinished run goes on."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from stochens_rs import cli
from stochens_rs._base import state_file
from stochens_rs.paper.experiments.power import PowerErrors

pytest.importorskip("matplotlib")

# Drawing takes most of the time, and is not the question here.
PROGRAM = """
import json, sys
from stochens_rs import cli, paper

def write(done, out, claims, options):
    found = {"experiments": [one.to_dict() for one in done], "claims": claims and claims.to_dict()}
    (out / "numbers.json").write_text(json.dumps(found))
    return [out / "numbers.json"]

if __name__ == "__main__":
    def power(*args, _power=paper.power, **options):
        open(__file__ + ".started", "w").close()
        return _power(*args, **options)

    paper.write_report, paper.power = write, power
    sys.exit(cli.main(sys.argv[1:]))
"""
QUICK = ["reproduce", "--quick", "--replicates", "40", "--samples", "200"]


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    return path


def start(program: Path, out: Path, *args: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(program), *QUICK, "--out", str(out), *args],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def numbers(out: Path) -> Any:
    """All that was found, without the times."""
    assert not (out / "unfinished").exists()
    found = json.loads((out / "numbers.json").read_text())
    assert all(one.pop("seconds") > 0 for one in found["experiments"])
    return found


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("undisturbed")
    program = folder / "program.py"
    program.write_text(PROGRAM)
    made = start(program, folder / "out")
    _, told = made.communicate(timeout=300)
    assert made.returncode == 0, told
    return numbers(folder / "out")


def test_any_number_of_workers_finds_the_same(
    program: Path, tmp_path: Path, undisturbed: Any
) -> None:
    made = start(program, tmp_path / "out", "--workers", "2")
    _, told = made.communicate(timeout=300)
    assert made.returncode == 0, told
    assert numbers(tmp_path / "out") == undisturbed


@pytest.mark.skipif(sys.platform == "win32", reason="signals differ")
@pytest.mark.parametrize(
    ("number", "code", "workers"),
    [
        (signal.SIGINT, 130, "1"),
        (signal.SIGTERM, 143, "1"),
        (signal.SIGKILL, -9, "1"),
        (signal.SIGINT, 130, "2"),
    ],
)
def test_an_interruption_at_any_time_loses_nothing(
    program: Path, tmp_path: Path, undisturbed: Any, number: int, code: int, workers: str
) -> None:
    # interrupted at a random time; then it runs to its end
    times = random.Random(f"{number} {workers}")
    out, codes = tmp_path / "out", []
    started = Path(f"{program}.started")
    for attempt in range(2):
        started.unlink(missing_ok=True)
        made = start(program, out, "--resume", "--workers", workers)
        try:
            while not started.exists() and made.poll() is None:
                time.sleep(0.01)
            if attempt < 1:
                time.sleep(times.uniform(0.0, 2.4))
                os.killpg(made.pid, number)  # as a terminal does: the workers as well
        except ProcessLookupError:
            pass  # it was done
        said, told = made.communicate(timeout=300)
        codes.append(0 if said else made.returncode)  # 0: it was interrupted after its last line
        if codes[-1] == 0:
            break
        assert "Traceback" not in told
        assert number == signal.SIGKILL or "stochens: interrupted" in told
    assert set(codes[:-1]) <= {code}
    assert codes[-1] == 0
    assert numbers(out) == undisturbed


@pytest.fixture
def begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The directory of a run with seed 3 that was interrupted after the first experiment."""
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(cli._reproduce.paper, "tracking", _interrupted)
        assert cli.main([*TINY, "--out", str(out)]) == 130
    assert {path.name for path in (out / "unfinished").iterdir()} >= {"options.json", "power.study"}
    return out


TINY = ["reproduce", "--quick", "--replicates", "2", "--samples", "12", "--seed", "3"]
TINY += ["--no-claims"]


def _interrupted(**_: Any) -> None:
    raise KeyboardInterrupt


def test_what_is_done_is_not_computed_again(
    begun: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = begun / "unfinished" / "notes.txt"
    mine.write_text("mine")

    def fail(*_: Any) -> None:
        raise AssertionError

    with monkeypatch.context() as patch:
        patch.setattr(PowerErrors, "__call__", fail)
        assert cli.main([*TINY, "--out", str(begun), "--resume"]) == 0
    assert "continuing the run in" in capsys.readouterr().err
    assert (begun / "report.html").exists()
    assert list((begun / "unfinished").iterdir()) == [mine]
    assert cli.main([*TINY, "--out", str(begun), "--resume"]) == 0  # nothing to continue


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "has an unfinished run: --resume continues it, --force starts afresh"),
        (["--seed", "4"], "has an unfinished run"),
        (["--resume", "--seed", "4"], "--seed of the unfinished run in"),
        (["--resume", "--force", "--samples", "13"], "--samples of the unfinished run in"),
        (["--resume", "--replicates", "3"], "is 2, got 3"),
        (["--resume", "--claims"], "--claims of the unfinished run in"),
    ],
)
def test_another_run_is_refused(
    begun: Path, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in begun.rglob("*") if path.is_file()}
    assert cli.main([*TINY, "--out", str(begun), *options]) == 2
    told = capsys.readouterr().err.splitlines()
    assert told[-1].startswith("stochens: ")
    assert said in told[-1]
    assert {path: path.read_bytes() for path in begun.rglob("*") if path.is_file()} == before


def test_force_starts_afresh(begun: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*TINY, "--out", str(begun), "--force", "--seed", "4"]) == 0
    assert "starting afresh: the unfinished run in" in capsys.readouterr().err
    assert json.loads((begun / "results.json").read_text())["options"]["seed"] == 4
    assert not (begun / "unfinished").exists()


@pytest.mark.parametrize("text", [b"", b"[1]", b"\xff", b'{"seed": 3}'])
def test_a_damaged_list_of_options_is_refused(
    begun: Path, text: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    (begun / "unfinished" / "options.json").write_bytes(text)
    assert cli.main([*TINY, "--out", str(begun), "--resume"]) == 2
    assert "starts afresh" in " ".join(capsys.readouterr().err.split()) or text == b'{"seed": 3}'
    assert cli.main([*TINY, "--out", str(begun), "--force"]) == 0


def test_two_runs_at_once_are_refused(begun: Path, capsys: pytest.CaptureFixture[str]) -> None:
    held = state_file.lock(str(begun / "unfinished" / "run"))
    try:
        for options in (["--resume"], ["--force"]):
            assert cli.main([*TINY, "--out", str(begun), *options]) == 5
            told = capsys.readouterr().err
            assert told.startswith("stochens: ")
            assert "unfinished" in told
    finally:
        held.release()
    assert cli.main([*TINY, "--out", str(begun), "--resume"]) == 0
