"""The file of a study: continued, refused, damaged, merged, and hostile."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import stochens_rs as se
import study_functions as functions
from coverage_study import sets
from stochens_rs._base import files as state_file
from stochens_rs.exceptions import (
    InputError,
    ResourceError,
    StateError,
    StateIOError,
    StateLockedError,
    StateNotFoundError,
)
from stochens_rs.studies import running, tasks
from stochens_rs.studies import study as study_module
from stochens_rs.studies.tasks import DONE, FAILED, Block, StudyFile
from study_functions import noise, slow, sometimes

GRID = {"scale": [1.0, 2.0]}


def study(replicates: int | range = 20, **changed: object) -> se.Study:
    given = {"function": noise, "grid": GRID, "rng": 5, **changed}
    return se.Study(replicates=replicates, **given)  # type: ignore[arg-type]


@pytest.fixture(autouse=True)
def _written_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_module, "EVERY", 0.0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A study that is done."""
    found = tmp_path / "a.study"
    study().run(path=found)
    return found


WHOLE = study().run()


# -- continued -------------------------------------------------------------------------------------


def test_a_file_has_all_numbers(path: Path) -> None:
    assert se.Study.resume(path).results.digest == WHOLE.digest
    before = path.read_bytes()
    assert study().run(path=path).digest == WHOLE.digest
    assert path.read_bytes() == before  # nothing ran, nothing was written


def test_a_run_continues_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, clock = tmp_path / "a.study", functions.Clock()
    for module in (running, study_module, functions):
        monkeypatch.setattr(module, "time", clock)
    first = study(300, function=slow).run(path=path, time_limit=0.2)
    assert first.status == "time_limit"
    assert 50 <= first.done.sum() <= 75
    again = study(300, function=slow).run(path=path, time_limit=0.2)
    assert 100 <= again.done.sum() <= 150
    assert np.all(again.done | ~first.done)
    third = se.Study.resume(path, slow)
    assert third.results.digest == again.digest
    assert third.run(path=path).digest == study(300).run().digest
    assert se.Study.resume(path).results.status == "completed"


def test_more_replicates_continue_it_and_fewer_are_refused(path: Path) -> None:
    assert study(50).run(path=path).digest == study(50).run().digest
    assert len(se.Study.resume(path).replicates) == 50
    interrupted = study(80).run(path=path, time_limit=1e-9)
    assert interrupted.status == "time_limit"
    assert se.Study.resume(path, noise).run(path=path).digest == study(80).run().digest
    with pytest.raises(StateError, match=r"`replicates` of .* is .*0, 80.*, of this study .*0, 9"):
        study(9).run(path=path)


def test_numbers_found_before_are_written(tmp_path: Path) -> None:
    made = study()
    made.run()
    made.run(path=tmp_path / "a.study")
    assert se.Study.resume(tmp_path / "a.study").results.digest == WHOLE.digest


