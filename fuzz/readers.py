"""Give hostile files to every reader, and keep those that are refused in a new way.

`python fuzz/readers.py [--minutes 3] [--seed 0] [READER ...]`. A file must be read, and what was
read must work, or be refused by an exception of this package with a message of one line. Anything
else ends the search; the file is then among those of `fuzz/corpus/READER`, which the tests read.
Arrays in state files are changed before they are sealed by their digest, so that the readers behind
it are reached.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import json
import random
import re
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path

import numpy as np
from changes import changed

import stochens_rs as se

try:
    import resource
except ImportError:  # not on Windows
    resource = None

CORPUS = Path(__file__).parent / "corpus"
LARGEST = 4096  # bytes of a file that is kept
MOST = 20  # files that are kept for a reader, in addition to those that are not refused properly
SLOW = 30  # seconds that no file of this size may take
CACHE = Path("/sys/devices/system/cpu/cpu0/cache/index3/size")
# Bytes that products of matrices take: twice the last-level cache, 32 MiB if it is unknown.
PRODUCTS = 2 * (1024 * int(CACHE.read_text().rstrip("K\n")) if CACHE.exists() else 2**25)
MORE = 2**29 + PRODUCTS  # that reading may take: a file may promise more numbers than it has
A, B, X0, XF = [[0.9, 0.2], [-0.1, 0.8]], [[0.0], [1.0]], [1.0, -1.0], [0.0, 0.5]


def half(key: se.Key, size: int) -> dict[str, float]:
    """Something to repeat, found again by `Study.resume`."""
    return {"half": size / 2}


half.__module__ = "fuzz"  # also where this file is the program


# -- files that can be read --------------------------------------------------------------------


def _runs() -> se.Trajectories:
    draw = np.random.default_rng(5)
    return se.Trajectories(draw.standard_normal((3, 6, 2)), draw.standard_normal((3, 5, 1)), dt=0.1)


def _streams(path: Path) -> None:
    stream = se.Stream((A, B), X0, XF, rng=1)
    stream.step(40)
    stream.save(path)


def _means(path: Path) -> None:
    stream = se.DataStream(B, ranges={"x0": 9.0, "xf": 9.0, "A": 9.0})
    stream.update(x0=[X0, X0], A=[A, A], xf=XF)
    stream.save(path)


def _pairs(path: Path) -> None:
    stream = se.ModelStream(2, 1, dt=0.1)
    for x, u in _runs().runs:
        stream.update(x[:-1], u, x[1:])
    stream.save(path)


def _studies(path: Path) -> None:
    se.Study(half, {"size": [1, 2]}, replicates=3, rng=1).run(path=path)


def _problem(path: Path) -> None:
    path.write_text(json.dumps({"A": A, "B": B, "x0": X0, "xf": XF, "dt": 0.1}))


def _archive(path: Path) -> None:
    np.savez(path, A=A, B=B, x0=X0, xf=XF, dt=0.1)


def _table(path: Path) -> None:
    rows = ["t,x,v,u,run", *(f"{k % 5 / 10},{k},{k**0.5},{k % 3 - 1},{k // 5}" for k in range(20))]
    path.write_text("\n".join(rows))


def _network(path: Path) -> None:
    # two machines at rest beside each other: no flow, and so a solved one
    tables = {
        "bus": [[k, 4 - k, 0, 0, 0, 0, 1, 1, 0, 100, 1, 1.1, 0.9] for k in (1, 2)],
        "gen": [[k, 0, 0, 9, -9, 1, 100, 1, 9, 0, *[0] * 11] for k in (1, 2)],
        "branch": [[1, 2, 0.01, 0.1, 0, 0, 0, 0, 0, 0, 1, -360, 360]],
    }
    lines = ["function mpc = network", "mpc.version = '2';", "mpc.baseMVA = 100;"]
    for name, rows in tables.items():
        lines += [f"mpc.{name} = [", *(" ".join(map(str, row)) + ";" for row in rows), "];"]
    path.write_text("\n".join(lines) + "\n")


def _indices(path: Path) -> None:
    # rows, kind of number, indices
    path.write_bytes(bytes([2, 0]) + np.array([0, 1, 1, 0, 1, 1], dtype=np.int64).tobytes())


# -- what reads them, and what is then done ----------------------------------------------------


def _read_stream(path: Path) -> None:
    stream = se.Stream.load(path)
    stream.step(200)
    assert np.isfinite(stream.u).all()
    repr(stream)


def _read_means(path: Path) -> None:
    stream = se.DataStream.load(path)
    stream.update(x0=[0.0, 0.0])
    stream.confidence()
    repr(stream)


def _read_pairs(path: Path) -> None:
    stream = se.ModelStream.load(path)
    n, m = stream.model.n, stream.model.m
    stream.update(np.ones((1, n)), np.ones((1, m)), np.ones((1, n)))
    repr(stream)


def _read_model(path: Path) -> None:
    model = se.Model.load(path)
    model.region()
    model.check(19, rng=1)
    repr(model)


def _read_trajectories(path: Path) -> None:
    repr(se.identify(se.Trajectories.load(path)))


def _read_study(path: Path) -> None:
    study = se.Study.resume(path, half)
    repr(study.results)
    repr(se.Study.merge([path]).results)


def _read_problem(path: Path) -> None:
    problem = se.cases.from_file(path)
    if problem.x0 is not None and problem.xf is not None:
        se.control(problem.system, problem.x0, problem.xf)


def _read_table(path: Path) -> None:
    se.Trajectories.from_csv(path, states=["x", "v"], inputs=["u"], by="run", time="t")


def _read_network(path: Path) -> None:
    case = se.cases.read_matpower(path)
    buses = case["gen"][:2, 0]
    machines = {"bus": buses, "H": [4.0, 5.0], "D": [2.0, 2.0], "xd1": [0.1, 0.2]}
    se.cases.from_matpower(case, machines, dt=0.1)


def _read_indices(path: Path) -> None:
    lines, kind, *_ = (content := path.read_bytes().ljust(2, b"\0"))
    dtype = np.dtype(["i8", "i1", "u8", "f8", "f4", "?", "M8[s]", "S2"][kind % 8])
    raw = content[2 : len(content) - (len(content) - 2) % (dtype.itemsize * max(1, lines % 4))]
    values = np.frombuffer(raw, dtype=dtype).reshape(-1, max(1, lines % 4))
    ensemble = se.Ensemble.from_indices(values, [[3.0, -4.0], [2.0, 1.0]])
    assert (ensemble.counts().sum(axis=0) == len(values)).all()


# name: (suffix, kind of state file, writer, reader)
Reader = tuple[str, str, Callable[[Path], None], Callable[[Path], None]]
READERS: dict[str, Reader] = {
    "stream": (".state", "stream", _streams, _read_stream),
    "means": (".state", "means", _means, _read_means),
    "pairs": (".state", "pairs", _pairs, _read_pairs),
    "model": (".state", "model", lambda path: se.identify(_runs()).save(path), _read_model),
    "trajectories": (".state", "trajectories", lambda p: _runs().save(p), _read_trajectories),
    "study": (".study", "study", _studies, _read_study),
    "problem": (".json", "", _problem, _read_problem),
    "archive": (".npz", "", _archive, _read_problem),
    "table": (".csv", "", _table, _read_table),
    "network": (".m", "", _network, _read_network),
    "indices": (".bin", "", _indices, _read_indices),
}


def example(name: str) -> bytes:
    """Return a file that the reader accepts."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name + READERS[name][0])
        READERS[name][2](path)
        return path.read_bytes()


