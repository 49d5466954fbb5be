"""Kill drivers of a study at random moments, then continue it; a program for test_study_files.py.

Usage: _study_driver.py FOLDER SEED COUNT WORKERS. It forks the drivers itself, so that many of them
cost one start of the interpreter. Each study is killed several times on its way, until it is done.
Prints one line for each study: the kills, and whether its numbers are those of an undisturbed one.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import stochens_rs as se
from stochens_rs.studies import study as study_module
from study_functions import noise, slow

GRID = {"scale": [1.0, 2.0, 3.0]}


def drive(path: str, workers: int) -> None:
    """Run the study until it is done or this process is killed."""
    os.setpgid(0, 0)
    made = se.Study(slow, GRID, replicates=30, rng=5)
    pool = ProcessPoolExecutor(workers, mp_context=get_context("fork")) if workers else None
    made.run(pool, path)


def main() -> None:
    folder, seed, count, workers = sys.argv[1], *map(int, sys.argv[2:])
    study_module.EVERY = 0.01
    random_ = random.Random(seed)
    whole = se.Study(noise, GRID, replicates=30, rng=5).run()
    kills, number = 0, 0
    while kills < count:
        path, own = os.path.join(folder, f"{number}.study"), 0
        number += 1
        while True:
            child = os.fork()
            if child == 0:
                try:
                    drive(path, workers)
                finally:
                    os._exit(0)
            # longer each time, so that a busy machine gets to the end as well
            time.sleep(random_.uniform(0.0, 0.25 * (1 + own / 10)))
            done, status = os.waitpid(child, os.WNOHANG)
            if not done:
                os.kill(child, signal.SIGKILL)
                _, status = os.waitpid(child, 0)
            if workers and os.path.exists(path):  # orphaned workers do not hold its lock
                se.Study.resume(path, slow).run(path=path, time_limit=1e-9)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)  # its workers
            if not os.WIFSIGNALED(status):
                break
            own += 1
        kills += own
        resumed = se.Study.resume(path, slow).run(path=path)
        same = all(resumed.values[k].tobytes() == v.tobytes() for k, v in whole.values.items())
        print(own, int(same and resumed.status == "completed"), flush=True)


if __name__ == "__main__":
    main()
