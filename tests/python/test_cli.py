"""The command line: exit codes, one-line errors, and output that a program can read."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import zipfile

import pytest

import stochens_rs as se
from stochens_rs import cli
from stochens_rs.exceptions import ResourceError, SolverError

SYSTEM = {"A": [[0.9, 0.2], [0.0, 0.8]], "B": [[0.0], [1.0]], "x0": [1.0, 0.0]}


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """A directory with a system, which is the current one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "system.json").write_text(json.dumps(SYSTEM))


TINY = ["control", "system.json", "--steps", "2"]


def run(*args, **options):
    """The program in its own process."""
    return subprocess.run(
        [sys.executable, "-m", "stochens_rs", *args],
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options},
        text=True,
        timeout=120,
        check=False,
    )


def one_line(text):
    return text.startswith("stochens: ") and text.count("\n") == 1 and "Traceback" not in text


def test_json_and_nothing_else_on_stdout(tmp_path, capfd):
    pytest.importorskip("matplotlib")
    out = tmp_path / "deep" / "er"
    assert cli.main([*TINY, "--json", "--out", str(out)]) == 0
    shown = capfd.readouterr()
    assert json.loads((out / "control.json").read_text()) == json.loads(shown.out)
    assert "control.json" in shown.err


@pytest.mark.parametrize(
    ("args", "word"),
    [
        ([*TINY, "--stpes", "3"], "--steps"),  # click says what was meant
        (["control", "system.json", "--steps", "0"], "--steps"),
        (["control", "system.json", "--steps", "1.5"], "--steps"),
        ([*TINY, "extra"], "extra"),
        ([*TINY, "--out", ""], "--out"),
        ([*TINY, "--delta", "5"], "'--delta': 5 is 500 %: give 5%"),
        ([*TINY, "--delta", "1"], "'--delta': 1 is 100 %: give 1%"),
        (["identify", "x.csv", "--seed", "-1"], "--seed"),
        (["contrl"], "contrl"),
        (["reproduce"], "reproduce"),  # a program of its own: `python -m paper`
        (["--nonsense"], "--nonsense"),
    ],
)
def test_usage_errors(args, word, capsys, tmp_path):
    assert cli.main(args) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert one_line(captured.err)
    assert word in captured.err
    assert [path.name for path in tmp_path.iterdir()] == ["system.json"]


