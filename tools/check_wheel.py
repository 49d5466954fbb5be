"""Check that a wheel is complete and small, and that it works where it is installed, without Rust.

`python -I check_wheel.py FILE.whl [PLATFORM]`: the file that was installed into an environment
without Rust, and the prefix of the platform tag in its name. `--packed FILE.whl`: only what can be
seen without installing it, for a wheel of another machine.
"""

from __future__ import annotations

import re
import shutil
import sys
from email import message_from_bytes
from pathlib import Path
from zipfile import ZipFile

LIMIT = 3_000_000  # bytes
EXTENSION = re.compile(r"stochens_rs/_core(\.abi3\.so|\.pyd)")
LICENSES = ["LICENSE", "THIRD-PARTY-LICENSES"]
FILES = ["py.typed", "_core.pyi", "paper/report/report.html.j2", "paper/verdicts/statements.ini"]


def check_packed(wheel: Path, platform: str = "") -> None:
    """Fail at the first fault of the file."""
    *_, abi, tags = wheel.stem.split("-")
    assert abi == "abi3", f"{wheel}: not for all versions of Python"
    assert any(tag.startswith(platform) for tag in tags.split(".")), f"{wheel}: not for {platform}"
    size = wheel.stat().st_size
    assert size <= LIMIT, f"{wheel}: {size} bytes, allowed are {LIMIT}"

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
    assert "## First example" in description
    assert not re.search(r"\]\((?![a-z]+:|#)", description), "a relative link in the description"
    print(f"{wheel.name} is complete: {size / 1e6:.2f} MB")


def check_installed() -> None:
    """Fail if what is installed cannot do its work."""
    import stochens_rs as se

    assert shutil.which("cargo") is None
    A = [[0.9, 0.2], [-0.1, 0.8]]
    fit = se.fuse(se.sample(A, 1000, rng=1), "alse", target=A)
    assert fit.status == "optimal"
    assert fit.error < 1e-3, fit.error
    print(f"it works: fused 1000 realizations, error {fit.error:.1e}")


if __name__ == "__main__":
    arguments = [a for a in sys.argv[1:] if a != "--packed"]
    check_packed(Path(arguments[0]), *arguments[1:])
    if "--packed" not in sys.argv:
        check_installed()
