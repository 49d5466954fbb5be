"""The sequential algorithm: saved states, traces, how runs end, threads, Ctrl-C, bad input."""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputError, SizeError
from stream_problems import X0, XF, A, B, make, same

# -- state ---------------------------------------------------------------------------------------


def test_copies_and_pickles_go_their_own_way():
    one = make(2)
    one.step(10)
    for other in (copy.deepcopy(one), pickle.loads(pickle.dumps(one)), copy.copy(one)):
        assert same(other, one)
        other.step(5)
        assert (other.steps, one.steps) == (15, 10)


def test_damaged_states_are_refused():
    good = make(7, safeguard=True)
    good.step(100)
    state = good._to_sections()

    def changed(name, at, value):
        array = state[name].copy()
        array[at] = value
        return {**state, name: array}

    broken = [{name: array for name, array in state.items() if name != gone} for gone in state]
    broken += [{**state, name: array[:-1]} for name, array in state.items() if len(array)]
    broken += [{**state, "more": np.zeros(1)}, {**state, "A": state["A"].astype(np.uint64)}]
    broken += [
        changed(name, 0, np.nan)
        for name, array in state.items()
        if array.dtype == np.float64
        if len(array)
    ]
    broken += [
        changed("format", 0, 1),
        changed("format", 1, 2**40),
        changed("steps", 0, 99),
        changed("steps", 1, 0),
        changed("key", 0, state["key"][0] ^ 1),
        changed("A.fused", 3, -100.0),
        changed("xf.hits", 3, 100.0),
        changed("x0.state", 0, 0.0),
        *(changed("x0.state", at, 100.0) for at in range(2, 8)),
        *(changed("A.state", at, -1e300) for at in range(2, 8)),
        changed("trace.v", 0, -1.0),
        changed("products", 0, 100.0),
        changed("prod.sum", 0, 1e5),
        changed("drift", 0, -1.0),
        changed("trace.k", 0, 5),
    ]
    for sections in broken:
        with pytest.raises(InputError, match=r"`(state|B|x0|xf|A|values)`"):
            se.Stream._from_sections(sections)
    assert same(se.Stream._from_sections(state), good)


def test_trace_is_thin_and_the_same_in_one_run_or_many():
    one, many = make(3), make(3)
    one.run(max_steps=10_000)
    for count in (1, 9, 990, 9000):
        many.run(max_steps=count)
    assert same(one, many)
    trace = one.trace
    assert list(trace.steps[:17]) == list(range(17))
    assert len(trace) < 110
    assert np.all(np.diff(trace.steps) > 0)
    assert trace.steps[-1] == 9216
    later = make(3)
    later.step(256)
    assert later.trace.errors[-1] == trace.errors[trace.steps == 256][0]
    # `error` is that of the control in doubles
    assert later.error == pytest.approx(later.trace.errors[-1], rel=1e-12)
    assert later.trace.certificates[-1] == later.certificate


# -- runs ----------------------------------------------------------------------------------------


def test_how_runs_end():
    stream = make(1)
    run = stream.run(max_steps=1234)
    assert (run.status, run.steps, run.rule) == ("max_steps", 1234, None)
    timed = stream.run(time_limit=0.05)
    assert timed.status == "time_limit"
    assert timed.steps == stream.steps - 1234
    assert timed.seconds >= 0.05
    late = make(1)
    tol = late.certificate * 1e-3
    late.step(0x7FFF)
    done = late.run(tol=tol, max_steps=3)  # less than n steps: looked at after the last one
    assert done.status == ("converged" if done.certificate <= tol else "max_steps")


def test_nothing_to_control_has_no_negative_error():
    stream = se.Stream((np.eye(2), np.zeros((2, 1))), [1.0, 2.0], [0.0, 0.0], rng=1)
    assert not np.signbit(stream.error)


def test_progress(capsys):
    seen = []
    stream = make(1)

    def told(done, total):
        seen.append((done, total))
        if len(seen) == 3:
            raise KeyboardInterrupt

    assert stream.run(tol=1e-300, progress=told).status == "interrupted"
    assert len(seen) == 3
    assert seen[-1] == (stream.steps, None)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    stream.run(max_steps=1000, progress=True)
    assert capsys.readouterr().out == ""


FORKED = """
import os, threading, time
import numpy as np
import stochens_rs as se

B, x, A = np.eye(50), np.ones(50), np.random.default_rng(0).standard_normal((50, 50)) / 50
busy, idle = se.Stream((A, B), x, x, rng=1), se.Stream((A, B), x, x, rng=1)
thread = threading.Thread(target=busy.step, args=(10**12,), daemon=True)
thread.start()
clock = time.pthread_getcpuclockid(thread.ident)
while time.clock_gettime(clock) < 0.1:  # it can only have worked in that call
    time.sleep(0.01)
child = os.fork()
if child == 0:
    for use in (lambda: busy.steps, busy.step, lambda: busy.save("/nowhere")):
        try:
            use()
            os._exit(2)
        except se.exceptions.InputError as error:
            assert "`stream` was in use by a thread when this process was forked" in str(error)
    assert "in use" in repr(busy)
    idle.step(1000)
    workers = [threading.Thread(target=idle.step, args=(10**4,)) for _ in range(2)]
    [worker.start() for worker in workers]
    [worker.join() for worker in workers]
    os._exit(0 if idle.steps == 21_000 else 3)
limit = time.monotonic() + 200
while time.monotonic() < limit:
    done, status = os.waitpid(child, os.WNOHANG)
    if done:
        print("ended", os.waitstatus_to_exitcode(status), flush=True)
        break
    time.sleep(0.02)
else:
    os.kill(child, 9)
    print("waits for ever", flush=True)
os._exit(0)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_child_forked_while_a_thread_steps():
    run = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True)
    assert run.stdout == "ended 0\n", run.stderr


# -- bad input -----------------------------------------------------------------------------------


def test_arguments_are_not_modified_and_not_kept():
    inputs, x0, xf, matrix = (np.array(v) for v in (B, X0, XF, A))
    stream = se.Stream((matrix, inputs), x0, xf, rng=1)
    for array, value in ((inputs, B), (x0, X0), (xf, XF), (matrix, A)):
        np.testing.assert_array_equal(array, value)
        array[...] = np.nan
    stream.step(50)
    other = make(1)
    other.step(50)
    np.testing.assert_array_equal(stream.u, other.u)
    with pytest.raises(SizeError):
        stream.step(0)
