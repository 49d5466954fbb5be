"""What all commands share: help on one screen, hints, JSON, certificates."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import click
import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import cli

COMMANDS = sorted(cli.cli.commands)
SYSTEM = {"A": [[0.9, 0.2], [0.0, 0.8]], "B": [[0.0], [1.0]], "x0": [1.0, 0.0]}


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A directory with a system and a table of runs, which is the current one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "system.json").write_text(json.dumps(SYSTEM))
    rng, lines = np.random.default_rng(1), ["run,x,v,F"]
    for run in range(20):
        x = rng.standard_normal(2)
        for _ in range(5):
            u = rng.standard_normal()
            lines.append(f"{run},{x[0]},{x[1]},{u}")
            x = SYSTEM["A"] @ x + np.ravel(SYSTEM["B"]) * u + 0.01 * rng.standard_normal(2)
    (tmp_path / "runs.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


@pytest.fixture
def model(place, capsys):
    """A model of these runs."""
    assert cli.main([*RUNS.split(), "--sigma", "0.01", "--out", "model.safetensors"]) == 0
    capsys.readouterr()
    return place


def failed(capsys, *args, code=2):
    """The one line on standard error of a command that fails."""
    assert cli.main([*map(str, args)]) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("stochens: ")
    assert captured.err.count("\n") == 1
    return captured.err


# -- help ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_help_is_one_screen_with_examples_and_exit_codes(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main([*filter(None, [name]), "--help"]) == 0
    text = capsys.readouterr().out
    lines = text.splitlines()
    assert len(lines) <= 46, len(lines)
    assert max(map(len, lines)) <= 80
    words = " ".join(text.split())
    for code in ("0 done", "2 usage", "5 reading", "130 Ctrl-C", "143 SIGTERM"):
        assert code in words
    assert name == "" or f"Examples:\n  stochens {name}" in text


@pytest.mark.parametrize("name", COMMANDS)
def test_help_says_what_every_option_does(name, capsys):
    assert cli.main([name, "--help"]) == 0
    text = "".join(capsys.readouterr().out.split())
    for one in cli.cli.commands[name].params:
        if isinstance(one, click.Option):
            assert one.opts[0] in text, f"{one.opts[0]} is hidden"
            assert one.help, f"{one.opts[0]} has no help"
            assert "".join(one.help.split()) in text, f"the help of {one.opts[0]} is cut"


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_are_understood(name):
    command = cli.cli.commands[name]
    assert 1 <= len(command.examples) <= 3
    for line in command.examples:
        first, *args = shlex.split(line.partition(" | ")[0], comments=True)
        assert first == name
        command.make_context(name, args).close()


def test_no_summary_of_a_command_is_cut(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main(["--help"]) == 0
    assert "..." not in capsys.readouterr().out.partition("Commands:")[2]
    assert all(0 < len(one.short_help) <= 45 for one in cli.cli.commands.values())


# -- JSON ------------------------------------------------------------------------------------------

RUNS = "identify runs.csv --states x,v --inputs F --by run"
AS_JSON = {
    "export": "export model.safetensors --out c.h --proof proof.json --checker check_proof.py",
    "certify": "certify model.safetensors --from 1,0 --within 0.1 --limits -9,9",
    "control": "control system.json",
    "doctor": "doctor",
    "identify": RUNS,
    "study": "study a.study",
}


def half(key, size):
    return {"x": size / 2}


def test_a_study_is_shown_and_exported(place, capsys):
    results = se.Study(half, {"size": [1, 2]}, replicates=3, rng=1).run(path="a.study")
    assert said(capsys, "study a.study") == f"{results}\n"
    found = json.loads(said(capsys, "study a.study --json"))
    assert found["type"] == "Results"
    assert found["values"]["x"] == [[0.5] * 3, [1.0] * 3]
    assert cli.main(["study", "a.study", "--out", "a.csv"]) == 0
    assert "written: a.csv" in capsys.readouterr().err
    assert (place / "a.csv").read_text().startswith("size,replicate,x\n1,0,0.5\n")
    assert "must be one of '.csv', '.nc', '.json'" in failed(
        capsys, "study", "a.study", "--out", "a.xls"
    )
    assert "not the file of a study" in failed(capsys, "study", "runs.csv", code=5)


@pytest.mark.parametrize("name", COMMANDS)
def test_json_is_one_object_and_all_of_standard_output(name, model, capsys):
    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    se.Study(half, {"size": [1, 2]}, replicates=3, rng=1).run(path="a.study")
    assert cli.main([*AS_JSON[name].split(), "--json"]) == 0
    found = json.loads(capsys.readouterr().out, parse_constant=refuse)
    assert isinstance(found, dict)
    failed(capsys, name, "--json", "--no-such-option")


# -- feedback --------------------------------------------------------------------------------------


def said(capsys, line):
    assert cli.main(line.split()) == 0
    return capsys.readouterr().out


def test_export_writes_any_loop_with_its_proof(model, capsys):
    assert said(capsys, AS_JSON["export"]).startswith("<Loop: n=2 m=1, least squares")
    assert "law: u = K y" in Path("c.h").read_text()
    assert Path("check_proof.py").read_text().startswith('"""Prove again')
    assert json.loads(Path("proof.json").read_text())["proof"]["states"] == ["x", "v"]
    read = se.Model.load("model.safetensors")
    for loop in (se.gain(read, 1.0, 1.0), se.regulate(read, 4, limits=(-1.0, 1.0))):
        loop.save("loop.safetensors")
        said(capsys, "export loop.safetensors --out c.h --name rig")
        assert "static inline int rig_step(" in Path("c.h").read_text()
        Path("loop.safetensors").unlink()
    assert "--name must be a C name" in failed(capsys, *AS_JSON["export"].split(), "--name", "A")


