"""``python -m paper``: numbers, files that are left alone, runs that are stopped and continued."""

from __future__ import annotations

import ast
import doctest
import importlib
import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import paper
from paper import __main__ as program
from paper.experiments.replicate import Step

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


@pytest.fixture
def begun(tmp_path, monkeypatch):
    """The folder of a run that was interrupted after the first experiment."""

    def interrupted(**_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(program, "tracking", interrupted)
        assert run(tmp_path / "out") == 130
    return tmp_path / "out"


def test_a_report_with_its_table(tmp_path, capsys):
    assert run(tmp_path) == 0
    text = capsys.readouterr().out
    assert "exact rms" in text
    assert "3b  relative error of the state x(2)" in text
    assert {"report.html", "results.json", "power-figure-1.png"} <= set(os.listdir(tmp_path))


def test_any_number_of_workers_finds_the_same(tmp_path):
    assert run(tmp_path / "one") == run(tmp_path / "two", "--workers", "2") == 0
    assert numbers(tmp_path / "one") == numbers(tmp_path / "two")


def test_what_is_done_is_not_computed_again(begun, tmp_path, monkeypatch):
    honest, sizes = Step.draw, []

    def sometimes(self, *args):
        sizes.append(len(self.x0))
        return honest(self, *args)

    with monkeypatch.context() as patch:
        patch.setattr(Step, "draw", sometimes)
        (begun / "unfinished" / "notes.txt").write_text("mine")
        assert run(begun, "--resume") == 0
    assert [path.name for path in (begun / "unfinished").iterdir()] == ["notes.txt"]
    (begun / "unfinished" / "notes.txt").unlink()
    (begun / "unfinished").rmdir()
    assert set(sizes) == {30}  # the states of the second experiment
    assert run(tmp_path / "fresh") == 0
    assert numbers(begun) == numbers(tmp_path / "fresh")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ([], "has an unfinished run: --resume or --force"),
        (["--resume", "--seed", "4"], "has other options"),
        (["--resume", "--claims"], "has other options"),
    ],
)
def test_another_run_is_refused(begun, options, text, capsys):
    before = {path: path.read_bytes() for path in begun.rglob("*") if path.is_file()}
    assert run(begun, *options) == 1
    assert text in capsys.readouterr().err
    assert {path: path.read_bytes() for path in begun.rglob("*") if path.is_file()} == before
    assert run(begun, "--force", "--seed", "4") == 0


@pytest.mark.parametrize("text", [b"", b"[1]", b"\xff"])
def test_a_damaged_list_of_options_is_refused(begun, text):
    (begun / "unfinished" / "options.json").write_bytes(text)
    assert run(begun, "--resume") == 1
    assert run(begun, "--force") == 0


def test_only_own_files_are_replaced(tmp_path, capsys):
    assert run(tmp_path) == 0
    assert run(tmp_path) == 0
    assert run(tmp_path, "--replicates", "3") == 1
    assert "results of other options" in capsys.readouterr().err
    assert run(tmp_path, "--replicates", "3", "--force") == 0
    for name in ("claims.png", "report.html"):
        (tmp_path / name).write_text("mine")
        assert run(tmp_path, "--replicates", "3", "--force") == 1
        assert (tmp_path / name).read_text() == "mine"
        (tmp_path / name).unlink()


def test_a_killed_run_continues_with_the_same_numbers(tmp_path):
    command = [sys.executable, "-m", "paper", "reproduce", "--quick", "--no-claims"]
    command += ["--replicates", "8", "--samples", "30", "--out"]
    made = subprocess.Popen([*command, str(tmp_path / "out")], cwd=ROOT, start_new_session=True)
    while not list(tmp_path.glob("out/unfinished/*.study")) and made.poll() is None:
        time.sleep(0.01)
    time.sleep(0.1)
    os.killpg(made.pid, signal.SIGKILL)
    made.wait()
    subprocess.run([*command, str(tmp_path / "out"), "--resume"], cwd=ROOT, check=True)
    subprocess.run([*command, str(tmp_path / "fresh")], cwd=ROOT, check=True)
    assert numbers(tmp_path / "out") == numbers(tmp_path / "fresh")


def test_claims_as_text_json_and_files(tmp_path, capsys, monkeypatch):
    assert program.run(["claims", "--quick", "--out", str(tmp_path)]) == 0
    assert "all verdicts confirmed" in capsys.readouterr().out
    files = json.loads((tmp_path / "claims.json").read_text())["files"]
    assert set(files) == set(os.listdir(tmp_path)) == {"claims.json", "claims.png", "claims.svg"}
    (tmp_path / "claims.svg").write_text("mine")
    assert program.run(["claims", "--quick", "--out", str(tmp_path)]) == 1
    assert "claims.svg was changed since it was written" in capsys.readouterr().err
    monkeypatch.setattr(type(program.checked_claims(quick=True)), "confirmed", False)
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
    paper.claims(quick=True, progress=True)
    for word in ("power network", "claims"):
        assert (word in stderr.getvalue()) == terminal


SOURCES = [path for path in (ROOT / "paper").rglob("*.py") if "tests" not in path.parts]


def test_only_public_rooms_of_the_package_are_used():
    public, used = {"stochens_rs"}, set()
    public |= {f"stochens_rs.{room}" for room in ["cases", "exceptions", "plots", "rng", "theory"]}
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


@pytest.mark.parametrize("path", [p for p in SOURCES if ">>>" in p.read_text("utf-8")], ids=str)
def test_examples_print_what_they_say(path):
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    options = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    found = doctest.testmod(importlib.import_module(name), optionflags=options)
    assert found.attempted > 0
    assert found.failed == 0
