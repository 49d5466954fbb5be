"""Calls that run out of memory raise `ResourceError`; none ends the process."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from coverage_study import sets

pytest.importorskip("resource")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "fuzz"))
import readers

# Every call runs in children of one process that has made its inputs: each child may map so many
# more bytes than are mapped, from nothing to enough. The parent says how they end.
LADDER = r"""
import json, os, resource, signal, sys, tempfile
import numpy as np, stochens_rs as se
from stochens_rs._base import files as state_file

n, size, rungs, products = map(int, sys.argv[1:])
for name in se.__all__:
    getattr(se, name)  # imports at the first use have errors of their own
se.set_num_threads(2)
rng = np.random.default_rng(5)
# OpenBLAS ends the process where it finds no buffer: one thread, and the buffer beforehand
np.ones((n, n)) @ np.ones((n, n))
A, B = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.5) / n, rng.normal(size=(n, 2))
x0, xf = rng.normal(size=n), np.zeros(n)
draws = se.sample(A, size, rng=1)
states = se.sample(x0, size, rng=2)
few = se.sample(A[:20, :20], 8 * size, rng=1)
dense = se.Ensemble.from_samples(rng.normal(size=(size // 2, n)))
counts = se.sample_counts(A, 10**6, rng=3)
system = se.System(A, B)
models = se.SystemEnsemble(np.stack([A] * 3), np.stack([B] * 3))
weights = np.full(size, 1 / size)
u = rng.normal(size=(3, 2))
stream = se.Stream((A, B), x0, xf, rng=4)
stream.step(5)
sections = {"values": rng.normal(size=n * n), **{f"s{k}": np.zeros(1) for k in range(4000)}}
encoded = state_file.encode("k", 1, sections)
folder = tempfile.mkdtemp()
state_file.save(folder + "/saved", "k", sections)

def run_stream():
    stream = se.Stream((A, B), x0, xf, rng=4)
    stream.step(50)
    return stream.u, stream.certificate, stream.estimates

def feed():
    data = se.DataStream(B, x0=x0)
    data.update(x0=states.dense() if n < 500 else dense)
    return data.estimates

calls = {
    "sample": lambda: se.sample(A, size, rng=1),
    "sample systematic": lambda: se.sample(A, size, rng=1, scheme="systematic"),
    "sample_counts": lambda: se.sample_counts(A, 10**9, rng=1),
    "sample_counts systematic": lambda: se.sample_counts(A, 10**9, rng=1, scheme="systematic"),
    "dense": lambda: states.dense(),
    "counts": lambda: draws.counts(),
    "mean": lambda: draws.mean(),
    "combine": lambda: draws.combine(weights),
    "fuse uniform": lambda: se.fuse(draws, "uniform", target=A),
    "fuse alse": lambda: se.fuse(draws, se.fusion.Alse(max_iter=200), target=A),
    "fuse alse subsimplex": lambda: se.fuse(
        draws, se.fusion.Alse("subsimplex", max_iter=200), target=A
    ),
    "fuse alse per column": lambda: se.fuse(draws, se.fusion.Alse("per-column"), target=A),
    "fuse alse many": lambda: se.fuse(few, "alse", target=A[:20, :20]),
    "fuse alse vector": lambda: se.fuse(states, "alse", target=x0),
    "fuse alse dense": lambda: se.fuse(dense, se.fusion.Alse(max_iter=200), target=x0),
    "fuse slse": lambda: se.fuse(draws, "slse", target=A),
    "fuse slse safeguarded": lambda: se.fuse(draws, "slse-safeguarded", target=A),
    "fuse slse dense": lambda: se.fuse(dense, "slse", target=x0),
    "fuse_path uniform": lambda: se.fuse_path(draws, [5, size], target=A, estimates=True),
    "fuse_path alse": lambda: se.fuse_path(
        draws, [5, size // 4], se.fusion.Alse(max_iter=20), target=A, estimates=True
    ),
    "fuse_path slse": lambda: se.fuse_path(draws, [5, size], "slse", target=A, estimates=True),
    "control": lambda: se.control((draws, B), states, xf),
    "control counts": lambda: se.control((counts, B), x0, xf),
    "control diagonal": lambda: se.control((draws, B), states, xf, fusion="diagonal"),
    "realization_controls": lambda: se.realization_controls((draws, B), states, xf),
    "control over steps": lambda: se.control((draws, B), x0, xf, steps=3),
    "simulate": lambda: se.simulate(system, x0, u),
    "simulate_ensemble": lambda: se.simulate_ensemble(system, x0, u, 40, rng=1),
    "simulate_ensemble mean-field": lambda: se.simulate_ensemble(
        system, x0, u, 40, averaging="mean-field", rng=1, replicates=3
    ),
    "simulate_ensemble of systems": lambda: se.simulate_ensemble(
        models, x0, u, keep="covariance runs"
    ),
    "Stream": run_stream,
    "Stream pickled": lambda: __import__("pickle").loads(__import__("pickle").dumps(stream)),
    "DataStream": feed,
    "state encoded": lambda: state_file.encode("k", 1, sections),
    "state decoded": lambda: state_file.decode("state", encoded, "k"),
    "state saved": lambda: state_file.save(folder + "/new", "k", sections),
    "state loaded": lambda: state_file.load(folder + "/saved", "k"),
}

def mapped():
    return int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()

def child(call, more):
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    signal.alarm(20)  # whoever hangs is ended by a signal, too
    limit = mapped() + more
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    try:
        call()
    except MemoryError as error:
        os._exit(1 if isinstance(error, se.StochensError) else 2)
    except BaseException as error:
        os._exit(3)
    os._exit(0)

ends = {}
largest = 40 * 8 * n * n + (1 << 28) + products
for name, call in calls.items():
    ends[name] = []
    for rung in range(rungs):
        more = int(2**14 * (largest / 2**14) ** (rung / (rungs - 1)))
        pid = os.fork()
        if pid == 0:
            child(call, more)
        ends[name].append(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
print(json.dumps(ends))
"""

# Arrays of a page and more come from the system and go back to it: the limit is felt at once.
ENVIRONMENT = {
    "MALLOC_MMAP_THRESHOLD_": "4096",
    "MALLOC_TOP_PAD_": "0",
    "MALLOC_TRIM_THRESHOLD_": "0",
    "MALLOC_ARENA_MAX": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "RUST_BACKTRACE": "1",  # of a panic: it needs memory, too
}


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux counts what is mapped")
def test_every_call_under_a_shrinking_limit() -> None:
    run = subprocess.run(
        [sys.executable, "-c", LADDER, "300", "400", str(sets(10, 5)), str(readers.PRODUCTS)],
        capture_output=True,
        text=True,
        env={**os.environ, **ENVIRONMENT, "PYTHONPATH": os.pathsep.join(sys.path)},
        timeout=300,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    ends = json.loads(run.stdout)
    assert len(ends) == 37
    for name, codes in ends.items():
        # pickles and the writer of files are called here past the public names
        plain = {2} if name.startswith("state ") or name == "Stream pickled" else set()
        said = f"{name}: {codes} (0 done, 1 ResourceError, 2 plain MemoryError, negative: a signal)"
        assert set(codes) <= {0, 1} | plain, said
        assert codes[-1] == 0, f"{name}: {codes}"
    # the limits are felt: most calls are refused at the lowest
    assert sum(codes[0] for codes in ends.values()) >= 24
