"""The command line: exit codes, one-line errors, and output that a program can read."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
import zipfile

import pytest

import stochens_rs as se
from stochens_rs import cli, paper
from stochens_rs.exceptions import ResourceError, SolverError

TINY = ["reproduce", "--quick", "--no-claims", "--replicates", "2", "--samples", "12"]


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
        cli._reproduce.paper, "write_report", lambda done, out, **_: [out / "report.html"]
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

    monkeypatch.setattr(paper, "power", fail)
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
        deadline = time.monotonic() + 200
        begun = out / "unfinished" / "power.study"
        while not begun.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        stdout, stderr = process.communicate(timeout=200)
    finally:
        process.kill()
    assert process.returncode == 130
    assert stdout == ""
    assert "stochens: interrupted" in stderr
    assert "Traceback" not in stderr
    assert [path.name for path in out.iterdir()] == ["unfinished"]


@pytest.mark.skipif(sys.platform == "win32", reason="pipes differ")
def test_a_reader_who_leaves_early_causes_no_traceback():
    code = "import sys; from stochens_rs.cli import main; sys.exit(main(['doctor']))"
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


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no full device")
def test_a_full_disk_behind_standard_output_is_named():
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "stochens_rs", "doctor"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=60,
            check=False,
        )
    assert done.returncode == 5
    assert done.stderr == ("stochens: cannot write to standard output: No space left on device\n")


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="no such files")
def test_what_is_no_regular_file_is_named_as_given(tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe")
    for path, said in (
        ("/dev/zero", "/dev/zero must be a regular file, got a device"),
        (str(tmp_path), f"{tmp_path} must be a regular file, got a directory"),
        (str(tmp_path / "pipe"), "got a pipe: save it to a file first"),
    ):
        assert cli.main(["plan", "--file", path]) == 2
        err = capsys.readouterr().err
        assert one_line(err)
        assert said in err


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


@pytest.mark.parametrize("terminal", [True, False])
def test_bars_are_for_terminals(terminal, monkeypatch):
    class Stderr(io.StringIO):
        def isatty(self):
            return terminal

    monkeypatch.setattr(sys, "stderr", Stderr())
    paper.power(rng=1, replicates=2, samples=5, progress=True)
    se.paper.claims(quick=True, progress=True)
    stream = se.Stream(([[2.0]], [[1.0]]), [1.0], [0.0], rng=1)
    stream.run(max_steps=10, progress=True)
    seen = sys.stderr.getvalue()
    for word in ("power network", "claims", "stream"):
        assert (word in seen) == terminal
    assert terminal or seen == ""


def closed(*numbers):
    """Options of `run` that close these descriptors, as ``2>&-`` does."""
    return {
        "preexec_fn": lambda: [os.close(number) for number in numbers],
        "stdout": None if 1 in numbers else subprocess.PIPE,
        "stderr": None if 2 in numbers else subprocess.PIPE,
    }


@pytest.mark.skipif(sys.platform == "win32", reason="descriptors differ")
@pytest.mark.parametrize("numbers", [(1,), (1, 2), (0, 1)])
def test_closed_stdout_is_refused_before_anything_is_done(numbers, tmp_path):
    out = tmp_path / "out"
    done = run(*TINY, "--out", str(out), **closed(*numbers))
    assert done.returncode == 5
    if 2 not in numbers:
        assert done.stderr == "stochens: standard output is closed: nowhere to write results\n"
    assert not out.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="descriptors differ")
@pytest.mark.parametrize("numbers", [(2,), (0, 2)])
def test_closed_stderr_changes_nothing(numbers, tmp_path):
    saved = tmp_path / "a.state"
    done = run(
        *("stream", "--case", "ieee14", "--max-steps", "10", "--checkpoint", str(saved)),
        **closed(*numbers),
    )
    assert done.returncode == 0
    assert "max_steps after 10 steps" in done.stdout
    assert se.Stream.load(saved).steps == 10
    assert run("nonsense", **closed(*numbers)).returncode == 2


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


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_stderr_without_room_does_not_change_the_exit_code(tmp_path):
    with open("/dev/full", "w") as full:
        assert run("nonsense", stdout=subprocess.PIPE, stderr=full).returncode == 2


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
        "print([main(['plan', '--file', name]) for name in sys.argv[1:]])"
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
    assert cli.main(["plan", "--file", str(tmp_path / "bomb.npz")]) == 2
    err = capsys.readouterr().err
    assert one_line(err)
    assert "GiB" in err


@pytest.mark.parametrize(
    "text", ['{"A": [[1]], "B": [[1]], "A": [[2]]}', '{"A": {"b": 1, "b": 2}}']
)
def test_an_entry_that_is_there_twice(text, tmp_path, capsys):
    path = tmp_path / "p.json"
    path.write_text(text)
    assert cli.main(["plan", "--file", str(path)]) == 2
    err = capsys.readouterr().err
    assert one_line(err)
    assert "twice" in err


def test_reproduce_replaces_only_its_own_report(tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    out, again = tmp_path / "stochens-report", TINY
    assert cli.main(again) == 0
    said = capsys.readouterr().out
    for word in ("1a", "2b", "3b-alternative", "uniform (diagonal)", "exact rms", "N = 12"):
        assert word in said
    assert (out / "report.html").stat().st_size > 50_000
    written = {path.name for path in out.iterdir()}
    listed = json.loads((out / "results.json").read_text())["files"]
    assert set(listed) == written

    (out / "notes.txt").write_text("mine")  # not in the way
    assert cli.main(again) == 0
    assert "the results of a run with the same options" in capsys.readouterr().err

    assert cli.main([*again, "--seed", "2"]) == 2
    err = capsys.readouterr().err
    assert one_line(err)
    assert "--force" in err
    assert "seed=1" in err

    (out / "claims.png").write_text("mine, too")
    for options in ([], ["--force"]):
        assert cli.main([*again, "--claims", *options]) == 2
        err = capsys.readouterr().err
        assert one_line(err)
        assert "claims.png" in err
    assert (out / "claims.png").read_text() == "mine, too"

    (out / "claims.png").unlink()
    page = out / "report.html"
    edited = page.read_text() + "<!-- my remark -->"
    page.write_text(edited)
    for options in ([], ["--force"]):
        assert cli.main([*again, "--seed", "2", *options]) == 2
        err = capsys.readouterr().err
        assert one_line(err)
        assert "report.html was changed since this command wrote it" in err
    assert page.read_text() == edited
    page.unlink()  # a part of the report may be gone
    assert cli.main([*again, "--seed", "2", "--force"]) == 0
    assert {path.name for path in out.iterdir()} == {*written, "notes.txt"}
    assert json.loads((out / "results.json").read_text())["options"]["seed"] == 2


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["plan", "--error", "5"], "--error: 5 is 500 %: give 5%"),
        (["plan", "--error", "1"], "--error: 1 is 100 %: give 1%"),
        (["plan", "--delta", "5"], "--delta: 5 is 500 %: give 5%"),
        (["plan", "--delta", "100%"], "--delta must be in (0, 1)"),
        (["stream", "--tol", "5"], "--tol: 5 is 500 %: give 5%"),
    ],
)
def test_a_share_of_one_and_more_needs_its_percent(args, said, capsys):
    assert cli.main([*args, "--case", "ieee14"]) == 2
    err = capsys.readouterr().err
    assert one_line(err)
    assert said in err


def test_shares_in_percent(capsys):
    plan = ["plan", "--case", "ieee14", "--runs", "20", "--json"]
    said = []
    for options in (
        ["--error", "5%", "--delta", "1%"],
        ["--error", "0.05", "--delta", "0.01"],
        ["--error", "500%"],
        ["--error", "5", "--absolute"],
    ):
        assert cli.main([*plan, *options]) == 0
        said.append(json.loads(capsys.readouterr().out))
    assert said[0] == said[1]
    assert said[0]["delta"] == 0.01
    assert said[2]["relative_error"] == pytest.approx(5.0)
    assert said[3]["error"] == 5.0


def test_claims_replaces_only_its_own_files(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    claims = ["claims", "--quick", "--out", str(tmp_path)]
    (tmp_path / "claims.svg").write_text("mine")
    assert cli.main(claims) == 2
    assert "claims.svg was not written by this command" in capsys.readouterr().err
    (tmp_path / "claims.svg").unlink()

    assert cli.main(claims) == 0
    index = json.loads((tmp_path / "claims.json").read_text())
    written = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(index["files"]) == set(written) == {"claims.json", "claims.png", "claims.svg"}
    assert index["confirmed"] is True
    capsys.readouterr()

    assert cli.main([*claims, "--seed", "2"]) == 2
    err = capsys.readouterr().err
    assert one_line(err)
    assert "seed=1" in err
    assert "--force" in err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == written

    assert cli.main([*claims, "--seed", "2", "--force"]) == 0
    (tmp_path / "claims.png").write_text("mine")
    assert cli.main([*claims, "--seed", "2", "--force"]) == 2
    assert "claims.png was changed" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["", "[]", '{"schema": "stochens-results/1"}', '{"files": 3}'])
def test_reproduce_leaves_foreign_results_alone(text, tmp_path, capsys):
    (tmp_path / "results.json").write_text(text)
    assert cli.main([*TINY, "--out", str(tmp_path), "--force"]) == 2
    assert "results.json" in capsys.readouterr().err
    assert (tmp_path / "results.json").read_text() == text
    assert len(list(tmp_path.iterdir())) == 1
