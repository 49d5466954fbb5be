"""``python -m paper``: numbers, files that are left alone, runs that are stopped and continued."""

from __future__ import annotations

import ast
import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import paper
from paper import __main__ as program
from paper.experiments.replicate import Step
from paper.report import page

pytest.importorskip("matplotlib")
ROOT = Path(__file__).resolve().parents[2]
TINY = ["reproduce", "--quick", "--replicates", "2", "--samples", "12", "--seed", "3"]
TINY += ["--no-claims"]


def run(out: Path, *more: str) -> int:
    return program.run([*TINY, "--out", str(out), *more])


def numbers(out: Path) -> list[dict]:
    """All that was found, without the times."""
    assert not (out / "unfinished").exists()
    found = json.loads((out / "results.json").read_text())["experiments"]
    assert all(one.pop("seconds") > 0 for one in found)
    return found


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a run, and what it printed."""
    out, text = tmp_path_factory.mktemp("finished"), io.StringIO()
    with contextlib.redirect_stdout(text):
        assert run(out) == 0
    return out, text.getvalue()


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """The folder of a run that was interrupted after the first experiment."""

    def interrupted(**_):
        raise KeyboardInterrupt

    out = tmp_path_factory.mktemp("stopped") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(program, "tracking", interrupted)
        assert run(out) == 130
    return out


@pytest.fixture
def undrawn(monkeypatch):
    """Runs without pages and figures, which are 9/10 of the time: `test_report` has them."""
    monkeypatch.setattr(page, "save_figures", lambda *_: [])
    monkeypatch.setattr(page, "render", lambda *_, **__: "")


@pytest.fixture
def begun(stopped, tmp_path):
    return Path(shutil.copytree(stopped, tmp_path / "out"))


def test_a_report_with_its_table(finished):
    out, text = finished
    assert "exact rms" in text
    assert "3b  relative error of the state x(2)" in text
    assert {"report.html", "results.json", "power-figure-1.png"} <= set(os.listdir(out))


@pytest.mark.usefixtures("undrawn")
def test_any_number_of_workers_finds_the_same(finished, tmp_path):
    assert run(tmp_path / "two", "--workers", "2") == 0
    assert numbers(finished[0]) == numbers(tmp_path / "two")


@pytest.mark.usefixtures("undrawn")
def test_what_is_done_is_not_computed_again(begun, finished, monkeypatch):
    honest, sizes = Step.draw, []

    def sometimes(self, *args):
        sizes.append(len(self.x0))
        return honest(self, *args)

    monkeypatch.setattr(Step, "draw", sometimes)
    (begun / "unfinished" / "notes.txt").write_text("mine")
    assert run(begun, "--resume") == 0
    assert [path.name for path in (begun / "unfinished").iterdir()] == ["notes.txt"]
    (begun / "unfinished" / "notes.txt").unlink()
    (begun / "unfinished").rmdir()
    assert set(sizes) == {30}  # the states of the second experiment
    assert numbers(begun) == numbers(finished[0])


@pytest.mark.usefixtures("undrawn")
def test_another_run_and_a_damaged_list_of_options_are_refused(begun, capsys):
    before = {path: path.read_bytes() for path in begun.rglob("*") if path.is_file()}
    for options, text in (
        ([], "has an unfinished run: --resume or --force"),
        (["--resume", "--seed", "4"], "has other options"),
        (["--resume", "--claims"], "has other options"),
    ):
        assert run(begun, *options) == 1
        assert text in capsys.readouterr().err
    assert {path: path.read_bytes() for path in begun.rglob("*") if path.is_file()} == before
    for damaged in (b"", b"[1]", b"\xff"):
        (begun / "unfinished" / "options.json").write_bytes(damaged)
        assert run(begun, "--resume") == 1
    assert run(begun, "--force", "--seed", "4") == 0


@pytest.mark.usefixtures("undrawn")
def test_only_own_files_are_replaced(finished, tmp_path, capsys):
    out = Path(shutil.copytree(finished[0], tmp_path / "out"))
    assert run(out) == 0
    assert run(out, "--replicates", "3") == 1
    assert "results of other options" in capsys.readouterr().err
    for name in ("claims.png", "report.html"):
        kept = (out / name).read_bytes() if (out / name).exists() else None
        (out / name).write_text("mine")
        assert run(out, "--replicates", "3", "--force") == 1
        assert (out / name).read_text() == "mine"
        (out / name).unlink() if kept is None else (out / name).write_bytes(kept)
    assert run(out, "--replicates", "3", "--force") == 0


@pytest.mark.usefixtures("undrawn")
def test_a_killed_run_continues_with_the_same_numbers(tmp_path):
    options = ["reproduce", "--quick", "--no-claims", "--replicates", "8", "--samples", "30"]
    command = [sys.executable, "-m", "paper", *options, "--out", str(tmp_path / "out")]
    made = subprocess.Popen(command, cwd=ROOT, start_new_session=True)
    while not list(tmp_path.glob("out/unfinished/*.study")) and made.poll() is None:
        time.sleep(0.01)
    time.sleep(0.1)
    os.killpg(made.pid, signal.SIGKILL)
    made.wait()
    assert program.run([*options, "--out", str(tmp_path / "out"), "--resume"]) == 0
    assert program.run([*options, "--out", str(tmp_path / "fresh")]) == 0
    assert numbers(tmp_path / "out") == numbers(tmp_path / "fresh")


def test_claims_as_text_json_and_files(claimed, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(program, "checked_claims", lambda *_, **options: claimed[0])
    assert program.run(["claims", "--quick", "--out", str(tmp_path)]) == 0
    assert "all verdicts confirmed" in capsys.readouterr().out
    files = json.loads((tmp_path / "claims.json").read_text())["files"]
    assert set(files) == set(os.listdir(tmp_path)) == {"claims.json", "claims.png", "claims.svg"}
    (tmp_path / "claims.svg").write_text("mine")
    assert program.run(["claims", "--quick", "--out", str(tmp_path)]) == 1
    assert "claims.svg was changed since it was written" in capsys.readouterr().err
    monkeypatch.setattr(type(claimed[0]), "confirmed", False)
    assert program.run(["claims", "--quick", "--json"]) == 3


@pytest.mark.parametrize("options", [["--samples", "0"], ["--smaples", "3"], ["--seed", "-1"]])
def test_wrong_options(options, capsys):
    assert program.run(["reproduce", *options]) == 2


@pytest.mark.parametrize("terminal", [True, False])
def test_bars_are_for_terminals(terminal, monkeypatch):
    stderr = io.StringIO()
    stderr.isatty = lambda: terminal
    monkeypatch.setattr(sys, "stderr", stderr)
    paper.power(rng=1, replicates=2, samples=5, progress=True)
    assert ("power network" in stderr.getvalue()) == terminal


SOURCES = [path for path in (ROOT / "paper").rglob("*.py") if "tests" not in path.parts]


def test_only_public_rooms_of_the_package_are_used():
    public, used = {"stochens_rs"}, set()
    rooms = ["cases", "exceptions", "fusion", "plots", "rng", "theory"]
    public |= {f"stochens_rs.{room}" for room in rooms}
    public |= {"stochens_rs.theory.moments"}
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("stochens_rs"):
                used.add(node.module)
                assert not any(one.name.startswith("_") for one in node.names), path
            elif isinstance(node, ast.Import):
                used |= {one.name for one in node.names if one.name.startswith("stochens_rs")}
    assert used <= public
    package = (ROOT / "python" / "stochens_rs").rglob("*.py")
    assert not [path for path in package if "import paper" in path.read_text("utf-8")]
