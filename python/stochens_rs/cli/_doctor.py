"""``stochens study`` and ``stochens doctor``: what a file of a study has, what is installed."""

from __future__ import annotations

import os
import re
import sys
from hashlib import sha256
from importlib import metadata
from typing import Any

import numpy as np

from .. import _core, reference
from .._base.files import versions
from .._base.running import VARIABLE, left_by_source, threads_by
from ..controls import control
from ..ensembles import sample
from ..studies import Study
from ..studies.tasks import fingerprint
from ._command import INTERNAL, OK, File, command, note, show_result


@command()
def study_command(source: File, *, out: File | None = None, as_json: bool = False) -> None:
    """Show a study; write its numbers.

    Prints the medians of a study in a file, also while it runs.

    Options:
      source STUDY  The file.
      out FILE  Write all numbers: .csv, .nc, .json.
      as_json --json  Print JSON instead of text.
    For example:
      study run.study
      study run.study --out errors.nc
    """
    results = Study.resume(source).results
    if out is not None:
        results.save(out)
        note(f"written: {out}")
    show_result(results.to_dict(), str(results), as_json)


_OF_DEVELOPERS = ("all", "bench", "dev", "docs")  # extras that are left out
_BLAS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
_REQUIREMENT = re.compile(r"([\w.-]+).*extra *== *['\"]([\w-]+)['\"]")
# Draws of the values 1, 2, 3, 4, 5 with seed 1: random streams of version 1.
_DRAWS = "e39698281e382f953d168f7f6cd2b1234dfafd7b1bacfa25ef7d9da23c6405a9"


@command()
def doctor_command(*, validate: bool = False, as_json: bool = False) -> int:
    """Check the installation; say what it uses.

    Put the output into reports of errors: versions, instructions of the processor, threads, memory
    that is left, and the extras with the command that installs each. Missing extras are no error;
    if something essential is broken the exit code is 1.

    Options:
      validate  Compare the core with the same in NumPy.
      as_json --json  Print JSON instead of text.
    For example:
      doctor
      doctor --validate
    """
    release, registers = _core.build()
    threads, by = threads_by()
    blas = np.show_config(mode="dicts").get("Build Dependencies", {}).get("blas", {})
    facts: dict[str, Any] = {
        "schema": "stochens-doctor/1",
        **versions(),
        "executable": sys.executable,
        "core": {"version": _core.version(), "release": release, "registers": registers},
        "numpy_blas": f"{blas.get('name', 'unknown')} {blas.get('version', '')}".strip(),
        "numpy_processor": fingerprint()["processor"].split(),
        "threads": threads,
        "threads_by": by,
        "environment": {name: os.environ.get(name) for name in (VARIABLE, *_BLAS)},
        "memory_left": left_by_source(),
        "extras": _extras(),
    }
    compared = reference.validate() if validate else ()
    facts["validation"] = [one._asdict() | {"passed": one.passed} for one in compared]
    facts["warnings"] = []
    if not release:
        text = "the core is a debug build, many times slower: build it with --release"
        facts["warnings"].append(text)
    if facts["environment"][VARIABLE] is not None and by == "processors":
        facts["warnings"].append(f"{VARIABLE} is no whole number > 0, and without effect")
    facts["broken"] = _broken(facts) + [str(one) for one in compared if not one.passed]
    show_result(facts, _text(facts), as_json)
    return INTERNAL if facts["broken"] else OK


def _extras() -> dict[str, dict[str, str | None]]:
    """The version of each package of an extra, None where it is not installed."""
    try:
        required = metadata.requires("stochens_rs") or []
    except metadata.PackageNotFoundError:
        return {}
    found: dict[str, dict[str, str | None]] = {}
    for package, name in (match.groups() for match in map(_REQUIREMENT.match, required) if match):
        if name in _OF_DEVELOPERS:
            continue
        there = found.setdefault(name, {})
        try:
            there[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            there[package] = None
    return found


def _broken(facts: dict[str, Any]) -> list[str]:
    """What is essential and does not work."""
    found = []
    package, core = facts["stochens_rs"], facts["core"]["version"]
    if package not in (core, "not installed"):
        found.append(f"the package is version {package}, its core {core}: install it again")
    drawn = np.asarray(sample(np.arange(1.0, 6.0), 1000, rng=1).indices, dtype="<i8")
    if sha256(drawn.tobytes()).hexdigest() != _DRAWS:
        found.append("draws are not those of other machines")
    u = control(([[2.0]], [[4.0]]), [3.0], [1.0]).u  # 1 = 2 * 3 + 4 u
    if abs(float(u.item()) + 1.25) > 1e-12:
        found.append(f"the control of a small system is {u.item()}, must be -1.25")
    return found


def _text(facts: dict[str, Any]) -> str:
    core, set_by = facts["core"], facts["environment"]
    kind = "release" if core["release"] else "debug"
    threads = [f"{name}={value}" for name, value in set_by.items() if value is not None]
    memory = [f"{left / 2**30:.3g} GiB ({name})" for name, left in facts["memory_left"].items()]
    rows = [
        ("stochens_rs", facts["stochens_rs"]),
        ("core", f"{core['version']}, {kind} build, kernels for {core['registers']}"),
        ("python", f"{facts['python']}, {facts['executable']}"),
        ("numpy", f"{facts['numpy']}, {facts['numpy_blas']}, for {facts['numpy_processor'][-1]}"),
        ("platform", facts["platform"]),
        ("threads", f"{facts['threads']}, by {facts['threads_by']} ({VARIABLE} sets them)"),
        ("set", ", ".join(threads) or f"none of {', '.join(set_by)}"),
        ("memory left", ", ".join(memory) or "unknown"),
    ]
    for name, packages in facts["extras"].items():
        here = ", ".join(f"{one} {version}" for one, version in packages.items() if version)
        gone = ", ".join(one for one, version in packages.items() if not version)
        cure = f"no {gone}: pip install 'stochens_rs[{name}]'" if gone else ""
        rows.append((f"[{name}]", "; ".join(filter(None, (here, cure)))))
    rows += [
        (f"validated {at}", f"{one['name']}, {one['cases']} problems: {one['difference']:.2g}")
        for at, one in enumerate(facts["validation"], 1)
    ]
    rows += [("warning", text) for text in facts["warnings"]]
    rows += [("broken", text) for text in facts["broken"]] or [("works", "yes")]
    return "\n".join(f"{name:<13} {value}" for name, value in rows)
