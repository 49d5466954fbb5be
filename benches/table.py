"""The committed benchmarks: the page for readers, and the numbers the next run is compared with."""

from __future__ import annotations

import json
import os
import platform
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import certificates
import numpy as np
import tightness

import stochens_rs as se

if TYPE_CHECKING:
    from cost import Costs

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "docs" / "data" / "benchmarks.json"
PAGE = ROOT / "docs" / "benchmarks.md"
ALSE = ROOT / "docs" / "data" / "alse.json"
WORSE = 1.5  # ratios this many times below the committed ones are reported


@dataclass(frozen=True)
class Row:
    """One comparison: seconds per unit of ours, and the peer's time divided by ours."""

    group: str
    what: str
    peer: str
    seconds: float
    ratio: float
    low: float
    high: float
    pairs: int
    processor: str


TITLES = {
    "sampling": (
        "Sampling",
        "Unbiased realizations; time per draw of a vector or per matrix. The limit is the "
        "generator: a draw takes one 64-bit word.",
    ),
    "closed_form": (
        "ALSE of a vector",
        "The corrected Lemma 4.4 in closed form; time per problem.",
    ),
    "alse_path": (
        "ALSE of growing prefixes",
        "All prefixes in one call, with warm starts, against cold starts for each.",
    ),
    "slse": (
        "SLSE",
        "One exact line search per realization; time per step. Numba runs the same O(n) update, "
        "compiled; NumPy the dense textbook form.",
    ),
    "slse_replicates": ("SLSE of replicates", "Independent ensembles on two threads against one."),
    "stream": (
        "Streams",
        "The sequential algorithm: draw, line search, control; time per step.",
    ),
    "controls": (
        "Batched controls",
        "One control per realization; time per control, for results of 64 MB and more. `out.fill` "
        "writes the same bytes, so its ratio is our share of its bandwidth; it is above one where "
        "ours are stored past the caches. The limit is the faster kind of store.",
    ),
    "simulate": ("Simulation", "Runs with fresh realizations at every step; time per run."),
    "reproduce": (
        "The experiments",
        "A part of the paper's experiments against NumPy and CVXPY; time per problem.",
    ),
    "limits": (
        "Controls within limits",
        "Time per problem, with each solver's Python interface; the gap of ours, recomputed, is "
        "below 1e-9 of the cost of doing nothing. `python benches/limits.py` has the gaps of all.",
    ),
    "identification": (
        "Identification",
        "10 states and 5 inputs unless it says so; time per call, pair or model.",
    ),
    "certificates": ("Certificates", "The errors of a plan over its steps, for a model from data."),
    "feedback": (
        "Closed loop",
        "A gain and its proof for all systems of a region, against a semidefinite program that "
        "decides the same; and what limits that are promised with a probability add to a call. The "
        "sheet of margins is nine proofs for all systems; the peer has the disk of the centre "
        "alone.",
    ),
    "fleets": ("Fleets", "One control for all units, n = 4, m K = 20; time per problem."),
    "studies": (
        "Studies",
        "Time per task, the 0.1 ms of work included; below one where a study costs more.",
    ),
}


def committed() -> dict[tuple[str, str], float]:
    """Ratio of each comparison that the committed table has."""
    if not DATA.exists():
        return {}
    return {(r["what"], r["peer"]): r["ratio"] for r in json.loads(DATA.read_text())["rows"]}


def regressions(rows: list[Row], before: dict[tuple[str, str], float]) -> list[str]:
    """Describe the ratios far below those before."""
    found = []
    for row in rows:
        old = before.get((row.what, row.peer))
        if old is not None and row.ratio < old / WORSE:
            found.append(f"{row.what} against {row.peer}: {row.ratio:.2f}x, was {old:.2f}x")
    return found


def limits() -> dict[str, float]:
    """Nanoseconds per word, per 8-byte store and per gather, from the last `cargo bench`."""
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "criterion" / "limits"
    units = {
        "words": 1 << 14,
        "stores": 1 << 24,
        "stores past the caches": 1 << 24,
        "gathers": 1 << 16,
    }
    found = {}
    for name, count in units.items():
        path = target / name / "new" / "estimates.json"
        if path.exists():
            found[name] = json.loads(path.read_text())["median"]["point_estimate"] / count
    return found


def write(rows: list[Row], costs: Costs | None) -> None:
    """Write the page and the numbers behind it; groups that were not measured stay."""
    old: dict[str, Any] = json.loads(DATA.read_text()) if DATA.exists() else {"rows": []}
    measured = {row.group for row in rows}
    kept = [Row(**row) for row in old["rows"] if row["group"] not in measured]
    here = machine()
    # what another processor can do says nothing of these rows
    same = old.get("machine", {}).get("processor") == here["processor"]
    rows = sorted([*kept, *rows], key=lambda row: [*TITLES].index(row.group))
    data: dict[str, Any] = {
        "machine": here,
        "limits_ns": limits() or (old.get("limits_ns", {}) if same else {}),
        "rows": [asdict(row) for row in rows],
        "costs": old.get("costs") if costs is None else costs.to_dict(),
    }
    DATA.parent.mkdir(exist_ok=True)
    DATA.write_text(json.dumps(data, indent=1) + "\n")
    PAGE.write_text("\n".join(_page(rows, data)) + "\n")


def machine() -> dict[str, str]:
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            x.split(":", 1)[1].strip() for x in info.read_text().splitlines() if "model name" in x
        ]
        model = names[0] if names else model
    return {
        "processor": model,
        "cores": str(os.cpu_count()),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "stochens_rs": se.__version__,
    }