def test_certify_says_what_is_proved(model, capsys):
    line = "certify model.safetensors --from 1,0 --within 0.1 --noise 5% --limits -9,9"
    text = said(capsys, line).replace("\n           ", " ")
    found = json.loads(said(capsys, f"{line} --json"))
    loop = se.gain(se.Model.load("model.safetensors"), 1.0, 1.0)
    proof = loop.certificate(0.05)
    tube, level = proof.tube([1.0, 0.0], 60, noise=0.05), proof.holds((-9.0, 9.0), [1.0, 0.0])
    for part in (
        *(str(proof), str(tube)),
        f"within 0.1 of 0 without noise: from step {tube.settles(0.1)} on, for ever",
        "for ever   without noise |x| <=",
        f"kept for ever without noise from {level:.3g} times --from",
    ):
        assert part in text
    assert found["K"] == loop.K.tolist()
    assert found["margin"] == proof.margin
    assert found["certificate"] == proof.to_dict()
    assert found["tube"] == tube.to_dict()
    assert (found["settles"], found["limits_scale"]) == (tube.settles(0.1), level)
    widest = json.loads(said(capsys, "certify model.safetensors --widest --json"))
    assert widest["margin"] > found["margin"]
    assert "tube" not in widest
    assert "--from" in failed(capsys, "certify", "model.safetensors", "--noise", "5%")
    sheet = proof.margins()
    table = " ".join(said(capsys, "certify model.safetensors --margins").split())
    assert f"phase [deg] of F {sheet.rows()[2][1]} {sheet.rows()[2][2]}" in table


# -- nothing is left behind, and single options ----------------------------------------------------


def test_an_error_before_any_number_leaves_nothing_behind(place, capsys):
    pytest.importorskip("matplotlib")
    before = sorted(place.iterdir())
    failed(capsys, "control", "no such file", "--out", "new", code=5)
    assert sorted(place.iterdir()) == before
    (place / "mine").mkdir()
    failed(capsys, "control", "no such file", "--out", "mine", code=5)
    assert (place / "mine").is_dir()  # it was there
