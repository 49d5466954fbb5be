"""`stochens doctor`: what it finds, and what it finds broken."""

from __future__ import annotations

import hashlib
import json
import sys

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import _core, cli
from stochens_rs import reference as twin


def doctor(capsys, code=0):
    assert cli.main(["doctor", "--json"]) == code
    found = json.loads(capsys.readouterr().out)
    assert cli.main(["doctor"]) == code
    return found, capsys.readouterr().out


def test_doctor_says_what_is_there(capsys, monkeypatch):
    monkeypatch.setenv("STOCHENS_NUM_THREADS", "3")
    found, text = doctor(capsys)
    assert found["python"] == ".".join(map(str, sys.version_info[:3]))
    assert found["core"]["release"] is True
    assert found["core"]["registers"] in ("avx512f", "avx2", "portable")
    assert (found["threads"], found["threads_by"]) == (3, "STOCHENS_NUM_THREADS")
    assert found["warnings"] == found["broken"] == []
    assert all(left >= 0 for left in found["memory_left"].values())
    for word in ("stochens_rs", "release build", "numpy", "threads", "works         yes"):
        assert word in text


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc/cpuinfo")
def test_the_registers_are_those_of_the_processor(capsys):
    with open("/proc/cpuinfo") as file:
        flags = set(file.read().split())
    best = next((one for one in ("avx512f", "avx2") if one in flags), "portable")
    assert doctor(capsys)[0]["core"]["registers"] == best


def test_doctor_says_how_to_install_what_is_missing(capsys, monkeypatch):
    required = ["numpy>=1", "no-such>=2 ; extra == 'tables'", "numpy ; extra == 'tables'"]
    monkeypatch.setattr(cli._doctor.metadata, "requires", lambda _: required)
    found, text = doctor(capsys)
    assert found["extras"] == {"tables": {"no-such": None, "numpy": np.__version__}}
    assert "no no-such: pip install 'stochens_rs[tables]'" in text


def test_doctor_finds_what_is_broken(capsys, monkeypatch):
    monkeypatch.setenv("STOCHENS_NUM_THREADS", "many")
    monkeypatch.setattr(_core, "build", lambda: (False, "portable"))
    found, text = doctor(capsys)
    assert "debug build" in found["warnings"][0]
    assert "STOCHENS_NUM_THREADS" in found["warnings"][1]
    assert "debug build" in text
    for name, replacement, said in (
        ("_DRAWS", "0" * 64, "draws are not those"),
        ("control", lambda *_: se.control(([[1.0]], [[1.0]]), [1.0], [0.0]), "must be -1.25"),
    ):
        with monkeypatch.context() as broken:
            broken.setattr(cli._doctor, name, replacement)
            found, text = doctor(capsys, code=1)
        assert said in found["broken"][0]
        assert "broken" in text
    stated = cli._doctor.versions()
    monkeypatch.setattr(_core, "version", lambda: "0.0.0")
    monkeypatch.setattr(cli._doctor, "versions", lambda: {**stated, "stochens_rs": "1"})
    assert "install it again" in doctor(capsys, code=1)[0]["broken"][0]


def test_the_draws_of_doctor_are_those_of_the_twin():
    key = hashlib.sha256(b"stochens key v1\0int\x001").digest()
    drawn = twin.sampling.sample_indices(np.arange(1.0, 6.0), 1000, key=key, scheme="iid", axis=0)
    assert hashlib.sha256(drawn.astype("<i8").tobytes()).hexdigest() == cli._doctor._DRAWS


def test_doctor_validates_the_core_against_numpy(capsys, monkeypatch):
    assert cli.main(["doctor", "--validate", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["validation"]
    assert len(found) == 10
    assert all(one["passed"] and one["cases"] >= 20 for one in found)
    assert doctor(capsys)[0]["validation"] == []
    own = twin.validation.controls.control
    monkeypatch.setattr(
        twin.validation.controls, "control", lambda *args, **how: 1.001 * own(*args, **how)
    )
    assert cli.main(["doctor", "--validate"]) == 1
    assert "control, product fusion" in capsys.readouterr().out
