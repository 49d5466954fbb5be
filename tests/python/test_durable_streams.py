"""Streams in files: resuming changes no bit, and no saved state is lost."""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs._base import saving
from stochens_rs.exceptions import (
    InputError,
    InputTypeError,
    StateError,
    StateIOError,
    StateLockedError,
    StateNotFoundError,
    StateRecoveredWarning,
)

GEN = np.random.default_rng(0)
A, B = GEN.standard_normal((6, 6)), GEN.standard_normal((6, 3))
X0, XF = GEN.standard_normal(6), GEN.standard_normal(6)


def make(**options: object) -> se.Stream:
    return se.Stream((A, B), X0, XF, rng=3, **options)


def same(a: se.Stream, b: se.Stream) -> bool:
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
            from stochens_rs._base import saving as state_file

            for lock in list(state_file._held):
                lock.release()
            os._exit(0)
        os.waitpid(child, 0)
        with pytest.raises(StateLockedError):
            make().save(path)
        locked.append(True)

    make().run(max_steps=10, checkpoint=path, progress=fork)
    assert locked == [True]


def test_data_streams_too(tmp_path: Path) -> None:
    data = se.sample(A, 40, rng=1).dense()
    whole, part = se.DataStream(B, x0=X0), se.DataStream(B, x0=X0)
    for stream in (whole, part):
        stream.update(x0=GEN.standard_normal((5, 6)) * 0 + X0, xf=np.tile(XF, (3, 1)), A=data[:15])
    part.save(tmp_path / "d.state")
    part = se.DataStream.load(tmp_path / "d.state")
    for stream in (whole, part):
        stream.update(A=data[15:])
    assert np.array_equal(whole.u, part.u)
    with pytest.raises(StateError, match="kind"):
        se.Stream.load(tmp_path / "d.state")


# -- damage ----------------------------------------------------------------------------------------


@pytest.fixture
def small(tmp_path: Path) -> Path:
    stream = se.Stream(([[3.0]], [[1.0]]), [2.0], [0.5], rng=1)
    stream.step(5)
    stream.save(tmp_path / "s.state")
    return tmp_path / "s.state"


def test_flipped_bits_are_noticed(small: Path) -> None:
    """One bit of every byte; all bits of a smaller file are flipped in the core's tests."""
    good = bytearray(small.read_bytes())
    for at in range(len(good)):
        good[at] ^= 1 << at % 8
        with pytest.raises(StateError):
            saving.decode("a.state", bytes(good), "stream")
        if at % 37 == 0:
            small.write_bytes(good)
            with pytest.raises(StateError):
                se.Stream.load(small)
        good[at] ^= 1 << at % 8
    small.write_bytes(good)
    assert se.Stream.load(small).steps == 5


def test_truncations_are_noticed(small: Path) -> None:
    good = small.read_bytes()
    for length in range(0, len(good), 5):
        with pytest.raises(StateError):
            saving.decode("a.state", good[:length], "stream")
    for length in range(0, len(good), 97):
        small.write_bytes(good[:length])
        with pytest.raises(StateError):
            se.Stream.load(small)


def test_damage_is_recovered_from_the_generation_before(small: Path) -> None:
    stream = se.Stream.load(small)
    stream.step(10)
    stream.save(small)
    small.write_bytes(small.read_bytes()[:-1])
    before = sorted((p.name, p.stat().st_mtime_ns) for p in small.parent.iterdir())
    with pytest.warns(StateRecoveredWarning, match="generation 1"):
        old = se.Stream.load(small)
    assert old.steps == 5
    assert before == sorted((p.name, p.stat().st_mtime_ns) for p in small.parent.iterdir())


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("key", lambda a: a ^ 1),
        ("x0.fused", lambda a: a * np.nan),
        ("x0.fused", lambda a: a + 100.0),  # outside the hull of the realizations
        ("steps", lambda a: a[:-1]),
        ("x0.state", lambda a: a[:-1]),
    ],
)
def test_numbers_that_cannot_be_a_stream_are_refused(
    tmp_path: Path, name: str, change: object
) -> None:
    from stochens_rs._base import saving as state_file

    sections = make()._to_sections()
    sections[name] = change(sections[name])  # type: ignore[operator]
    state_file.save(tmp_path / "a.state", "stream", sections)  # sealed with a correct digest
    with pytest.raises(StateError, match=r"a\.state"):
        se.Stream.load(tmp_path / "a.state")


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(StateNotFoundError):
        se.Stream.load(tmp_path / "none.state")


# -- kills and full disks --------------------------------------------------------------------------


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_hundred_kills(tmp_path: Path) -> None:
    """A run that is killed repeatedly ends with the result of an undisturbed one."""
    path, moments = tmp_path / "a.state", random.Random(4)
    make().save(path)
    acknowledged = 0
    for turn in range(100):
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(read)
            stream = se.Stream.load(path)
            while True:
                stream.step(300)
                stream.save(path)
                os.write(write, stream.steps.to_bytes(8, "little"))
        os.close(write)
        # every second one surely at work; the others perhaps while they load
        told = os.read(read, 8) if turn % 2 else b""
        time.sleep(moments.uniform(0.0, 0.03))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        while block := os.read(read, 1 << 16):
            told += block
        os.close(read)
        if len(told) >= 8:
            acknowledged = int.from_bytes(told[-8:], "little")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StateRecoveredWarning)
            assert se.Stream.load(path).steps >= acknowledged
    assert acknowledged > 1000
    survived = se.Stream.load(path)
    whole = make()
    whole.step(survived.steps)
    assert same(whole, survived)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_full_disk_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.state"
    stream = make()
    stream.save(path)
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (200, 200))
        stream.step(100)
        try:
            stream.save(path)
        except StateIOError as error:
            os._exit(0 if error.errno is not None and stream.steps == 100 else 2)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert se.Stream.load(path).steps == 0


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
    from stochens_rs._base import saving as state_file

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


def test_a_name_that_ends_in_a_slash(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="`path`"):
        make().save(f"{tmp_path}/a/")
    assert list(tmp_path.iterdir()) == []


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