def test_blocks_of_workers_are_written_soon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also if the next one takes long."""
    monkeypatch.setattr(study_module, "EVERY", 0.2)
    path, seen = tmp_path / "a.study", []

    def waits(key: se.Key, scale: float) -> dict[str, float]:
        end = time.monotonic() + 100
        while scale == 2.0 and time.monotonic() < end and not seen:
            if path.exists() and se.Study.resume(path).results.done[0].sum() == 2:
                seen.append(True)
            time.sleep(0.02)
        return noise(key, scale)

    with ThreadPoolExecutor(4) as threads:
        study(2, function=waits).run(threads, path)
    assert seen


def test_failures_are_in_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.study"
    made = se.Study(sometimes, GRID, replicates=40, rng=8)
    results = made.run(path=path)
    loaded = se.Study.resume(path, sometimes)
    assert loaded.results.digest == results.digest
    assert loaded.results.failures == results.failures != ()
    monkeypatch.setenv("STUDY_TEST_CALM", "1")
    calm = se.Study(noise, GRID, replicates=40, rng=8).run()
    assert loaded.run(path=path).digest == results.digest
    assert loaded.run(path=path, retry=True).digest == calm.digest
    assert se.Study.resume(path).results.digest == calm.digest
    assert se.Study.resume(path).results.failures == ()


def test_without_the_function_numbers_can_be_read_only(path: Path) -> None:
    loaded = se.Study.resume(path)
    assert loaded.results.about["function"] == "study_functions.noise"
    with pytest.raises(InputError, match=r"`function` must be given: Study.resume\(path, function"):
        loaded.run()


# -- refused ---------------------------------------------------------------------------------------

SYSTEM = se.System([[0.5]], [[1.0]])


def with_system(key: se.Key, system: se.System) -> dict[str, float]:
    return {"a": system.A[0, 0]}


DIFFERENT = {
    "key": {"rng": 6},
    "grid": {"grid": {"scale": [1.0, 3.0]}},
    "nested": {"nested": "scale"},
    "shared": {"shared": ["scale"]},
    "function": {"function": slow},
}


@pytest.mark.parametrize("field", DIFFERENT)
def test_what_disagrees_is_named(path: Path, field: str) -> None:
    before = path.read_bytes()
    with pytest.raises(StateError, match=f"^`{field}` of .* is .*, of this study .*: continue it"):
        study(**DIFFERENT[field]).run(path=path)
    assert path.read_bytes() == before
    with pytest.raises(StateError, match="`function"):
        se.Study.resume(path, slow)


def test_a_changed_function_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By its name, its source text, its `version`, and what a partial function or an object has."""
    made = {}
    for k, body in enumerate(("scale + 1.0", "scale + 2.0", "scale + 1.0")):
        source = tmp_path / f"users_module_{k}.py"
        source.write_text(f"def kept(key, scale):\n    return {{'x': {body}}}\n")
        space: dict[str, object] = {"__name__": "users_module"}
        exec(compile(source.read_text(), source, "exec"), space)
        made[k] = space["kept"]
    noisy = partial(scaled, factor=np.eye(2))
    studies = {
        "one": {"function": made[0]},
        "other text": {"function": made[1]},
        "other version": {"function": made[0], "version": "2"},
        "lambda": {"function": lambda key, scale: {"x": scale}},
        "partial": {"function": noisy},
        "other partial": {"function": partial(scaled, factor=2 * np.eye(2))},
        "object": {"function": Scaled(1.0)},
        "other object": {"function": Scaled(2.0)},
        "method": {"function": Scaled(1.0).method},
        "other method": {"function": Scaled(2.0).method},
    }
    found = {name: study(**given)._described() for name, given in studies.items()}
    assert len({one.function_digest for one in found.values()}) == len(found)
    assert study(function=made[2])._described() == found["one"]
    assert study(function=partial(scaled, factor=np.eye(2)))._described() == found["partial"]
    assert study(function=Scaled(1.0))._described() == found["object"]
    path = tmp_path / "a.study"
    study(**studies["other version"]).run(path=path)
    with pytest.raises(StateError, match=r"`function_digest` of"):
        study(function=made[1], version="2").run(path=path)
    with pytest.raises(StateError, match=r"`version` of .* is 2, of this study 3"):
        study(function=made[0], version="3").run(path=path)
    assert se.Study.resume(path, made[0]).run(path=path).status == "completed"  # type: ignore[arg-type]


def scaled(key: se.Key, scale: float, factor: np.ndarray) -> dict[str, float]:
    return {"x": scale * factor[0, 0]}


class Scaled:
    def __init__(self, by: float) -> None:
        self.by = by

    def __call__(self, key: se.Key, scale: float) -> dict[str, float]:
        return {"x": scale * self.by}

    def method(self, key: se.Key, scale: float) -> dict[str, float]:
        return {"x": scale * self.by}


