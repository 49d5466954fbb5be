"""Check that wheels are complete and small, and that the one for this machine works without Rust.

`python check_wheel.py FOLDER [PLATFORM]` looks into all wheels of a folder, and installs the one
that fits this Python into an empty environment; the tag of its platform must begin with PLATFORM.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import venv
from email import message_from_bytes
from pathlib import Path
from zipfile import ZipFile

# Bytes of what is published, most of it the extension: 4.80 MB for x86_64.
LIMIT = 4_650_000
# For all versions of Python, or for one that is free-threaded.
TAGS = ("abi3", "cp314t")
EXTENSION = re.compile(
    r"stochens_rs/_core(\.abi3\.so|\.cpython-314t-[\w-]+\.so|(\.cp314t-\w+)?\.pyd)"
)
LICENSES = ["LICENSE", "THIRD-PARTY-LICENSES"]
FILES = [
    "py.typed",
    "_core.pyi",
    "style.mplstyle",
]

USE = """
import shutil
import sys
import sysconfig
import stochens_rs as se

if sysconfig.get_config_var("Py_GIL_DISABLED"):
    assert not sys._is_gil_enabled(), "the extension asks for the lock"
assert shutil.which("cargo") is None
A = [[0.9, 0.2], [-0.1, 0.8]]
fit = se.fuse(se.sample(A, 1000, rng=1), "alse", target=A)
assert fit.status == "optimal"
assert fit.error < 1e-3, fit.error
print(f"it works: fused 1000 realizations, error {fit.error:.1e}")
"""


def look(wheel: Path) -> None:
    """Fail at the first fault of the file."""
    assert wheel.stem.split("-")[-2] in TAGS, f"{wheel}: not for all versions of Python"
    size = wheel.stat().st_size
    local = wheel.stem.split("-")[-1].startswith("linux_")  # by pip, for this machine
    assert local or size <= LIMIT, f"{wheel}: {size} bytes, allowed are {LIMIT}"
    with ZipFile(wheel) as packed:
        names = packed.namelist()
        missing = {f"stochens_rs/{name}" for name in FILES} - set(names)
        assert not missing, f"{wheel}: {missing} are missing"
        compiled = [name for name in names if re.search(r"\.(so|pyd|dylib|dll|pyc)$", name)]
        assert len(compiled) == 1, f"{wheel}: contains {compiled}"
        assert EXTENSION.fullmatch(compiled[0]), f"{wheel}: contains {compiled}"
        (info,) = {name.split("/")[0] for name in names if ".dist-info/" in name}
        about = message_from_bytes(packed.read(f"{info}/METADATA"))
        assert about.get_all("License-File") == LICENSES, about.items()
        for name in LICENSES:
            assert packed.read(f"{info}/licenses/{name}"), name
    description = about["Description"] or about.get_payload()
    assert "## A plan within limits" in description
    assert not re.search(r"\]\((?![a-z]+:|#)", description), "a relative link in the description"
    print(f"{wheel.name} is complete: {size / 1e6:.2f} MB")


def attempt(folder: Path, platform: str) -> None:
    """Install the wheel that fits into an empty environment, where nothing can be compiled."""
    with tempfile.TemporaryDirectory() as place:
        own, picked = Path(place, "own"), Path(place, "picked")
        venv.create(own, with_pip=True)
        programs = own / ("Scripts" if os.name == "nt" else "bin")
        python = programs / "python"
        environment = {**os.environ, "PATH": str(programs)}

        def run(*command: object) -> None:
            subprocess.run(list(map(str, command)), check=True, cwd=place, env=environment)

        pip = [python, "-m", "pip", "--quiet", "--disable-pip-version-check"]
        only = ["--no-deps", "--no-index", "--find-links", folder.resolve()]
        run(*pip, "download", *only, "--dest", picked, "stochens_rs")
        (wheel,) = picked.iterdir()
        tags = wheel.stem.split("-")[-1].split(".")
        assert any(tag.startswith(platform) for tag in tags), f"{wheel}: not for {platform}"
        run(*pip, "install", "--only-binary", ":all:", wheel)
        run(python, "-I", "-c", USE)


def main(folder: Path, platform: str = "") -> None:
    """Look into all wheels, and try one."""
    wheels = sorted(folder.glob("*.whl"))
    assert wheels, f"{folder}: no wheel"
    for wheel in wheels:
        look(wheel)
    attempt(folder, platform)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
