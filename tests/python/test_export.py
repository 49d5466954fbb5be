"""Controllers in C compile without a warning, agree with the core, and survive what is read."""

from __future__ import annotations

import functools
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stochens_rs as se
from controllers import BROKEN, FLAGS, KINDS, Controller, compiler
from coverage_study import sets
from stochens_rs.exceptions import InputError

pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
needs_gcc = pytest.mark.skipif(compiler() is None, reason="no gcc: controllers are not compiled")


def made(kind: str, seed: int) -> Any:
    return KINDS[kind](np.random.default_rng([seed, list(KINDS).index(kind)]))


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The controller `one` of made(kind, seed), where what C does not define ends the process."""
    how = ["-fsanitize=undefined", "-fsanitize-undefined-trap-on-error"]

    @functools.cache
    def once(kind: str, seed: int, single: bool) -> tuple[Path, Controller]:
        loop, file = made(kind, seed), tmp_path_factory.mktemp("c") / "one.h"
        loop.to_c(file, name="one")
        return file, Controller(file, sizes(loop)[1], single, how)

    def started(kind: str, seed: int, single: bool = False) -> tuple[Any, Path, Controller]:
        file, c = once(kind, seed, single)
        c.start()
        return made(kind, seed), file, c

    return started


def sizes(loop: Any) -> tuple[int, int]:
    if hasattr(loop, "K"):
        return loop.K.shape[1], loop.K.shape[0]
    if hasattr(loop, "model"):
        return loop.model.n_outputs, loop.model.m
    return loop.n, loop.m


def readings(loop: Any, rng: Any, steps: int) -> Any:
    """What a plant about the model gives, with broken, missing and false readings among it."""
    n, _ = sizes(loop)
    y = np.cumsum(0.1 * rng.standard_normal((steps, n)), axis=0)
    if hasattr(loop, "model") and not hasattr(loop, "K"):
        data = loop.model.data.pairs()[0]
        y = data[rng.integers(len(data) - steps) :][:steps].copy()
        y += 40.0 * data.std(axis=0) * (rng.random(steps) < 0.02)[:, None]
        y[rng.random(steps) < 0.02] = np.nan
    for t in np.flatnonzero(rng.random(steps) < 0.03):
        y[t, rng.integers(n)] = BROKEN[rng.integers(len(BROKEN))]
    return y


def called(loop: Any, y: Any, last: Any) -> Any:
    if hasattr(loop, "K"):  # a gain has no state: it refuses what the controller holds
        return loop(y) if (np.abs(y) <= 1e150).all() else last
    return loop(y)


def aimed(loop: Any, c: Controller, rng: Any) -> None:
    """Another target for both: rows where there are some, for readings the one behind it."""
    y, wide, shape = loop.target, 0.3, np.shape(loop.target)
    if hasattr(loop, "model"):
        shape = (1 if loop._law or loop._asked else 2, len(y))
        wide = 0.2 * loop.model.data.pairs()[0].std(axis=0)
    off = wide * rng.standard_normal(shape)
    for share in (1.0, 0.2, 0.0):  # until it is a point of rest within the limits
        try:
            loop.target = y + share * off
        except se.StochensError:
            continue
        assert c.aim(np.nan_to_num(y + share * off)) == 0
        return


def differences(loop: Any, c: Controller, y: Any, rng: Any = None) -> Any:
    _, m = sizes(loop)
    last, found = np.array([c.c.applied()[j] for j in range(m)], dtype=np.float64), []
    for t, row in enumerate(y):
        if rng is not None and not hasattr(loop, "K") and t % 40 == 20:
            aimed(loop, c, rng)
        last = called(loop, row, last)
        _, u = c.step(row)
        terms = [c.c.size(j) for j in range(m)]  # that add up to an input of a plan
        found.append(np.abs(u - last).max() / max(1.0, np.abs(last).max(), *terms))
        for j in range(m):  # what acts is one input
            c.c.applied()[j] = last[j]
    return np.array(found)


SOAKED = [pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 2 + sets(5, 0))]


@needs_gcc
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [1, *SOAKED])
def test_the_controller_is_the_loop(kind: str, seed: int, compiled: Any) -> None:
    """A million steps of 40 loops in `make soak`."""
    loop, file, c = compiled(kind, seed)
    rng = np.random.default_rng(seed)
    for _ in range(1 if seed == 1 else 125):
        assert differences(loop, c, readings(loop, rng, 200), rng).max() < 1e-12
    head = file.read_text("utf-8").partition("*/")[0]
    size = re.search(r"tables, (\d+) of state", re.sub(r"\n \* +", " ", head))
    assert size is None or int(size[1]) <= c.c.bytes()


@needs_gcc
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "gain"])
def test_a_target_that_cannot_be_changes_nothing(kind: str, compiled: Any) -> None:
    loop, file, c = compiled(kind, 1)
    size = int(re.search(r"_TARGETS (\d+)", file.read_text())[1])  # type: ignore
    rows = np.zeros((size, sizes(loop)[0]))
    for at, value in enumerate(BROKEN):
        rows.ravel()[at % rows.size] = value
        assert c.aim(rows) == 1
    assert differences(loop, c, readings(loop, np.random.default_rng(2), 100)).max() < 1e-12


@needs_gcc
@pytest.mark.parametrize(
    ("kind", "table"),
    [("gain", "one_K"), ("rates", "one_inverse"), ("rates", "one_aims"), ("readings", "one_K")],
)
def test_another_number_makes_another_controller(kind: str, table: str, tmp_path: Path) -> None:
    loop, file = made(kind, 1), tmp_path / "one.h"
    loop.to_c(file, name="one")
    text = file.read_text("utf-8")
    at = text.index("ONE_", text.index(f" {table}[")) + 6
    file.write_text(f"{text[:at]}1e-9 + {text[at:]}", "utf-8")
    c = Controller(file, sizes(loop)[1])
    assert differences(loop, c, readings(loop, np.random.default_rng(1), 200)).max() > 1e-12


@needs_gcc
@pytest.mark.parametrize("single", [False, True], ids=["double", "single"])
@pytest.mark.parametrize("kind", KINDS)
def test_no_reading_makes_a_nan(kind: str, single: bool, compiled: Any) -> None:
    (loop, _, c), rng = compiled(kind, 1, single), np.random.default_rng(3)
    n, m = sizes(loop)
    low, high = getattr(loop, "limits", (np.full(m, -np.inf), np.full(m, np.inf)))
    last, codes, given = np.zeros(m), set(), [*BROKEN, 0.0, -0.0, 1e-310, 3e38, 1e17, -1e17, 1.0]
    for t in range(sets(2000, 150)):
        y = rng.choice(given, n) if t % 3 else rng.standard_normal(n) * 10.0 ** rng.uniform(-5, 5)
        with np.errstate(over="ignore"):
            code, u = c.step(y)
        codes.add(code)
        assert np.isfinite(u).all(), (t, y, code)
        edge = 1e-6 if single else 0.0  # the limits are rounded, too
        assert (u >= low - edge).all()
        assert (u <= high + edge).all()
        if code == 1 and kind in ("gain", "readings"):
            assert (u == last).all()
        last = u
    assert {1} <= codes <= {0, 1, 2, 3, 4} or codes == {2}


@needs_gcc
@pytest.mark.parametrize("kind", KINDS)
def test_single_precision_is_near(kind: str, compiled: Any) -> None:
    loop, _, c = compiled(kind, 1, single=True)
    n = sizes(loop)[0]
    y = readings(loop, np.random.default_rng(1), 200)
    y[~np.isfinite(y) | (np.abs(y) > 1e9)] = np.nan  # what is huge is another number there
    with np.errstate(over="ignore"):
        found = differences(loop, c, y.reshape(-1, n))
    assert 1e-12 < np.quantile(found, 0.95) < 1e-3


@needs_gcc
def test_single_precision_is_in_the_tube_of_the_head(tmp_path: Path) -> None:
    """Every plant of the region, with the compiled controller beside the loop of exact numbers."""
    rng = np.random.default_rng(4)
    A, B = np.array([[1.1, 0.3], [-0.2, 0.9]]), np.array([[0.1], [1.0]])
    x, u, w = (
        rng.standard_normal((100, 2)),
        rng.standard_normal((100, 1)),
        rng.standard_normal((100, 2)),
    )
    x *= [1.0, 30.0]
    data = se.Trajectories.from_pairs(x, u, x @ A.T + u @ B.T + 0.05 * w)
    loop = se.gain(se.identify(data, noise=0.05), 1.0, 1.0)
    proof = loop.certificate()
    loop.to_c(tmp_path / "one.h", name="one", proof=proof)
    head = (tmp_path / "one.h").read_text("utf-8").partition("*/")[0]
    assert "single precision: float32, 95 %, off by at most x[0] " in re.sub(r"\n \* +", " ", head)
    first, most, part = np.abs(x).max(axis=0), np.zeros(2), proof.region.parts[0]
    bound = proof.rounding(first).states
    L, c = np.linalg.cholesky(part.S * part.factor), Controller(tmp_path / "one.h", 1, single=True)
    for _ in range(20):
        a, b = rng.standard_normal(2), rng.standard_normal(3)
        off = np.outer(L @ a, b @ part.white) / np.linalg.norm(a) / np.linalg.norm(b)
        plant = np.asarray(proof.region.centre) + 0.99 * off
        near = exact = first
        for _ in range(60):
            near = plant @ np.concatenate([near, c.step(near)[1]])
            exact = plant @ np.concatenate([exact, loop.K @ exact])
            most = np.maximum(most, np.abs(near - exact))
    assert (1e-3 * bound < most).all()
    assert (most <= bound).all()


@needs_gcc
def test_plans_that_single_precision_does_not_resolve(tmp_path: Path) -> None:
    """Three inputs for one output: all but its own weight of 1e-8 is rounding there."""
    rng = np.random.default_rng(5)
    A, B = np.diag([0.9, 0.8, 0.7, 1.05]), rng.standard_normal((4, 3))
    cost = se.Cost(Q=[1.0, 0.0, 0.0, 0.0], R="auto")
    loop = se.regulate((A, B), 2, limits=(-np.ones(3), np.ones(3)), cost=cost)
    loop.to_c(tmp_path / "one.h", name="one")
    pair = [Controller(tmp_path / "one.h", 3, single) for single in (True, False)]
    codes, off = set(), 0.0
    for _ in range(500):
        x = 5.0 * rng.standard_normal(4)
        (code, u), (_, v) = (c.step(x) for c in pair)
        codes.add(code)
        off = max(off, np.abs(u - v).max())
    assert codes == {0}
    assert off < 1e-2
    narrow = tmp_path / "two.h"
    text = (tmp_path / "one.h").read_text("utf-8").replace("one", "two").replace("ONE", "TWO")
    narrow.write_text(text.replace("TWO_WIDE 1", "TWO_WIDE 0"), "utf-8")
    c, x = Controller(narrow, 3, single=True), 5.0 * rng.standard_normal((500, 4))
    assert 3 in {c.step(row)[0] for row in x}


BUILDS = {
    "clang": ("clang",),
    "32 bits": ("gcc", "-m32"),
    "single precision": ("gcc", "-O1", "-DALL_FLOAT"),
    "sanitizers": ("gcc", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"),
    "valgrind": ("gcc", "-g"),
    "Cortex-M4": ("arm-none-eabi-gcc", "-mcpu=cortex-m4", "-mthumb", "-Os", "--specs=nosys.specs"),
}
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in list(BUILDS)[3:] if sets(1, 0)]
FILE = """{includes}#include <math.h>
static double draw(int t, int i)
{{
    static unsigned long seed = 1;
    seed = (seed * 1103515245UL + 12345UL) & 0x7fffffffUL;
    if (t % 20 == 7 + i)
        return 0.0 * HUGE_VAL;
    return t % 30 == 11 ? 1e30 : (double)seed / 1073741824.0 - 1.0;
}}
int main(void)
{{
    int code = 0;
{calls}    return code;
}}
"""
CALLED = """    {{
        static {name} s;
        static {name}_real y[9], u[9], r[200];
        {name}_start(&s);
        for (int t = 0; t < 60; ++t) {{
            for (int i = 0; i < 9; ++i)
                y[i] = ({name}_real)draw(t, i);
            r[t] = u[0];
            code |= {name}_step(&s, y, u) > 4 || {target};
        }}
    }}