def _page(rows: list[Row], data: dict[str, Any]) -> list[str]:
    about, found = data["machine"], data["limits_ns"]
    lines = [
        "# Benchmarks",
        "",
        "Written by `make bench`, on one thread unless said otherwise. *Ratio* is the "
        "peer's time divided by ours for the same work: the median over alternating pairs of "
        "calls, with the smallest and the largest. Ratios can be compared between machines, times "
        f"cannot: these are of machines with {about['cores']} cores, Python {about['python']}, "
        f"NumPy {about['numpy']}; each section names the processor.",
        "",
    ]
    if found:
        lines += [
            "Limits of this machine: "
            + ", ".join(_limit(name, value) for name, value in found.items())
            + ".",
            "",
        ]
    for group, (title, text) in TITLES.items():
        chosen = [row for row in rows if row.group == group]
        if chosen:
            text += f" On {' and '.join(sorted({row.processor for row in chosen}))}."
            lines += [f"## {title}", "", text, "", *_table(chosen, found), ""]
            lines += certificates.page() if group == "certificates" else []
    lines += _alse()
    lines += tightness.page()
    if data["costs"] is not None:
        lines += _costs(data["costs"]["two_threads"])
    return lines


def _limit(name: str, nanoseconds: float) -> str:
    texts = {
        "words": f"{nanoseconds:.2f} ns per random 64-bit word",
        "stores": f"{8.0 / nanoseconds:.1f} GB/s stored to memory",
        "stores past the caches": f"{8.0 / nanoseconds:.1f} GB/s stored past the caches",
        "gathers": f"{nanoseconds:.2f} ns per indexed load from a small table",
    }
    return texts[name]


def _table(rows: list[Row], found: dict[str, float]) -> list[str]:
    shares = [_share(row, found) for row in rows]
    more = " share of the limit |" if any(shares) else ""
    lines = [
        f"| work | peer | ours | ratio | smallest .. largest | pairs |{more}",
        f"|---|---|---:|---:|---:|---:|{'---:|' if more else ''}",
    ]
    for row, share in zip(rows, shares, strict=True):
        lines.append(
            f"| {row.what} | {row.peer} | {_time(row.seconds)} | **{_digits(row.ratio)}x** | "
            f"{_digits(row.low)} .. {_digits(row.high)} | {row.pairs} |"
            + (f" {share} |" if more else "")
        )
    return lines


def _share(row: Row, found: dict[str, float]) -> str:
    """Share of the time that the limit alone would take."""
    if row.group == "sampling" and "vector" in row.what and "words" in found:
        return f"{100 * found['words'] / (1e9 * row.seconds):.0f} % (words)"
    if row.group == "controls" and "stores" in found and row.what.startswith("controls, n="):
        m = int(row.what.split(" m=")[1].split(",")[0].split()[0])
        store = min(found[name] for name in found if name.startswith("stores"))
        return f"{100 * m * store / (1e9 * row.seconds):.0f} % (stores)"
    if row.group == "slse" and "gathers" in found and "matrix" in row.what:
        n = int(row.what.rsplit("x", 1)[1].split(",")[0])
        return f"{100 * 3 * n * found['gathers'] / (1e9 * row.seconds):.0f} % (3 n gathers)"
    return ""


def _alse() -> list[str]:
    if not ALSE.exists():
        return []
    rows = json.loads(ALSE.read_text())
    ours = {(r["n"], r["N"]): r["seconds"] for r in rows if r["solver"] == "ours"}
    peers = [s for s in dict.fromkeys(r["solver"] for r in rows) if s != "ours"]
    lines = [
        "## ALSE of matrices",
        "",
        "Optimal weights on the simplex for Gaussian n x n matrices: seconds and, in brackets, the "
        "duality gap reached, recomputed from the data and relative to the squared norm of the "
        "matrix. Empty cells: not run, because they take minutes to hours.",
        "",
        "| n | N | ours | " + " | ".join(peers) + " |",
        "|---:|---:|---:|" + "---:|" * len(peers),
    ]
    for (n, N), seconds in ours.items():
        gap = next(r["gap"] for r in rows if (r["n"], r["N"], r["solver"]) == (n, N, "ours"))
        cells = [f"{_time(seconds)} ({gap:.0e})"]
        for peer in peers:
            found = [r for r in rows if (r["n"], r["N"], r["solver"]) == (n, N, peer)]
            cells.append(
                f"{_time(found[0]['seconds'])} ({found[0]['gap']:.0e}), "
                f"**{_digits(found[0]['seconds'] / seconds)}x**"
                if found
                else ""
            )
        lines.append(f"| {n} | {N} | " + " | ".join(cells) + " |")
    lines += ["", "![Time against N for five solvers](images/alse-time.png)", ""]
    return lines


def _costs(two_threads: dict[str, tuple[float, float, float]]) -> list[str]:
    lines = ["## Cost over n and N", "", "![Cost over n and over N](images/cost.png)", ""]
    lines += [
        "Speed-up by a second thread (time with one over time with two, on a shared machine):",
        "",
        "| work | ratio | smallest .. largest |",
        "|---|---:|---:|",
    ]
    for name, (middle, low, high) in two_threads.items():
        lines.append(f"| {name} | {middle:.2f}x | {low:.2f} .. {high:.2f} |")
    return [*lines, ""]


def _digits(ratio: float) -> str:
    """Three digits, without a power of ten."""
    return f"{ratio:.0f}" if ratio >= 100.0 else f"{ratio:.3g}"


def _time(seconds: float) -> str:
    for unit, name in ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns")):
        if seconds >= unit:
            return f"{seconds / unit:.3g} {name}"
    return f"{seconds / 1e-9:.2g} ns"