def test_without_source_text_a_version_is_needed(tmp_path: Path) -> None:
    space: dict[str, object] = {"__name__": "nowhere"}
    exec("def kept(key, scale):\n    return {'x': scale}", space)
    function, path = space["kept"], tmp_path / "a.study"
    with pytest.raises(InputError, match=r"`version` must be given: nowhere.kept has no source"):
        study(function=function).run(path=path)
    assert study(function=function).run().status == "completed"  # without a file it can run
    assert study(function=function, version="1").run(path=path).status == "completed"


def test_changed_objects_are_noticed(tmp_path: Path) -> None:
    path = tmp_path / "a.study"
    grid = {"system": {"only": SYSTEM}}
    study(function=with_system, grid=grid).run(path=path)
    same = {"system": {"only": se.System([[0.5]], [[1.0]])}}
    assert se.Study.resume(path, with_system, same).run(path=path).status == "completed"
    with pytest.raises(StateError, match="`digests` of"):
        se.Study.resume(path, with_system)  # the system itself is not in the file
    other = {"system": {"only": se.System([[0.6]], [[1.0]])}}
    with pytest.raises(StateError, match="`digests` of"):
        study(function=with_system, grid=other).run(path=path)


@pytest.mark.parametrize("value", [threading.Lock(), (k for k in [1]), [{"a": memoryview(b"")}]])
def test_what_cannot_be_kept_is_refused(value: object, tmp_path: Path) -> None:
    grid, path = {"scale": {"odd": value}}, tmp_path / "a.study"
    given = {"function": lambda key, scale: {"x": 1.0}, "grid": grid}
    with pytest.raises(InputError, match=r"`grid\['scale'\]` holds what cannot be kept"):
        study(**given).run(path=path)
    with pytest.raises(InputError, match=r"`function` holds what cannot be kept"):
        study(function=partial(scaled, factor=value)).run(path=path)
    assert study(**given).run().status == "completed"


