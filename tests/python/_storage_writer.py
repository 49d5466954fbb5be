"""Save generations until killed; write the number of each to a pipe once it is saved.

Usage: _storage_writer.py PATH SEED COUNT. A program for test_storage.py: it forks the writers
itself, so that 200 of them cost one start of the interpreter. One line for each: the generation it
acknowledged last, the one that is loaded, whether its content is right, whether the previous
generation had to stand in, and the number of temporary files left over.
"""

from __future__ import annotations

import os
import random
import select
import signal
import sys
import time

import numpy as np

from stochens_rs import _core


def content(generation: int) -> np.ndarray:
    """Return an array that identifies this generation, of varying length."""
    return np.arange(generation, generation + 1000 + generation % 977, dtype=np.float64)


def write(path: str, generation: int, pipe: int) -> None:
    while True:
        generation += 1
        found = _core.storage_save(path, "kill", [("u", content(generation))])
        assert found == generation
        os.write(pipe, generation.to_bytes(8, "little"))


def main() -> None:
    path, seed, kills = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    random_ = random.Random(seed)
    last = 0
    for turn in range(kills):
        reader, writer = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                write(path, last, writer)
            finally:
                os._exit(1)  # never reached by a writer that is killed
        os.close(writer)
        acknowledged = last.to_bytes(8, "little")
        if (
            turn % 2 == 0
        ):  # surely at work; else it may be killed in the clean-up after the one before
            acknowledged = os.read(reader, 8)
        time.sleep(random_.uniform(0.0, 0.01))
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        assert os.WIFSIGNALED(status), "the writer ended by itself"
        while select.select([reader], [], [], 0)[0] and (more := os.read(reader, 1 << 16)):
            acknowledged += more
        os.close(reader)
        told = int.from_bytes(acknowledged[-8:], "little")
        generation, sections, recovered = _core.storage_load(path, "kill")
        right = sections["u"].tobytes() == content(generation).tobytes()
        leftover = sum(name.endswith(".tmp") for name in os.listdir(os.path.dirname(path)))
        print(told, generation, int(right), int(recovered is not None), leftover, flush=True)
        last = generation


if __name__ == "__main__":
    main()
