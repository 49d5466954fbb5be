"""The pictures of the package, small: what they show, how they are drawn and compared.

``python tests/python/_pictures.py`` writes the references again: look at each of them.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib.image
import matplotlib.style
import numpy as np
from matplotlib.figure import Figure

import stochens_rs as se
from stochens_rs.plots.lines import draw_trace
from stochens_rs.plots.panels import Inputs, draw_calls

REFERENCES = Path(__file__).resolve().parent / "pictures"
SHRINK = 2  # a picture is drawn that much larger than it is kept
REACH = 3  # pixels that something may have moved, with other fonts and versions
WINDOW = 20  # pixels
# The same picture has in no window more than so many pixels whose colour differs that much, in
# the range of a colour, from every pixel nearby: lines and texts; areas, which may be pale.
LINES = 0.2, 4
AREAS = 0.06, 150
WRITTEN_WITH = "3.11."  # matplotlib; others draw and lay out texts in other ways
SLACK = 1 if matplotlib.__version__.startswith(WRITTEN_WITH) else 20

CART = se.System(
    [[1.0, 0.1], [0.0, 0.95]], [[0.005], [0.1]], dt=0.1,
    states=["position", "speed"], inputs=["force"],
    units={"position": "m", "speed": "m/s", "force": "N"},
)  # fmt: skip


@cache
def measured() -> se.Trajectories:
    """Runs of the cart under random forces, with noise."""
    rng = np.random.default_rng(5)
    u = rng.standard_normal((9, 16, 1))
    x = np.zeros((9, 17, 2))
    for k in range(16):
        noise = 0.005 * rng.standard_normal((9, 2))
        x[:, k + 1] = x[:, k] @ CART.A.T + u[:, k] @ CART.B.T + noise
    names = {"state_names": CART.labels.state_axes, "input_names": CART.labels.input_axes}
    return se.Trajectories(x, u, dt=0.1, **names)


@cache
def model(count: int = 8) -> se.Model:
    return se.identify(measured()[:count], noise=se.Noise(sigma=0.005))


@cache
def plan() -> se.Plan:
    limits, cost = se.Limits(u=(-1.0, 1.0), x=(-2.0, 0.8)), se.Cost(Q=[1.0, 0.1], R=0.01)
    return se.control(model(), [-1.0, 0.0], [0.5, 0.0], steps=24, limits=limits, cost=cost)


def certified(draw: Callable[[Any], Any]) -> Any:
    # without names: those of the runs contain units
    exact = plan().states(se.System(CART.A, CART.B), [-1.0, 0.0])
    runs = exact + 0.005 * np.random.default_rng(1).standard_normal((2, *exact.shape))
    return draw((plan(), plan().bound(0.05), runs))


WAY = np.sin(0.15 * np.arange(40))[:, None]


@cache
def fleet() -> tuple[Any, Any]:
    def units(seed: int) -> Any:
        rng = np.random.default_rng(seed)
        return se.SystemEnsemble(np.ones((60, 1, 1)), 1.0 + 0.2 * rng.standard_normal((60, 1, 1)))

    made = se.control_fleet(units(1), [0.0], [1.0], 1, risk="worst")
    return made, made.validate(units(2), 1e-3)


def calls() -> Any:
    k = np.arange(30)
    x = np.stack([np.cos(0.2 * k) * 0.93**k, np.sin(0.2 * k) * 0.93**k], axis=1)
    x[12] = np.nan
    u = np.clip(-3.0 * x[:, :1], -1.0, 1.0)
    u[12] = u[11]
    side = np.ones((30, 1))
    inputs = Inputs(u, ["force [N]"], -side, side, k == 12)
    took = 1e-6 * (20.0 + 9.0 * np.sin(k) ** 2)
    return draw_calls(x, ["position [m]", "speed [m/s]"], inputs, took, target=np.zeros(2), dt=0.1)


def trace(ax: Any) -> Any:
    k = np.unique(np.geomspace(1, 20000, 50).astype(int))
    return draw_trace(k, 0.8 / k, 1.7 / k**0.9, ax)


def regions(ax: Any) -> Any:
    few = model(3).region(0.05).plot((0, 2), (1, 2), label="3 runs", ax=ax)
    return model().region(0.05).plot((0, 2), (1, 2), label="8 runs", ax=few)


AXES: dict[str, Callable[[Any], Any]] = {
    "trajectory": lambda ax: se.simulate(CART, [-1.0, 0.0], WAY).plot(ax=ax),
    "mean": lambda ax: se.simulate_ensemble(CART, [-1.0, 0.0], WAY, 8, rng=1).plot(ax=ax),
    "phase": lambda ax: se.simulate(CART, [-1.0, 0.0], WAY).plot_phase("position", "speed", ax=ax),
    "phase-certified": lambda ax: certified(
        lambda all_: all_[0].plot_phase(0, 1, all_[1], measured=all_[2], ax=ax)
    ),
    "tracking": lambda ax: se.track(CART, np.hstack([WAY, 0 * WAY]), 100, rng=1).plot(ax=ax),
    "trace": trace,
    "fleet": lambda ax: fleet()[0].plot(ax, validated=fleet()[1]),
    "region": regions,
}
FIGURES: dict[str, Callable[[], Figure]] = {
    "plan": lambda: certified(lambda all_: all_[0].plot(all_[1], measured=all_[2])),
    "calls": calls,
    "residuals": lambda: model().plot(),
}
DARK = ("trajectory", "phase-certified", "fleet", "region", "plan", "calls", "residuals")
NAMES = [*AXES, *FIGURES, *(f"{name}-dark" for name in DARK)]


def drawn(name: str) -> Figure:
    """The figure of that name."""
    plain = name.removesuffix("-dark")
    style = ["default", *(["dark_background"] if name != plain else [])]
    with matplotlib.style.context(style):
        if plain in FIGURES:
            return FIGURES[plain]()
        figure = Figure(figsize=(5.0, 3.6), layout="constrained")
        AXES[plain](figure.add_subplot())
    return figure


def pixels(figure: Figure) -> np.ndarray:
    """Its picture, (height, width, 3) in 0 .. 1."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure.set_dpi(50 * SHRINK)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    full = np.asarray(canvas.buffer_rgba())[..., :3] / 255.0
    height, width = (side // SHRINK for side in full.shape[:2])
    blocks = full[: height * SHRINK, : width * SHRINK].reshape(height, SHRINK, width, SHRINK, 3)
    return blocks.mean(axis=(1, 3))


def advice(name: str, found: float) -> str:
    """What to do about a picture that is another one, which is written for a look."""
    new = Path(tempfile.mkdtemp(prefix="stochens-pictures-"))
    write(name, new)
    return (
        f"'{name}' is drawn otherwise, {found:.3g} times what may differ: look at "
        f"{new / name}.png beside {REFERENCES / name}.png; where the new one is right copy it "
        "there, else mend the drawing"
    )


def kept(name: str) -> np.ndarray:
    """The reference of that name."""
    known = (REFERENCES / f"{name}.png").exists()
    assert known, f"'{name}' has no reference: {__doc__.splitlines()[2]}"
    return np.asarray(matplotlib.image.imread(REFERENCES / f"{name}.png"))[..., :3]


def difference(one: np.ndarray, other: np.ndarray) -> float:
    """At most 1 where a person sees the same: see `LINES` and `AREAS`."""
    if np.abs(np.subtract(one.shape, other.shape)).max() > REACH:
        return np.inf
    height, width = np.minimum(one.shape, other.shape)[:2]
    one, other = one[:height, :width], other[:height, :width]
    return max(
        _crowd(here, there, apart) / many
        for here, there in ((one, other), (other, one))
        for apart, many in (LINES, AREAS)
    )


def _crowd(one: np.ndarray, other: np.ndarray, least: float) -> int:
    """The most pixels in a window of `one` that have none of their colour nearby in `other`."""
    height, width, _ = one.shape
    rows, columns = np.nonzero(np.abs(one - other).max(axis=2) > least)
    if not len(rows):
        return 0
    nearest = np.full(len(rows), np.inf)
    for i, j in itertools.product(range(-REACH, REACH + 1), repeat=2):
        near = other[np.clip(rows + i, 0, height - 1), np.clip(columns + j, 0, width - 1)]
        nearest = np.minimum(nearest, np.abs(one[rows, columns] - near).max(axis=1))
    alone = np.zeros((height + WINDOW, width + WINDOW))
    alone[rows, columns] = nearest > least
    total = np.pad(alone.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    inside = total[WINDOW:, WINDOW:] - total[:-WINDOW, WINDOW:]
    return int((inside - (total[WINDOW:, :-WINDOW] - total[:-WINDOW, :-WINDOW])).max())


def write(name: str, to: Path) -> None:
    """Keep a picture with 255 colours, which is less than 15 kB."""
    from PIL import Image

    image = Image.fromarray(np.round(255 * pixels(drawn(name))).astype(np.uint8))
    to.mkdir(exist_ok=True)
    image.quantize(255, dither=Image.Dither.NONE).save(to / f"{name}.png", optimize=True)


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else REFERENCES
    for each in NAMES:
        write(each, target)