def test_another_platform_is_refused(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = se.Study.resume(path, noise)
    elsewhere = {**tasks.fingerprint(), "numpy": "1.26.0"}
    for module in (running, study_module):
        monkeypatch.setattr(module, "fingerprint", lambda: elsewhere)
    assert loaded.run(path=path).digest == WHOLE.digest  # nothing is left to run
    with pytest.raises(StateError, match=r"`numpy` of the numbers so far is .*, here it is 1.26.0"):
        study(30).run(path=path)


def test_two_writers_are_refused(path: Path) -> None:
    seen = []

    def second(done: int, total: int | None) -> None:
        if not seen:
            with pytest.raises(StateLockedError):
                study(40).run(path=path)
            assert len(se.Study.resume(path).replicates) == 30  # reading is free
            seen.append(done)

    study(30).run(path=path, progress=second)
    assert seen
    study(40).run(path=path)


def test_an_exception_of_the_progress_loses_nothing(tmp_path: Path) -> None:
    def stop(done: int, total: int | None) -> None:
        if done >= 10:
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        study().run(path=tmp_path / "a.study", progress=stop)
    assert se.Study.resume(tmp_path / "a.study").results.done.sum() >= 10


# -- damaged ---------------------------------------------------------------------------------------


def records(content: bytes) -> list[int]:
    """Where the records begin, and where the last one ends."""
    ends = [24]
    while ends[-1] < len(content):
        ends.append(ends[-1] + 8 + int.from_bytes(content[ends[-1] :][:8], "little"))
    return ends


def test_a_file_cut_anywhere_is_continued_or_refused(path: Path, tmp_path: Path) -> None:
    """What a writer that was killed left is continued, what was on the disk must be there."""
    content, cut, outcomes = path.read_bytes(), tmp_path / "cut.study", set()
    ends = records(content)
    lengths = [
        *range(0, len(content), 525),
        *(end + k for end in ends[:: sets(1, 3)] for k in (-1, 0, 1)),
    ]
    for length in lengths[:-1]:
        cut.write_bytes(content[:length])
        if length < len(content):
            with pytest.raises(StateError, match=r"is not the file of a study|is damaged at byte"):
                study().run(path=cut)
            assert cut.read_bytes() == content[:length]
        complete = max([end for end in ends if end <= length], default=0)
        if complete > 24:  # killed before or after it said so
            for committed in ends[1 : ends.index(complete) + 1][-2:]:
                cut.write_bytes(tasks.head(committed) + content[24:length])
                outcomes.add(int(se.Study.resume(cut).results.done.sum()))
                assert study().run(path=cut).digest == WHOLE.digest
                assert se.Study.resume(cut).results.digest == WHOLE.digest
                assert records(cut.read_bytes())[-1] == cut.stat().st_size
    assert len(outcomes) > 3


def test_a_changed_bit_anywhere_loses_nothing_without_a_word(
    path: Path, tmp_path: Path, gen: np.random.Generator
) -> None:
    """Every byte of the beginning, and 400 others, in `make test` 120."""
    content, hurt = path.read_bytes(), tmp_path / "hurt.study"
    last = records(content)[-2]
    places = [
        *range(24),
        *gen.choice(len(content), sets(200, 60)),
        *gen.choice(range(last, len(content)), sets(200, 60)),
    ]
    for at in places:
        changed = bytearray(content)
        changed[at] ^= 1 << int(gen.integers(8))
        hurt.write_bytes(changed)
        if 8 <= at < 24:  # of the length: all numbers are there, and it is written again
            assert study().run(path=hurt).digest == WHOLE.digest
            assert hurt.read_bytes() == content
            continue
        with pytest.raises(
            (StateError, ResourceError), match=r"is damaged at byte|not the file of"
        ):
            se.Study.resume(hurt)
    with pytest.raises((StateError, ResourceError)):
        study().run(path=hurt)
    assert hurt.read_bytes() == changed


def test_a_full_disk_leaves_no_part_of_a_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, write = tmp_path / "a.study", StudyFile._write
    calls: list[int] = []

    def full(file: StudyFile, at: int, content: bytes) -> None:
        calls.append(len(content))
        if len(calls) in (6, 11):  # a record, a length
            write(file, at, content[: len(content) // 2])
            raise OSError(28, "No space left on device")
        write(file, at, content)

    monkeypatch.setattr(StudyFile, "_write", full)
    made = study()
    for _ in range(2):
        with pytest.raises(StateIOError, match="No space left"):
            made.run(path=path)
    assert min(calls) == 24 < calls[5]
    assert calls[10] == 24
    assert made.run(path=path).digest == WHOLE.digest
    assert se.Study.resume(path).results.digest == WHOLE.digest


@pytest.mark.parametrize("suffix", [".study", ".json", ".csv", ".nc"])
def test_files_are_made_under_names_that_nobody_knows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    """A planted link is not followed; after a failure nothing is left."""
    path, victim = tmp_path / f"a{suffix}", tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / f"a{suffix}.part").symlink_to(victim)

    def write() -> None:
        if suffix == ".study":
            study().run(path=path)
        else:
            WHOLE.save(path)

    before, rename = set(tmp_path.iterdir()), os.replace

    def fails(*_: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(os, "replace", fails)
    with pytest.raises(OSError, match="Read-only"):
        write()
    assert set(tmp_path.iterdir()) - before <= {tmp_path / "a.study.lock"}
    monkeypatch.setattr(os, "replace", rename)
    leftover = tmp_path / f"a.study.{'0' * 16}.tmp"  # of a writer that was killed
    leftover.touch()
    write()
    assert leftover.exists() == (suffix != ".study")
    assert victim.read_text() == "precious"
    assert path.stat().st_size > 0


@pytest.mark.parametrize("length", [0, 2**31])
def test_gigabytes_of_zeros_behind_a_record_are_not_read(path: Path, length: int) -> None:
    size = path.stat().st_size
    with open(path, "ab") as file:
        file.write(length.to_bytes(8, "little"))
        file.truncate(size + 3 * 2**30)
    began = time.perf_counter()
    assert se.Study.resume(path).results.digest == WHOLE.digest
    assert study().run(path=path).digest == WHOLE.digest
    assert path.stat().st_size == size
    assert time.perf_counter() - began < 2.0


def written(
    path: Path, *contents: dict[str, np.ndarray], numbers: tuple[int, ...] = (1, 2)
) -> Path:
    """A file whose records have correct digests."""
    content = b""
    for number, sections in zip(numbers, contents, strict=False):
        record = state_file.encode("study", number, sections)
        content += len(record).to_bytes(8, "little") + record
    path.write_bytes(tasks.head(24 + len(content)) + content)
    return path


FIRST = Block.of(study()._described())._to_sections()
GOOD = Block(
    np.array([0, 1]),
    np.array([DONE, FAILED], np.int8),
    {"x": np.array([0.5, np.nan])},
    ("E: no",),
    {"numpy": "2"},
)
SECOND = GOOD._to_sections()


def with_tree(sections: dict[str, np.ndarray], **changed: object) -> dict[str, np.ndarray]:
    """The same arrays with other entries in the JSON."""
    tree = {**json.loads(sections["record"].tobytes()), **changed}
    return {**sections, "record": np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8)}


def test_the_hostile_files_are_near_a_good_one(tmp_path: Path) -> None:
    found = se.Study.resume(written(tmp_path / "a", FIRST, with_tree(SECOND))).results
    assert found.values["x"][0, 0] == 0.5
    assert found.failures == (se.studies.Failure({"scale": 2.0}, 0, "E: no"),)


def bits(*values: object, dtype: type = np.int64) -> np.ndarray:
    return np.array(values, dtype).view(np.uint8)


TREE = json.loads(SECOND["record"].tobytes())
SHAPED = TREE["values"]["x"]
HOSTILE = {
    "other shape": with_tree(SECOND, values={"x": {**SHAPED, "shape": [2, 3]}}),
    "vast shape": with_tree(SECOND, values={"x": {**SHAPED, "shape": [2**40, 2**40]}}),
    "number as platform": with_tree(SECOND, platform={"numpy": 3}),
    "no study": with_tree(SECOND, study={"type": "Manifest"}),
    "far task": {"tasks": bits(0, 2**62)},
    "one task": {"tasks": bits(0)},
    "state 9": {"states": bits(DONE, 9, dtype=np.int8)},
    "one more array": {"values.y": np.zeros(2)},
    "done without numbers": with_tree(SECOND, values={}),
}


def refused(path: Path) -> None:
    for use in (se.Study.resume, lambda path: study().run(path=path)):
        with pytest.raises((StateError, ResourceError)) as error:
            use(path)
        assert "\n" not in str(error.value)
        assert str(path) in str(error.value) or isinstance(error.value, ResourceError)


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_blocks(tmp_path: Path, name: str) -> None:
    refused(written(tmp_path / "a.study", FIRST, {**SECOND, **HOSTILE[name]}))


def test_records_out_of_order_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "a.study", FIRST, SECOND, numbers=(1, 3))
    with pytest.raises(StateError, match="must be record 2, got 3"):
        se.Study.resume(path)


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(StateNotFoundError):
        se.Study.resume(tmp_path / "none")
    for name, content in (("empty", b""), ("zeros", bytes(500)), ("text", b"a,b\n1,2\n" * 50)):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(StateError, match="is not the file of a study"):
            study().run(path=tmp_path / name)
        assert (tmp_path / name).read_bytes() == content
    stream = se.Stream(([[2.0]], [[1.0]]), [1.0], [0.0], rng=1)
    stream.save(tmp_path / "stream")
    with pytest.raises(StateError, match="is not the file of a study"):
        se.Study.resume(tmp_path / "stream")
    with pytest.raises((StateError, StateIOError)):
        se.Study.resume(tmp_path)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        with pytest.raises(StateError, match="must be a regular file"):
            se.Study.resume(tmp_path / "pipe")
    with pytest.raises((StateError, StateIOError)):
        study().run(path=tmp_path / "missing" / "a.study")


# -- merged ----------------------------------------------------------------------------------------


def test_parts_become_one(tmp_path: Path) -> None:
    for k, span in enumerate((range(8, 20), range(10), range(4, 9))):
        study(span).run(path=tmp_path / f"{k}.study")
    whole = se.Study.merge([tmp_path / f"{k}.study" for k in range(3)], tmp_path / "all.study")
    assert whole.results.digest == WHOLE.digest
    assert se.Study.resume(tmp_path / "all.study", noise).run().digest == WHOLE.digest
    part = se.Study.merge([tmp_path / "2.study", tmp_path / "1.study"])
    assert len(part.replicates) == 10
    assert part.results.status == "completed"
    hole = se.Study.merge([tmp_path / "2.study"])
    assert hole.replicates == range(4, 9)
    with pytest.raises(InputError, match="`path` must be a new file"):
        se.Study.merge([tmp_path / "1.study"], tmp_path / "all.study")
    with pytest.raises(InputError, match="`paths` must name at least one file"):
        se.Study.merge([])


def test_parts_that_differ_are_refused(tmp_path: Path) -> None:
    study(range(5)).run(path=tmp_path / "0.study")
    study(range(5, 9), rng=6).run(path=tmp_path / "1.study")
    with pytest.raises(StateError, match=r"`key` of .*1.study differs from that of .*0.study"):
        se.Study.merge([tmp_path / "0.study", tmp_path / "1.study"])
    written(tmp_path / "2.study", FIRST, SECOND)
    with pytest.raises(StateError, match=r"2.study: two blocks differ in `x` of the same replicat"):
        se.Study.merge([tmp_path / "0.study", tmp_path / "2.study"])


# -- killed ----------------------------------------------------------------------------------------


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.parametrize(("workers", "kills"), [(0, sets(30, 10)), (2, sets(10, 4))])
def test_killed_drivers_lose_nothing(tmp_path: Path, workers: int, kills: int, seed: int) -> None:
    script = Path(functions.__file__).with_name("_study_driver.py")
    run = subprocess.run(
        [sys.executable, script, tmp_path, str(seed), str(kills), str(workers)],
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert run.returncode == 0, run.stderr
    lines = [line.split() for line in run.stdout.splitlines()]
    assert sum(int(own) for own, _ in lines) >= kills
    assert all(same == "1" for _, same in lines)


ORPHANS = """
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import stochens_rs as se
from study_functions import slow

if __name__ == "__main__":
    # of a fork server one: a worker that had no task yet does not know of the driver
    count = 2 if sys.argv[1] == "fork" else 1
    with ProcessPoolExecutor(count, mp_context=get_context(sys.argv[1])) as pool:
        told = lambda done, total: print(done, flush=True)
        se.Study(slow, {"scale": [1.0]}, replicates=10**5, rng=1).run(pool, progress=told)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.parametrize("method", ["fork", "forkserver"])
def test_the_workers_of_a_killed_driver_end(tmp_path: Path, method: str) -> None:
    (tmp_path / "driver.py").write_text(ORPHANS)
    driver = subprocess.Popen(
        [sys.executable, tmp_path / "driver.py", method],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        start_new_session=True,
    )
    assert driver.stdout is not None
    try:
        assert any(int(line) >= 20 for line in driver.stdout)
        driver.kill()
        driver.communicate(timeout=30)  # until the last process that can write to it has ended
    finally:
        with suppress(ProcessLookupError):
            os.killpg(driver.pid, signal.SIGKILL)