@contextlib.contextmanager
def _little_memory() -> Iterator[None]:
    mapped = Path("/proc/self/statm")
    if resource is None or not mapped.exists():
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    limit = int(mapped.read_text().split()[0]) * resource.getpagesize() + MORE
    resource.setrlimit(resource.RLIMIT_AS, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def outcome(name: str, content: bytes, folder: Path) -> str:
    """Read a file; return how it was refused, without its numbers, or "" if it was read."""
    suffix, _, _, read = READERS[name]
    path = folder / f"{name}{suffix}"
    path.write_bytes(content)
    try:
        with _little_memory(), warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            read(path)
    except se.StochensError as error:
        text = str(error)
        if isinstance(error, se.exceptions.InternalError) or "\n" in text.strip():
            raise
        text = re.sub(r"'[^']*'|\"[^\"]*\"|[-+.\w]*\d[-+.\w]*|[^ -~]", "", text.split(name)[-1])
        return f"{type(error).__name__} {text[:50]}"
    return ""


def search(name: str, seconds: float, seed: int) -> tuple[int, int]:
    """Change files until time is over; return how many were read, and how many are new."""
    draw, own, began = random.Random(seed), CORPUS / name, time.monotonic()
    own.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix="stochens-fuzz-"))
    files = [example(name), *(path.read_bytes() for path in sorted(own.iterdir()))]
    seen = {outcome(name, content, folder) for content in files}
    tried = new = 0
    while time.monotonic() - began < seconds:
        content = changed(READERS[name][1], draw.choice([files[0], draw.choice(files)]), draw)
        tried += 1
        kept = own / (sha256(content).hexdigest()[:12] + READERS[name][0])
        faulthandler.dump_traceback_later(SLOW, exit=True, file=sys.__stderr__)
        try:
            how = outcome(name, content, folder)
        except BaseException:
            kept.write_bytes(content)
            print(f"{name}: {kept} is neither read nor refused", file=sys.stderr)
            raise
        faulthandler.cancel_dump_traceback_later()
        if how not in seen and len(content) <= LARGEST:
            seen.add(how)
            files.append(content)
            new += 1
            if len(list(own.iterdir())) < MOST:
                kept.write_bytes(content)
    shutil.rmtree(folder)
    return tried, new


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=3.0, help="for all readers together")
    parser.add_argument("--seed", type=int, default=time.time_ns() % 2**32)
    parser.add_argument("names", nargs="*", choices=[[], *READERS], metavar="READER")
    arguments = parser.parse_args()
    print(f"seed {arguments.seed}; a file that ends the process is left in {tempfile.gettempdir()}")
    names = arguments.names or list(READERS)
    for one in names:
        tried, new = search(one, 60 * arguments.minutes / len(names), arguments.seed)
        print(f"{one}: {tried} files, {new} refused in a new way")
