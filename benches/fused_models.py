"""Given models weighed by data: the error beside those of other ways to use models and data.

Eight models of a grid of ten machines (IEEE 39 buses, 20 states, 10 inputs, steps of 0.05 s) with
inertias and dampings that vary by 30 %; N measured steps with noise of known size. "right hull":
the true grid is a mixture of the models; "near hull": such a mixture with inertias and dampings off
by 3 %; "wrong hull": inertias and dampings of its own, which vary by 60 %. The error is the root
mean square of one predicted step on fresh states and inputs, in units of the noise, over 40
repetitions of models, grid and data.

    python benches/fused_models.py [docs/images/fused-by-data.png]
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np

import stochens_rs as se
from stochens_rs.exceptions import DataWarning
from stochens_rs.plots.style import COLORS, add_labels, new_figure

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "python"))
from twin.laws import chi2_upper

MODELS, N_STATES, SIGMA, REPEATS = 8, 20, 0.02, 40
SIZES = (3, 10, 40, 200)
# expected sizes: angles [rad], speeds [rad/s], powers [per unit]
SIZE_OF_Z = np.concatenate([np.full(10, 0.2), np.full(10, 0.5), np.full(10, 1.0)])
KINDS = ("right hull", "near hull", "wrong hull")
_GRID = se.cases.ieee39(dt=0.05, method="euler")
BASE = np.hstack([_GRID.A, _GRID.B])
METHODS = ("best single", "mean", "ridge", "least squares", "mixture", "fused")


def grid(gen: np.random.Generator, spread: float, base: np.ndarray = BASE) -> np.ndarray:
    """[A B] for machines whose inertia and damping vary by this much."""
    inertia, damping = np.exp(spread * gen.standard_normal((2, 10)))
    still = np.eye(N_STATES, 30)[10:]
    change = base[10:] - still
    change[:, 10:20] *= damping[:, None]
    return np.vstack([base[:10], still + change / inertia[:, None]])


def ridge(Z: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """Least squares with a penalty in units of z, chosen by leaving pairs out."""
    U, s, Wt = np.linalg.svd(Z / SIZE_OF_Z, full_matrices=False)
    best, found = np.inf, np.zeros((Y.shape[1], Z.shape[1]))
    for lam in np.geomspace(1e-6, 1e3, 28) * len(Z):
        keep = s * s / (s * s + lam)
        out = (Y - U @ (keep[:, None] * (U.T @ Y))) / (1.0 - (U * U) @ keep)[:, None]
        if np.sum(out * out) < best:
            best = np.sum(out * out)
            found = ((Wt.T * (s / (s * s + lam))) @ (U.T @ Y)).T / SIZE_OF_Z
    return found


def errors(kind: str, N: int, seed: int) -> tuple[dict[str, float], float, float]:
    """The error of each method, the share of least squares and the ratio of the two radii."""
    gen = np.random.default_rng([seed, N, KINDS.index(kind)])
    models = np.array([grid(gen, 0.3) for _ in range(MODELS)])
    mixture = np.tensordot(gen.dirichlet(np.ones(MODELS)), models, 1)
    Theta = {
        "right hull": mixture,
        "near hull": grid(gen, 0.03, mixture),
        "wrong hull": grid(gen, 0.6),
    }[kind]
    Z = SIZE_OF_Z * gen.standard_normal((N, len(SIZE_OF_Z)))
    Y = Z @ Theta.T + SIGMA * gen.standard_normal((N, N_STATES))
    data = se.Trajectories.from_pairs(Z[:, :N_STATES], Z[:, N_STATES:], Y)
    given = se.SystemEnsemble(models[:, :, :N_STATES], models[:, :, N_STATES:])
    words = {"data": data, "noise": se.Noise(sigma=SIGMA, design="independent")}
    fused = se.fuse(given, "alse", **words)
    alone = np.tensordot(fused.weights, models, 1)
    least = np.hstack([fused.least_squares.A, fused.least_squares.B])
    best = int(np.argmin([np.sum((Y - Z @ one.T) ** 2) for one in models]))
    estimates = {
        "best single": models[best],
        "mean": models.mean(axis=0),
        "ridge": ridge(Z, Y),
        "least squares": least,
        "mixture": alone,
        "fused": np.hstack([fused.A, fused.B]),
    }
    rms = {k: np.linalg.norm((one - Theta) * SIZE_OF_Z) / SIGMA for k, one in estimates.items()}
    own = np.sqrt(chi2_upper(0.05, N_STATES * min(N, len(SIZE_OF_Z))))
    return rms, fused.share, fused.region(0.05, frobenius=True).frobenius / own


def table(kind: str, sizes: tuple[int, ...] = SIZES, repeats: int = REPEATS) -> list[dict]:
    """One row per N: the mean square of each error, rooted, the share and the ratio of radii."""
    rows = []
    for N in sizes:
        found = [errors(kind, N, seed) for seed in range(repeats)]
        mean = {m: float(np.sqrt(np.mean([f[0][m] ** 2 for f in found]))) for m in METHODS}
        share, ratio = (float(np.median([f[k] for f in found])) for k in (1, 2))
        rows.append({"N": N, **mean, "share": share, "radius": ratio})
    return rows


def markdown(kind: str, rows: list[dict]) -> str:
    head = ["N", *METHODS, "share of least squares", "radius / that of least squares"]
    lines = [f"{kind}:", "", f"| {' | '.join(head)} |", "|" + "---:|" * len(head)]
    for row in rows:
        cells = [f"{row[m]:.3g}" for m in METHODS]
        last = [f"{row['share']:.2f}", f"{row['radius']:.2f}"]
        lines.append(f"| {' | '.join([str(row['N']), *cells, *last])} |")
    return "\n".join(lines)


def draw(path: Path) -> None:
    """Errors over N for a grid that is in the hull, near it, and far from it."""
    sizes = (3, 6, 10, 20, 30, 40, 60, 100, 200, 400, 1000, 3000)
    figure = new_figure(11.4, 3.9)
    shown = dict(zip(("best single", "mean", "ridge", "least squares"), COLORS[3:], strict=False))
    shown |= {"mixture": COLORS[0], "fused": COLORS[1]}
    labels = {"mixture": "mixture of the models", "fused": "fused by data", "mean": "mean model"}
    titles = "a mixture of the models", "a mixture, off by 3 %", "none of the mixtures"
    left = None
    for k, kind in enumerate(KINDS):
        rows = table(kind, sizes, 12)
        ax = left = figure.add_subplot(1, 3, k + 1, sharey=left)
        for method, color in shown.items():
            main = method == "fused"
            ax.loglog(
                sizes,
                [row[method] for row in rows],
                color=color,
                linewidth=2.6 if main else 1.3,
                linestyle="-" if main or method == "mixture" else "--",
                label=labels.get(method, method),
                zorder=3 if main else 2,
            )
        ax.set_title(titles[k], fontsize=10)
        add_labels(ax, "measured steps N", "" if k else "error of a predicted step / noise")
    figure.axes[0].legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=110, metadata={"Software": None}, facecolor="white")


if __name__ == "__main__":
    warnings.simplefilter("ignore", DataWarning)
    if len(sys.argv) > 1:
        draw(Path(sys.argv[1]))
    else:
        for kind in KINDS:
            print(markdown(kind, table(kind)), end="\n\n")
