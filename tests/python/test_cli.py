"""The command line: exit codes, one-line errors, and output that a program can read."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from stochens_rs import cli, experiments
from stochens_rs.exceptions import ResourceError, SolverError

TINY = ["reproduce", "--quick", "--no-claims", "--replicates", "2", "--samples", "12"]


def run(*args, **options):
    """The program in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "stochens_rs", *args],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        **options,
    )


def one_line(text):
    return text.startswith("stochens: ") and text.count("\n") == 1 and "Traceback" not in text


def test_quick_run_writes_a_report(tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    assert cli.main(TINY) == 0
    out = capsys.readouterr().out
    assert (tmp_path / "stochens-report" / "report.html").stat().st_size > 50_000
    assert (tmp_path / "stochens-report" / "results.json").exists()
    for word in ("1a", "2b", "3b-alternative", "uniform (diagonal)", "exact rms", "N = 12"):
        assert word in out


def test_json_and_nothing_else_on_stdout(tmp_path):
    pytest.importorskip("matplotlib")
    out = tmp_path / "deep" / "er"
    done = run(*TINY, "--json", "--out", str(out), "--seed", "7", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert data["seed"] == 7
    assert [one["name"] for one in data["experiments"]] == ["power", "tracking"]
    assert data["experiments"][0]["settings"]["samples"] == 12
    assert data["experiments"][1]["final"][0]["replicates"] == 2
    assert all(os.path.exists(path) for path in data["files"])
    assert "report.html" in done.stderr


def test_seed_determines_the_numbers(tmp_path, capsys, monkeypatch):
    pytest.importorskip("matplotlib")
    # Drawing takes most of the time, and is not the question here.
    monkeypatch.setattr(
        cli._reproduce.report, "write_report", lambda done, out, claims: [out / "report.html"]
    )
    seen = []
    for seed, folder in (("7", "a"), ("7", "b"), ("8", "c")):
        args = [*TINY, "--json", "--seed", seed, "--out", str(tmp_path / folder)]
        assert cli.main(args) == 0
        data = json.loads(capsys.readouterr().out)
        seen.append([one["final"] for one in data["experiments"]])
    assert seen[0] == seen[1]
    assert seen[0] != seen[2]


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (["reproduce", "--smaples", "3"], "--samples"),  # click says what was meant
        (["reproduce", "--samples", "0"], "--samples"),
        (["reproduce", "--samples", "many"], "many"),
        (["reproduce", "--seed", "-1"], "--seed"),
        (["reproduce", "--replicates", "1.5"], "--replicates"),
        (["reproduce", "extra"], "extra"),
        (["reproduce", "--out", ""], "--out"),
        (["reprduce"], "reprduce"),
        (["--nonsense"], "--nonsense"),
    ],
)
def test_usage_errors(args, word, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(args) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert one_line(captured.err)
    assert word in captured.err
    assert list(tmp_path.iterdir()) == []


def test_unwritable_place(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for target in (tmp_path / "file", tmp_path / "file" / "below"):
        assert cli.main(["reproduce", "--quick", "--out", str(target)]) == 5
        captured = capsys.readouterr()
        assert one_line(captured.err)
        assert "file" in captured.err
        assert captured.out == ""


@pytest.mark.parametrize(
    ("raised", "code"),
    [
        (KeyboardInterrupt(), 130),
        (OSError(28, "No space left on device", "results.json"), 5),
        (ResourceError("the indices need 9 GiB"), 2),
        (SolverError("no answer\nat all"), 1),
        (ZeroDivisionError("division by zero"), 1),
        (ImportError("figures need matplotlib"), 2),
    ],
)
def test_failures_become_exit_codes(raised, code, monkeypatch, capsys, tmp_path):
    def fail(**options):
        raise raised

    monkeypatch.setattr(experiments, "power", fail)
    assert cli.main(["reproduce", "--quick", "--out", str(tmp_path)]) == code
    err = capsys.readouterr().err.lstrip("\n")
    assert one_line(err), err


@pytest.mark.skipif(sys.platform == "win32", reason="signals differ")
def test_interrupt_ends_with_130(tmp_path):
    pytest.importorskip("matplotlib")
    out = tmp_path / "made when the computation starts"
    command = [sys.executable, "-m", "stochens_rs", "reproduce", "--replicates", "100000"]
    process = subprocess.Popen(
        [*command, "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # a shell's background jobs ignore SIGINT, and so would this one
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        deadline = time.monotonic() + 60
        while not out.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        stdout, stderr = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert stdout == ""
    assert "stochens: interrupted" in stderr
    assert "Traceback" not in stderr
    assert list(out.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="pipes differ")
def test_a_reader_who_leaves_early_causes_no_traceback():
    code = "import sys; from stochens_rs.cli import main; sys.exit(main(['info']))"
    read, write = os.pipe()
    os.close(read)
    try:
        done = subprocess.run(
            [sys.executable, "-c", code],
            stdout=write,
            stderr=subprocess.PIPE,
            text=True,
            timeout=60,
            check=False,
        )
    finally:
        os.close(write)
    assert done.returncode == 5
    assert "Traceback" not in done.stderr
    assert "BrokenPipe" not in done.stderr


def test_info(capsys):
    assert cli.main(["info"]) == 0
    text = capsys.readouterr().out
    for word in ("stochens_rs", "python", "numpy", "threads", "matplotlib"):
        assert word in text
    assert cli.main(["info", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["threads"] >= 1
    assert data["python"] == ".".join(map(str, sys.version_info[:3]))


def test_version_and_help(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("stochens ")
    for args in ([], ["--help"], ["-h"]):
        assert cli.main(args) == 0
        assert "reproduce" in capsys.readouterr().out
    assert cli.main(["reproduce", "--help"]) == 0
    text = capsys.readouterr().out
    for option in ("--out", "--seed", "--replicates", "--samples", "--quick", "--json"):
        assert option in text


def test_module_runs_as_a_program():
    done = run("--version")
    assert done.returncode == 0
    assert done.stdout.startswith("stochens ")
    assert run("nothing-like-this").returncode == 2
