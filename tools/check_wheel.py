"""Check that the installed wheel is complete and works, in an environment without Rust.

`python -I check_wheel.py FILE.whl [PLATFORM]`: the file it was installed from, and the prefix of
the platform tag in its name.
"""

from __future__ import annotations

import re
import shutil
import sys
from importlib.metadata import metadata
from pathlib import Path

import stochens_rs as se


def main(wheel: str, platform: str = "") -> None:
    """Fail at the first missing file or failed call."""
    tags = Path(wheel).stem.split("-")[-1].split(".")
    assert any(tag.startswith(platform) for tag in tags), f"{wheel}: not a {platform} wheel"

    about = metadata("stochens_rs")
    assert about.get_all("License-File") == ["LICENSE", "THIRD-PARTY-LICENSES"], about.items()
    description = about["Description"] or about.get_payload()
    assert "## First example" in description
    assert not re.search(r"\]\((?![a-z]+:|#)", description), "a relative link in the description"

    paper = Path(se.__file__).parent / "paper"
    assert (paper / "report" / "report.html.j2").is_file()
    assert (paper / "verdicts" / "statements.ini").is_file()

    assert shutil.which("cargo") is None
    A = [[0.9, 0.2], [-0.1, 0.8]]
    fit = se.fuse(se.sample(A, 1000, rng=1), "alse", target=A)
    assert fit.status == "optimal"
    assert fit.error < 1e-3, fit.error
    print(f"{Path(wheel).name} works: fused 1000 realizations, error {fit.error:.1e}")


if __name__ == "__main__":
    main(*sys.argv[1:])
