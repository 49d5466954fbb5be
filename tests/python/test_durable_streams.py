"""Streams in files: resuming changes no bit, and no saved state is lost."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import (
    InputTypeError,
    StateError,
    StateLockedError,
    StateRecoveredWarning,
)
from stream_problems import OPTIONS, same

GEN = np.random.default_rng(0)
A, B = GEN.standard_normal((6, 6)), GEN.standard_normal((6, 3))
X0, XF = GEN.standard_normal(6), GEN.standard_normal(6)


def make(**options: object) -> se.Stream:
    return se.Stream((A, B), X0, XF, rng=3, **options)


@pytest.mark.parametrize(("safeguard", "slots"), OPTIONS)
def test_resuming_is_never_having_stopped(tmp_path: Path, safeguard: bool, slots: str) -> None:
    whole, part = (make(safeguard=safeguard, slots=slots) for _ in range(2))
    part.save(tmp_path / "a.state")
    # at the ends of blocks and across chunks of the random streams
    for count in (1, 254, 1, 127, 60_000, 20_000):
        part = se.Stream.load(tmp_path / "a.state")
        part.step(count)
        part.save(tmp_path / "a.state")
        se.set_num_threads(1 + count % 2)
    whole.step(80_383)
    part = se.Stream.load(tmp_path / "a.state")
    assert same(whole, part)
    assert np.array_equal(whole.u, part.u)
    assert part.key == whole.key


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


@pytest.fixture
def small(tmp_path: Path) -> Path:
    stream = se.Stream(([[3.0]], [[1.0]]), [2.0], [0.5], rng=1)
    stream.step(5)
    stream.save(tmp_path / "s.state")
    return tmp_path / "s.state"


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