def test_unwritable_place(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for target in (tmp_path / "file", tmp_path / "file" / "below"):
        assert cli.main([*TINY, "--out", str(target)]) == 5
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
def test_failures_become_exit_codes(raised, code, monkeypatch, capsys):
    def fail(*_, **options):
        raise raised

    monkeypatch.setattr(cli._control, "control", fail)
    assert cli.main(TINY) == code
    err = capsys.readouterr().err.lstrip("\n")
    assert one_line(err), err


@pytest.mark.skipif(sys.platform == "win32", reason="pipes differ")
def test_a_reader_who_leaves_early_causes_no_traceback():
    read, write = os.pipe()
    os.close(read)
    try:
        done = run("doctor", stdout=write)
    finally:
        os.close(write)
    assert done.returncode == 5
    assert "Traceback" not in done.stderr
    assert "BrokenPipe" not in done.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no full device")
def test_a_full_disk_behind_standard_output_is_named():
    with open("/dev/full", "w") as full:
        done = run("doctor", stdout=full)
    assert done.returncode == 5
    assert done.stderr == ("stochens: cannot write to standard output: No space left on device\n")


def test_version_and_help(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("stochens ")
    for args in ([], ["--help"], ["-h"]):
        assert cli.main(args) == 0
        assert "identify" in capsys.readouterr().out


@pytest.mark.parametrize("terminal", [True, False])
def test_bars_are_for_terminals(terminal, monkeypatch):
    class Stderr(io.StringIO):
        def isatty(self):
            return terminal

    monkeypatch.setattr(sys, "stderr", Stderr())
    stream = se.Stream(([[2.0]], [[1.0]]), [1.0], [0.0], rng=1)
    stream.run(max_steps=10, progress=True)
    seen = sys.stderr.getvalue()
    assert ("stream" in seen) == terminal
    assert terminal or seen == ""


def closed(*numbers):
    """Options of `run` that close these descriptors, as ``2>&-`` does."""
    return {
        "preexec_fn": lambda: [os.close(number) for number in numbers],
        "stdout": None if 1 in numbers else subprocess.PIPE,
        "stderr": None if 2 in numbers else subprocess.PIPE,
    }


@pytest.mark.skipif(sys.platform == "win32", reason="descriptors differ")
@pytest.mark.parametrize("numbers", [(1,), (0, 1, 2)])
def test_closed_stdout_is_refused_before_anything_is_done(numbers, tmp_path):
    out = tmp_path / "out"
    done = run(*TINY, "--out", str(out), **closed(*numbers))
    assert done.returncode == 5
    if 2 not in numbers:
        assert done.stderr == "stochens: standard output is closed: nowhere to write results\n"
    assert not out.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="descriptors differ")
def test_closed_stderr_changes_nothing():
    done = run(*TINY, **closed(0, 2))
    assert done.returncode == 0
    assert "at the target" in done.stdout
    assert run("nonsense", **closed(2)).returncode == 2


@pytest.mark.skipif(not os.path.exists("/proc/self/fd"), reason="needs /proc")
def test_no_file_takes_the_place_of_a_closed_descriptor():
    """Text that a library prints to descriptor 2 must not get into a file of results."""
    code = (
        "import os; from stochens_rs.cli import main; main(['doctor'])\n"
        "print(*(os.path.realpath(f'/proc/self/fd/{number}') for number in (0, 2)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], text=True, check=True, timeout=60, **closed(0, 2)
    )
    assert done.stdout.splitlines()[-1] == "/dev/null /dev/null"


@pytest.mark.skipif(sys.platform == "win32", reason="devices differ")
def test_files_without_end(tmp_path):
    import resource

    os.mkfifo(tmp_path / "pipe")
    for number, path in enumerate(("/dev/zero", tmp_path / "pipe", tmp_path)):
        (tmp_path / f"{number}.npz").symlink_to(path)
    with (tmp_path / "huge.json").open("wb") as file:
        file.truncate(2**40)
    os.link(tmp_path / "huge.json", tmp_path / "huge.npz")
    names = ["/dev/zero", "pipe", "0.npz", "1.npz", "2.npz", "huge.json", "huge.npz"]
    code = (
        "import sys; from stochens_rs.cli import main\n"
        "print([main(['control', name]) for name in sys.argv[1:]])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *names],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=20,
        check=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (2**32, 2**32)),
    )
    assert done.stdout == f"{[2] * len(names)}\n"
    said = done.stderr.splitlines()
    assert all("must be a regular file, got a" in line for line in said[:5]), said
    assert all("needs" in line and "GiB" in line for line in said[5:]), said


def test_an_archive_that_unpacks_to_more_than_there_is(tmp_path, capsys):
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("A.npy", b"0" * 100)
        archive.getinfo("A.npy").file_size = 2**50  # the directory, written on closing, says so
    assert cli.main(["control", str(tmp_path / "bomb.npz")]) == 2
    err = capsys.readouterr().err
    assert one_line(err)
    assert "GiB" in err


def test_files_are_replaced_with_force_only(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    line = [*TINY, "--out", str(tmp_path)]
    (tmp_path / "control.svg").write_text("mine")
    assert cli.main(line) == 2
    err = capsys.readouterr().err
    assert one_line(err)
    assert "control.svg exists: give another --out, or --force" in err
    assert (tmp_path / "control.svg").read_text() == "mine"
    assert cli.main([*line, "--force"]) == 0
    assert capsys.readouterr().err.count("written: ") == 3
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"system.json", "control.json", "control.png", "control.svg"}
