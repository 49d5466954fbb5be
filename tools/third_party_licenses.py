"""Write THIRD-PARTY-LICENSES: the licences of the crates that are linked into the extension.

`--check` writes nothing, and fails if the file does not match Cargo.lock.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "THIRD-PARTY-LICENSES"

# One file for all platforms, so that it can be checked on each.
TARGETS = [
    "x86_64-unknown-linux-gnu",
    "aarch64-unknown-linux-gnu",
    "x86_64-unknown-linux-musl",
    "aarch64-unknown-linux-musl",
    "x86_64-apple-darwin",
    "aarch64-apple-darwin",
    "x86_64-pc-windows-msvc",
]
NOTICE = re.compile(r"(LICEN[CS]E|COPYING|COPYRIGHT|NOTICE|UNLICENSE)(?!.*\.rs$)", re.IGNORECASE)
RULE = "=" * 98

HEAD = """\
The extension module of stochens_rs (licence: see LICENSE) contains code of the Rust crates listed
here, under the licences printed with them. A text that several crates have is printed once. Where
a crate offers the MIT licence among others, it is used under the MIT licence. Not every platform
links all of them. Their sources are at https://crates.io, by the names and versions given. The
notices of what the Rust standard library contains are in COPYRIGHT-library.html of the Rust
toolchain. Written by tools/third_party_licenses.py.
"""

# The text of https://spdx.org/licenses/MIT.html
MIT = """\
Copyright (c) {holder}

Permission is hereby granted, free of charge, to any person obtaining a copy of this software and
associated documentation files (the "Software"), to deal in the Software without restriction,
including without limitation the rights to use, copy, modify, merge, publish, distribute,
sublicense, and/or sell copies of the Software, and to permit persons to whom the Software is
furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all copies or
substantial portions of the Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT
NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND
NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM,
DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM, OUT
OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE."""


def cargo(*command: str) -> str:
    """Return the output of a cargo command for the extension, with the crates of Cargo.lock."""
    return subprocess.run(
        ["cargo", *command, "--locked", "--features=python"],
        cwd=ROOT,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
        encoding="utf-8",
    ).stdout


def linked() -> list[dict]:
    """The crates that are linked; procedural macros and build scripts only run at build time."""
    targets = [f"--target={target}" for target in TARGETS]
    edges = ["--edges=normal,no-proc-macro", "--prefix=none", "--no-dedupe"]
    lines = cargo("tree", *edges, *targets).splitlines()
    names = {tuple(line.split()[:2]) for line in lines if line}
    platforms = [f"--filter-platform={target}" for target in TARGETS]
    packages = json.loads(cargo("metadata", "--format-version=1", *platforms))["packages"]
    return [p for p in packages if p["source"] and (p["name"], "v" + p["version"]) in names]


def texts(package: dict) -> list[str]:
    """Return the licence texts in a crate, or else the MIT licence if the crate names it."""
    folder = Path(package["manifest_path"]).parent
    files = sorted(f for f in folder.rglob("*") if NOTICE.match(f.name) and f.is_file())
    licence = package["license"]
    if "MIT" in licence and " AND " not in licence and any("MIT" in f.name for f in files):
        files = [f for f in files if not re.search("APACHE|BSD|UNLICENSE|ZLIB", f.name)]
    found = ["\n".join(map(str.rstrip, f.read_text("utf-8").strip().splitlines())) for f in files]
    if not any(re.search("LICEN[CS]E", f.name, re.IGNORECASE) for f in files):
        if licence != "MIT":
            raise SystemExit(f"{package['name']} {package['version']}: no text of {licence} found")
        holder = ", ".join(re.sub(r" *<.*>", "", name) for name in package["authors"])
        found.append(MIT.format(holder=holder or f"the authors of {package['name']}"))
    return found


def render() -> str:
    """Return the file: each text once, below the names of its crates."""
    users: dict[str, list[str]] = {}
    for package in linked():
        name = f"{package['name']} {package['version']} ({package['license']})"
        for text in texts(package):
            users.setdefault(text, []).append(name)
    # added by the compiler and the linker
    for name, holder in (
        ("the Rust standard library (MIT OR Apache-2.0)", "The Rust Project Contributors"),
        ("the runtime of Zig, in wheels for Linux (MIT)", "Zig contributors"),
    ):
        users.setdefault(MIT.format(holder=holder), []).append(name)
    parts = ["\n".join([*sorted(set(names)), "", text]) for text, names in users.items()]
    return f"\n{RULE}\n\n".join([HEAD.rstrip() + "\n", *(f"{part}\n" for part in sorted(parts))])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="fail if the file is not current")
    text = render()
    if not parser.parse_args().check:
        FILE.write_text(text, "utf-8")
    elif not FILE.is_file() or FILE.read_text("utf-8") != text:
        raise SystemExit(f"{FILE.name} does not match Cargo.lock: run make licenses")