"""
LOOKED = """    {{
        static {name}_alarm a;
        static {name}_real y[9], u[9];
        {name}_alarm_start(&a);
        for (int t = 0; t < 60; ++t)
            code |= {name}_look(&a, y, u) > 3;
    }}
"""


@needs_gcc
@pytest.mark.parametrize("build", [*list(BUILDS)[:3], *SLOW])
def test_it_compiles_without_a_warning(build: str, tmp_path: Path) -> None:
    """Several controllers in one file, one with an alarm; all kinds and builds in `make soak`."""
    command, *how = BUILDS[build]
    runner = ["valgrind", "-q", "--error-exitcode=3"] if build == "valgrind" else []
    for one in (command, *runner[:1]):
        if compiler(one) is None:
            pytest.skip(f"no {one} here")
    (tmp_path / "a.c").write_text("#include <math.h>\nint main(void) { return 0; }\n")
    if subprocess.run([command, *how, "a.c"], cwd=tmp_path, capture_output=True).returncode:
        pytest.skip(f"no libraries for {build} here")
    loops = [(kind, 1) for kind in ("gain", "rates", "readings", "readings, plans")]
    if sets(1, 0):
        loops, how = [(kind, seed) for kind in KINDS for seed in (1, 2, 3)], ["-O2", *how]
    includes = calls = ""
    for at, (kind, seed) in enumerate(loops):
        name, loop = f"c{at}", made(kind, seed)
        if (kind, seed) == ("readings", 1):
            loop.watch = loop.certificate(0.2).watch()
            calls += LOOKED.format(name=name)
        loop.to_c(tmp_path / f"{name}.h", name=name)
        includes += f"#define C{at}_FLOAT\n" * ("-DALL_FLOAT" in how) + f'#include "{name}.h"\n'
        target = "r[0] > 1e30f" if kind == "gain" else f"{name}_target(&s, r) > 1"
        calls += CALLED.format(name=name, target=target)
    (tmp_path / "a.c").write_text(FILE.format(includes=includes, calls=calls))
    run = [command, *FLAGS, *how, "a.c", "-lm"]
    done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    if build != "Cortex-M4":
        done = subprocess.run([*runner, tmp_path / "a.out"], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


@needs_gcc
def test_known_plans(tmp_path: Path) -> None:
    """|u| <= 1 from 5 by steps of one; two steps with a rate from u = 0: -2/5."""
    cost = se.Cost(Q=1.0, Qf=1.0, R=1.0)
    se.regulate(([[1.0]], [[1.0]]), 1, limits=(-1.0, 1.0), cost=cost).to_c(
        tmp_path / "a.h", name="a"
    )
    c, x, found = Controller(tmp_path / "a.h", 1), 5.0, []
    for _ in range(6):
        found.append(float(c.step([x])[1][0]))
        x += found[-1]
    np.testing.assert_allclose(found, [-1.0, -1.0, -1.0, -1.0, -0.5, -0.25], rtol=1e-14)
    limits = se.Limits(u=(-0.5, 0.5), rate=0.5, previous=0.0)
    system = [[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]]
    last = se.Cost(Qf=1.0, R=0.0001)
    loop = se.regulate(system, 2, limits=limits, cost=last)
    loop.to_c(tmp_path / "b.h", name="b")
    assert abs(Controller(tmp_path / "b.h", 1).step([1.0, 0.0])[1][0] + 0.4) < 1e-3


@needs_gcc
def test_what_acts_may_be_anywhere(tmp_path: Path) -> None:
    """Limits are kept before rates, and what no number can be is not taken for what acts."""
    limits = se.Limits(u=(-1.0, 1.0), rate=0.1, previous=0.0)
    se.regulate(([[1.0]], [[1.0]]), 4, limits=limits).to_c(tmp_path / "one.h", name="one")
    c = Controller(tmp_path / "one.h", 1)
    for y in (np.nan, 3.0):
        c.start()
        c.c.applied()[0] = np.nan
        assert abs(c.step([y])[1][0]) <= 0.1
        c.c.applied()[0] = 5.0
        assert c.step([y])[1] == 1.0
        c.c.applied()[0] = np.nan
        assert 0.9 <= c.step([y])[1][0] <= 1.0


@needs_gcc
def test_an_unstable_plant_over_many_steps(tmp_path: Path) -> None:
    """A cart-pole that grows by 4000 over the horizon: the core and C plan alike."""
    A = [[1, 0.01, 0, 0], [0, 1, 0.039, 0], [0, 0, 1.002, 0.01], [0, 0, 0.458, 1.002]]
    system = np.array(A), np.array([[0.0], [0.02], [0.0], [0.067]])
    rng, x = np.random.default_rng(1), np.array([0.5, 0.0, 0.05, 0.0])
    loop = se.regulate(system, 125, limits=(-0.5, 0.5), cost=se.Cost(Q=[10.0, 1, 10, 1], R=1.0))
    loop.to_c(tmp_path / "one.h", name="one")
    c, off, cut = Controller(tmp_path / "one.h", 1, more=["-O1"]), 0.0, 0
    for k in range(160):
        u = loop(x)
        off, cut = max(off, abs(c.step(x)[1] - u).item()), cut + int(abs(u[0]) > 0.499)
        x = system[0] @ x + system[1] @ u + 1e-3 * rng.standard_normal(4)
        assert abs(x[2]) < 0.2  # it does not fall
        if k % 40 == 39:
            x = np.array([0.5, 0.1, 0.03, 0.05]) * rng.uniform(-1.0, 1.0, 4)
    assert cut > 20
    assert off < 1e-12


@needs_gcc
def test_an_early_end_is_safe(tmp_path: Path) -> None:
    """With room for one exchange the code says so, and limits and rates are kept."""
    rng, file = np.random.default_rng(5), tmp_path / "one.h"
    limits = se.Limits(u=(-1.0, 1.0), rate=0.3, previous=0.0)
    loop = se.regulate(se.cases.ieee14(dt=0.1), 8, limits=limits, cost=se.Cost(Q=1.0, R=0.1))
    loop.to_c(file, name="one")
    text = file.read_text("utf-8")
    most = int(re.search(r"ONE_EXCHANGES (\d+)", text)[1])  # type: ignore[index]
    assert f"exchanges: {most} at most" in text
    full = Controller(file, loop.m)
    file = tmp_path / "two.h"
    file.write_text(re.sub(r"(ONE_EXCHANGES) \d+", r"\1 1", text).replace("one", "two"), "utf-8")
    early, last, codes, counts = Controller(file, loop.m), np.zeros(loop.m), [], []
    for _ in range(100):
        x = 20.0 * rng.standard_normal(loop.n)
        code, u = early.step(x)
        codes.append(code)
        assert (np.abs(u) <= 1.0).all()
        assert (np.abs(u - last) <= 0.3 + 1e-15).all()
        last = u
        assert full.step(x)[0] == 0
        counts.append(full.c.exchanges())
    assert codes.count(3) > 50
    assert 8 < max(counts) < most


def test_the_head_says_what_is_proved(tmp_path: Path) -> None:
    x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
    data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
    loop = se.gain(se.identify(data, noise=0.1), 1.0, 1.0)
    loop.to_c(tmp_path / "c.h")
    head = (tmp_path / "c.h").read_text("utf-8").partition("*/")[0]
    for part in (
        "certified for every system of the region (95 %): stable, margin at least 6.07",
        "delta: 0.05",
        "Gaussian noise of known covariance",
        "40 pairs, sha256 ",
        "reads: y = x[0]",
    ):
        assert part in re.sub(r"\n \* +", " ", head)
    other = se.gain(loop.model, 1.0, 2.0)
    with pytest.raises(se.StochensError, match="`proof` must be of this gain"):
        other.to_c(tmp_path / "c.h", proof=loop.certificate())
    named = se.System([[1.2]], [[1.0]], states=["*/ #error"], inputs=["\\"], units={"\\": "??/"})
    se.gain(named, 1.0, 1.0).to_c(tmp_path / "d.h")
    assert (tmp_path / "d.h").read_text("utf-8").count("*/ #error") == 0


def test_what_is_not_written_says_so(tmp_path: Path) -> None:
    loop = se.gain(([[1.2]], [[1.0]]), 1.0, 1.0)
    for name in ("", "Cart", "1a", "a-b", "x" * 40, 3):
        with pytest.raises(se.StochensError, match="`name` must be"):
            loop.to_c(tmp_path / "c.h", name=name)  # type: ignore[arg-type]
    for soft, steps, why in (False, 3, "leave out `soft=False`"), (True, 200, "(1 MB): give fewer"):
        within = se.Limits(u=(-1.0, 1.0), x=(-1.0, 1.0), soft=soft)
        with pytest.raises(se.StochensError, match=re.escape(why)):
            se.regulate(([[0.9]], [[1.0]]), steps, limits=within).to_c(tmp_path / "c.h")
    assert list(tmp_path.iterdir()) == []


def test_matrices_and_the_closed_loop() -> None:
    loop = se.gain(se.System([[1.2]], [[1.0]], dt=0.5, states=["p"], inputs=["f"]), 1.0, 1.0)
    found = loop.matrices()
    assert found["closed"] == found["A"] + found["B"] @ found["K"]
    control = pytest.importorskip("control")
    closed = loop.to_control()
    assert (closed.state_labels, closed.input_labels, closed.dt) == (["p"], ["f"], 0.5)
    response = control.impulse_response(closed, T=np.arange(3) * 0.5)
    a = found["closed"].item()
    np.testing.assert_allclose(response.outputs.ravel() * 0.5, [0.0, 1.0, a], atol=1e-12)


def test_the_proof_of_a_loop_from_readings_stands_in_its_head(tmp_path: Path) -> None:
    loop, other = (made("readings", seed) for seed in (1, 2))
    proof, file = loop.certificate(0.2), tmp_path / "one.h"
    loop.watch = watch = proof.watch(every=1e4)
    rng = np.random.default_rng(1)
    for _ in range(300):
        loop(rng.standard_normal(loop.model.n_outputs) * loop.model.data.rows.max())
    loop.to_c(file, proof=proof)
    head = re.sub(r"\n \* +", " ", file.read_text("utf-8").partition("*/")[0])
    assert "delta: 0.2," in head
    assert f"alarm: {watch.statement}; controller_look" in head  # not what this run has seen
    with pytest.raises(InputError, match="`proof` must be of this gain"):
        loop.to_c(file, proof=other.certificate(0.2))
