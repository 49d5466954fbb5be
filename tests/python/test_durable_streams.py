"""Streams in files: resuming changes no bit, and no saved state is lost."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from stochens_rs.exceptions import (
    InputError,
    InputTypeError,
    StateError,
    StateIOError,
    StateLockedError,
    StateRecoveredWarning,
)

GEN = np.random.default_rng(0)
A, B = GEN.standard_normal((6, 6)), GEN.standard_normal((6, 3))
X0, XF = GEN.standard_normal(6), GEN.standard_normal(6)


def make(**options: object) -> se.Stream:
    return se.Stream((A, B), X0, XF, rng=3, **options)


def same(a: Any, b: Any) -> bool:
    first, second = a._to_sections(), b._to_sections()
    return first.keys() == second.keys() and all(
        first[k].tobytes() == second[k].tobytes() for k in first
    )


@pytest.mark.parametrize("options", [{}, {"safeguard": True}, {"slots": "gain"}])
def test_resuming_is_never_having_stopped(tmp_path: Path, options: dict[str, object]) -> None:
    whole, part = make(**options), make(**options)
    whole.step(50_000)
    for count in (1, 999, 20_000, 29_000):  # across chunks of the random streams
        part.step(count)
        part.save(tmp_path / "a.state")
        se.set_num_threads(1 + count % 2)
        part = se.Stream.load(tmp_path / "a.state")
    assert same(whole, part)
    assert np.array_equal(whole.u, part.u)


def test_checkpoints_on_the_way(tmp_path: Path) -> None:
    path = tmp_path / "a.state"
    stream = make()
    told: list[int] = []

    def stop(done: int, _: int | None) -> None:
        told.append(done)
        if len(told) == 4:
            raise KeyboardInterrupt

    # the progress is told, then a checkpoint is written, every 0.2 s
    run = stream.run(tol=1e-300, checkpoint=path, every=0.05, progress=stop)
    assert run.status == "interrupted"
    assert stream.save(path) == 3 + 1 + 1  # before the last one, at the end, and this one
    assert same(se.Stream.load(path), stream)
    whole = make()
    whole.step(stream.steps)
    assert same(whole, stream)


def test_a_checkpoint_does_not_replace_another_problem(tmp_path: Path) -> None:
    path = tmp_path / "a.state"
    other = se.Stream((A, B), X0, XF, rng=4)
    other.save(path)
    before = path.read_bytes()
    stream = make()
    with pytest.raises(StateError, match="of this problem"):
        stream.run(max_steps=10, checkpoint=path)
    assert stream.steps == 0
    assert path.read_bytes() == before
    path.write_bytes(b"a letter to a friend")
    with pytest.raises(StateError):
        stream.run(max_steps=10, checkpoint=path)
    assert path.read_bytes() == b"a letter to a friend"


def test_a_checkpoint_does_not_go_backwards(tmp_path: Path) -> None:
    """A script that does not load its checkpoint is refused, also with the previous state only."""
    path = tmp_path / "a.state"
    far = make()
    far.step(5000)
    far.save(path)
    far.step(1)
    far.save(path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    stream = make()
    ahead = r"a\.state is at step 5001, ahead of this stream at step 0: load it .* or remove it"
    with pytest.raises(StateError, match=ahead):
        stream.run(max_steps=10, checkpoint=path)
    assert stream.steps == 0
    try:
        stream.run(max_steps=10, checkpoint=path)
    except StateError:  # the lock is free
        with pytest.raises(StateError, match=ahead):
            stream.run(max_steps=10, checkpoint=path)
    assert before == {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    path.unlink()
    with (
        pytest.warns(StateRecoveredWarning),
        pytest.raises(StateError, match=r"at step 5000, .*a\.state\.prev"),
    ):
        stream.run(max_steps=10, checkpoint=path)
    (tmp_path / "a.state.prev").unlink()
    assert stream.run(max_steps=10, checkpoint=path).steps == 10
    # one that is behind, or the same, is replaced
    assert stream.run(max_steps=10, checkpoint=path).steps == 10
    assert se.Stream.load(path).run(max_steps=10, checkpoint=path).steps == 10
    assert se.Stream.load(path).steps == 30


def test_one_run_at_a_time_writes_a_checkpoint(tmp_path: Path) -> None:
    path, stream = tmp_path / "a.state", make()
    refused = []

    def second(done: int, total: int | None) -> None:
        other = make()
        for attempt in (lambda: other.run(max_steps=1, checkpoint=path), lambda: other.save(path)):
            with pytest.raises(StateLockedError, match=r"another writer.*a\.state"):
                attempt()
            refused.append(other.steps)

    stream.run(max_steps=100, checkpoint=path, progress=second)
    assert refused == [0, 0]
    assert same(se.Stream.load(path), stream)
    stream.save(path)  # the lock is free again


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_lock_ends_with_its_process(tmp_path: Path) -> None:
    """Killed in the middle of a run, with a child forked in that run still alive."""
    path = tmp_path / "a.state"
    read, write = os.pipe()
    child = os.fork()
    if child == 0:

        def told(done: int, total: int | None) -> None:
            if os.fork() == 0:  # its fork handlers have run when it writes
                os.write(write, os.getpid().to_bytes(8, "little"))
                time.sleep(60)
                os._exit(0)
            time.sleep(60)

        make().run(max_steps=10, checkpoint=path, progress=told)
        os._exit(1)
    grandchild = int.from_bytes(os.read(read, 8), "little")
    try:
        with pytest.raises(StateLockedError):
            make().run(max_steps=10, checkpoint=path)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        assert make().run(max_steps=10, checkpoint=path).steps == 10
    finally:
        os.kill(grandchild, signal.SIGKILL)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_child_forked_in_a_run_does_not_end_its_lock(tmp_path: Path) -> None:
    path, locked = tmp_path / "a.state", []

    def fork(done: int, total: int | None) -> None:
        child = os.fork()
        if child == 0:
            from stochens_rs._base import files as state_file

            for lock in list(state_file._held):
                lock.release()
            os._exit(0)
        os.waitpid(child, 0)
        with pytest.raises(StateLockedError):
            make().save(path)
        locked.append(True)

    make().run(max_steps=10, checkpoint=path, progress=fork)
    assert locked == [True]


# -- all kinds: damage and kills -------------------------------------------------------------------


class Kind(NamedTuple):
    """How a small stream is made, fed a little more, and how far it is."""

    new: Callable[[], Any]
    feed: Callable[[Any], None]
    size: Callable[[Any], int]


KINDS = {
    "stream": Kind(
        lambda: se.Stream(([[3.0]], [[1.0]]), [2.0], [0.5], rng=1),
        lambda stream: stream.step(5),
        lambda stream: stream.steps // 5,
    ),
    "means": Kind(
        lambda: se.DataStream([[1.0]], ranges={"xf": 0.0}),
        lambda stream: stream.update(x0=[np.sin(stream.counts["x0"])], xf=[1.0], A=[[0.5]]),
        lambda stream: stream.counts["x0"],
    ),
    "pairs": Kind(
        lambda: se.ModelStream(1, 1, intercept=True),
        lambda stream: stream.update([np.sin(stream.size)], [1.0], [0.5]),
        lambda stream: stream.size,
    ),
}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize(
    ("name", "kills"), [("stream", sets(100, 30)), ("means", sets(20, 10)), ("pairs", sets(40, 15))]
)
def test_kills_lose_nothing(tmp_path: Path, name: str, kills: int) -> None:
    """A run that is killed repeatedly ends with the result of an undisturbed one."""
    kind, path, moments = KINDS[name], tmp_path / "a.state", random.Random(4)
    whole = kind.new()
    whole.save(path)
    load, acknowledged = type(whole).load, 0
    for turn in range(kills):
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(read)
            stream = load(path)
            while True:
                kind.feed(stream)
                stream.save(path)
                os.write(write, kind.size(stream).to_bytes(8, "little"))
        os.close(write)
        # every second one surely at work; the others perhaps while they load
        told = os.read(read, 8) if turn % 2 else b""
        time.sleep(moments.uniform(0.0, 0.02))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        while block := os.read(read, 1 << 16):
            told += block
        os.close(read)
        if len(told) >= 8:
            acknowledged = int.from_bytes(told[len(told) // 8 * 8 - 8 :][:8], "little")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StateRecoveredWarning)
            assert kind.size(load(path)) >= acknowledged
    assert acknowledged >= kills // 2
    survived = load(path)
    while kind.size(whole) < kind.size(survived):
        kind.feed(whole)
    assert same(whole, survived)


# -- damage and full disks -------------------------------------------------------------------------


@pytest.fixture
def small(tmp_path: Path) -> Path:
    stream = se.Stream(([[3.0]], [[1.0]]), [2.0], [0.5], rng=1)
    stream.step(5)
    stream.save(tmp_path / "s.state")
    return tmp_path / "s.state"


def test_a_checkpoint_that_cannot_be_written_leaves_the_stream_in_order(tmp_path: Path) -> None:
    stream = make()
    with pytest.raises(StateIOError):  # at once
        stream.run(max_steps=100, checkpoint=tmp_path / "none" / "a.state")
    assert stream.steps == 0

    def gone(done: int, total: int | None) -> None:
        (tmp_path / "a.state").mkdir()

    with pytest.raises(StateError, match="a directory"):  # at the end
        stream.run(max_steps=100, checkpoint=tmp_path / "a.state", progress=gone)
    assert stream.steps == 100
    with pytest.raises(InputError, match="`every`"):
        stream.run(max_steps=1, checkpoint=tmp_path / "a.state", every=0.0)


def test_a_run_that_ends_by_an_exception_is_saved(tmp_path: Path) -> None:
    """`progress` raises, or a signal handler calls sys.exit."""
    path, stream = tmp_path / "a.state", make()

    def gone(done: int, total: int | None) -> None:
        raise SystemExit(3)

    with pytest.raises(SystemExit):
        stream.run(max_steps=100, checkpoint=path, progress=gone)
    assert same(se.Stream.load(path), stream)
    with pytest.raises(InputTypeError, match="`progress`"):
        make().run(max_steps=1, checkpoint=tmp_path / "b.state", progress=3)
    assert not (tmp_path / "b.state").exists()


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="timers of POSIX")
def test_ctrl_c_is_not_lost_while_loading(small: Path) -> None:
    """A signal handler raises during a load: each exception reaches the caller."""
    fired = caught = 0

    def interrupt(*_: object) -> None:
        nonlocal fired
        fired += 1
        raise KeyboardInterrupt

    fastest = np.inf  # so that a timer ends within the load, however busy the machine is
    for _ in range(50):
        started = time.perf_counter()
        se.Stream.load(small)
        fastest = min(fastest, time.perf_counter() - started)
    moments, before = random.Random(5), signal.signal(signal.SIGALRM, interrupt)
    try:
        for _ in range(1000):
            try:
                signal.setitimer(signal.ITIMER_REAL, moments.uniform(0.01, 0.99) * fastest)
                se.Stream.load(small)
                signal.setitimer(signal.ITIMER_REAL, 0.0)
            except KeyboardInterrupt:
                caught += 1
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert caught == fired
    assert fired > 100


@pytest.mark.parametrize("signals", [1, 2])
def test_ctrl_c_during_the_last_save(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, signals: int
) -> None:
    """The first Ctrl-C ends and saves the run, with its status; the second one raises."""
    from stochens_rs._base import files as state_file

    path, stream, left, real = tmp_path / "a.state", make(), [signals], state_file.save

    def interrupted(*args: object) -> int:
        if left[0]:
            left[0] -= 1
            raise KeyboardInterrupt
        return real(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(state_file, "save", interrupted)
    if signals == 2:
        with pytest.raises(KeyboardInterrupt):
            stream.run(max_steps=100, checkpoint=path)
        return
    run = stream.run(max_steps=100, checkpoint=path)
    assert (run.status, run.steps) == ("interrupted", 100)
    assert same(se.Stream.load(path), stream)


# -- signals ---------------------------------------------------------------------------------------

ENDLESS = """
import stochens_rs as se, sys
stream = se.Stream(se.cases.ieee39(), [0.1] * 20, [0.0] * 20, rng=1)
run = stream.run(tol=1e-12, checkpoint=sys.argv[1], every=0.05)
print(run.status, stream.steps, stream.key.hex)
"""


def test_ctrl_c_saves_before_leaving(tmp_path: Path) -> None:
    state = tmp_path / "s.state"
    child = subprocess.Popen(
        [sys.executable, "-c", ENDLESS, state], stdout=subprocess.PIPE, text=True
    )
    limit = time.monotonic() + 200.0
    while not state.exists() and time.monotonic() < limit:
        time.sleep(0.02)
    child.send_signal(signal.SIGINT)
    status, steps, digest = child.communicate(timeout=200)[0].split()
    found = se.Stream.load(state)
    assert (status, found.steps, found.key.hex) == ("interrupted", int(steps), digest)
