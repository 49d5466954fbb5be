"""Copy the sources of a package into a folder, with a README without relative links.

A package index shows README.md without the repository, so relative links do not work there. With
the address of the repository's files they become absolute; without one, images are removed and
links become their text. Copies get the current time, because cargo treats a file that is older
than the last build, in any folder, as unchanged.
"""

from __future__ import annotations

import argparse
import re
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FILES = ["Cargo.toml", "Cargo.lock", "pyproject.toml", "LICENSE", "THIRD-PARTY-LICENSES"]
FILES += ["CHANGELOG.md", "benches/core.rs"]
FOLDERS = ["rust", "python", "tests/rust", "examples"]

# [text](path), ![text](path): neither scheme: nor #anchor
RELATIVE = re.compile(r"(!?)\[([^\]]*)\]\((?![a-z]+:|#)([^)]*)\)")


def standalone(readme: str, address: str = "") -> str:
    """Return the README with absolute links (to `address`/path), or without relative links."""
    if address:
        return RELATIVE.sub(rf"\1[\2]({address.rstrip('/')}/\3)", readme)
    return RELATIVE.sub(lambda link: "" if link[1] else link[2], readme)


def with_urls(project: str, address: str = "") -> str:
    """Return pyproject.toml with the address of the repository, if one is given."""
    if not address:
        return project
    at = address.partition("/raw/")[0]
    log = f"{address.rstrip('/')}/CHANGELOG.md"
    urls = f'[project.urls]\nRepository = "{at}"\nChangelog = "{log}"\n'
    return project.replace("[project.scripts]\n", f"{urls}\n[project.scripts]\n", 1)


def stage(folder: Path, address: str = "") -> None:
    """Replace `folder` by the packed files and the standalone README."""
    shutil.rmtree(folder, ignore_errors=True)
    for name in FOLDERS:
        built = shutil.ignore_patterns("__pycache__", "_core*.so", "_core*.pyd")
        shutil.copytree(ROOT / name, folder / name, ignore=built, copy_function=shutil.copy)
    for name in FILES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    project = (ROOT / "pyproject.toml").read_text("utf-8")
    (folder / "pyproject.toml").write_text(with_urls(project, address), "utf-8")
    # maturin would put the README of the crate in place of that of the package
    crate = (ROOT / "Cargo.toml").read_text("utf-8")
    (folder / "Cargo.toml").write_text(crate.replace("rust/README.md", "README.md"), "utf-8")
    readme = (ROOT / "README.md").read_text("utf-8")
    (folder / "README.md").write_text(standalone(readme, address), "utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--address", default="", help="where the repository's files can be fetched")
    arguments = parser.parse_args()
    stage(arguments.folder, arguments.address)
