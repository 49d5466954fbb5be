"""Figures: no global state changes, everything is labelled, zeros are visible."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("matplotlib")

import matplotlib.image
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

import stochens_rs as se
from stochens_rs.exceptions import DataWarning, InputError
from stochens_rs.plots.certificates import draw_residuals


def drawn(**options):
    return se.simulate(([[0.5]], [[1.0]]), [0.0], [[1.0]]).plot(**options)


def test_given_axes_are_used_and_pyplot_sees_nothing():
    ax = Figure().add_subplot()
    before = plt.get_fignums()
    assert drawn(ax=ax) is ax
    drawn()
    assert plt.get_fignums() == before
    assert len(ax.lines) > 0


def test_pyplot_gets_the_figure_where_it_opens_windows():
    pytest.importorskip("tornado")
    before = plt.get_backend()
    plt.close("all")
    plt.switch_backend("webagg")  # shows figures, and needs no display
    try:
        ax = drawn()
        assert [plt.figure(number) for number in plt.get_fignums()] == [ax.figure]
    finally:
        plt.close("all")
        plt.switch_backend(before)


def test_a_script_that_does_not_use_pyplot_is_not_made_to():
    """And matplotlib is imported at its first use, or named where it is missing."""
    code = (
        "import sys, stochens_rs as se\n"
        "path = se.simulate(([[0.5]], [[1.0]]), [0.0], [[1.0]])\n"
        "optional = 'pandas xarray scipy control h5netcdf distributed dask loky matplotlib'\n"
        "print(set(optional.split()) & set(sys.modules))\n"
        "sys.modules['matplotlib'] = None\n"
        "try:\n    path.plot()\nexcept ImportError as error:\n    print(error)\n"
        "del sys.modules['matplotlib']\n"
        "path.plot().figure.savefig(sys.argv[1])\n"
        "print('matplotlib.pyplot' in sys.modules)"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, os.devnull],
        env={k: v for k, v in os.environ.items() if k not in ("MPLBACKEND", "DISPLAY")},
        capture_output=True,
        text=True,
        check=True,
    )
    first, missing, last = run.stdout.splitlines()
    assert (first, last) == ("set()", "False")
    assert "stochens_rs[plot]" in missing


def test_no_style_is_changed():
    import matplotlib

    before = dict(matplotlib.rcParams)
    drawn()
    assert dict(matplotlib.rcParams) == before


# -- models from data --------------------------------------------------------------------------


def identified(n=2, runs=20, sigma=0.01):
    """A model of a stable system, and a run that was kept apart."""
    rng = np.random.default_rng(5)
    A, B = 0.8 * np.eye(n) + 0.1 * np.eye(n, k=1), np.ones((n, 1))
    u = rng.standard_normal((runs + 1, 12, 1))
    x = np.zeros((runs + 1, 13, n))
    for k in range(12):
        x[:, k + 1] = x[:, k] @ A.T + u[:, k] @ B.T + sigma * rng.standard_normal((runs + 1, n))
    names = [f"state {i}" for i in range(n)]
    data = se.Trajectories(x, u, dt=0.1, state_names=names)
    return se.identify(data[:runs], checks=n < 5, noise=se.Noise(sigma=sigma)), data[runs]


def test_residuals_of_many_states_and_pairs_and_of_none():
    rng = np.random.default_rng(1)
    figure = draw_residuals(rng.standard_normal((5000, 9)), np.ones(5000), list("abcdefghi"), None)
    assert len(figure.legends[0].get_texts()) == 6
    assert len(figure.axes[0].lines[0].get_xdata()) == 2000
    for exact in (np.zeros((3, 1)), np.zeros((1, 2))):
        draw_residuals(exact, np.ones(len(exact)), ["a", "b"][: exact.shape[1]], None).canvas.draw()


def test_a_tube_contains_the_run_that_was_kept_apart():
    model, (states, inputs) = identified()
    plan = se.predict(model, states[0], inputs)
    found = plan.bound(0.05, noise=True)
    bands, figure = found["bands"].radius, plan.plot(found, measured=states)
    assert len(figure.axes) == 3
    for i, ax in enumerate(figure.axes[:2]):
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("time [s]", f"state {i}")
        predicted, measured = (line.get_ydata() for line in ax.lines)
        assert np.array_equal(predicted, plan.predicted_states[:, i])
        assert np.array_equal(measured, states[:, i])
        edge = ax.collections[0].get_paths()[0].vertices
        for k, time in enumerate(0.1 * np.arange(13)):
            at = edge[np.isclose(edge[:, 0], time), 1]
            assert at.max() == pytest.approx(predicted[k] + bands[k, i])
            assert at.min() <= measured[k] <= at.max()
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["95 % guaranteed", "predicted", "measured", "input"]
    one = plan.plot(found, states="state 1", inputs=[], measured=np.stack([states] * 21))
    labels = [text.get_text() for text in one.legends[0].get_texts()]
    assert labels == ["95 % guaranteed", "predicted", "90 % of 21 runs", "their median"]
    assert [ax.get_ylabel() for ax in one.axes] == ["state 1"]
    with pytest.raises(InputError, match="`inputs` must be"):
        plan.plot(inputs=2)


def test_runs_are_drawn_with_their_gaps(tmp_path):
    rows = [f"{k},{0.1 * k:.1f},{k * k},{(-1) ** k}" for k in range(8) if k != 3]
    (tmp_path / "a.csv").write_text("\n".join(["k,t,x,u", *rows]))
    data = se.Trajectories.from_csv(tmp_path, states=["k", "x"], inputs=["u"], time="t")
    figure = data.plot(states="x")
    assert [ax.get_ylabel() for ax in figure.axes] == ["x", "u"]
    drawn = figure.axes[0].lines[0].get_ydata()
    assert np.flatnonzero(np.isnan(drawn)).tolist() == [3]
    assert drawn[5] == 25.0
    assert len(data.plot(inputs=[]).axes) == 2


def test_a_certificate_is_drawn_with_its_parts_its_tube_and_its_components():
    model, _ = identified()
    found = se.control(model, [1.0, 0.0], [0.0, 0.0], steps=3).bound()
    parts, components, tube = found.plot().axes
    for ax, values in ((parts, found.parts.values()), (components, found.components)):
        assert [bar.get_width() for bar in ax.patches] == pytest.approx(list(values))
    assert [text.get_text() for text in parts.get_yticklabels()] == list(found.parts)
    assert np.array_equal(tube.lines[0].get_ydata(), found.tube)
    stream = se.DataStream([[1.0]], ranges={"x0": 0.2})
    stream.update(x0=[[1.0], [1.1]], xf=[0.0], A=[[2.0]])
    (ax,) = stream.confidence().plot().axes
    assert [text.get_text() for text in ax.texts] == [" infinite", " 0.2", " infinite", " infinite"]


def test_an_infinite_tube_and_many_states_can_be_drawn():
    with pytest.warns(DataWarning, match="do not determine"):
        model, (states, inputs) = identified(n=14, runs=1)
    plan = se.predict(model, states[0], inputs)
    found = plan.bound()
    assert np.isinf(found.tube[-1])
    figure = plan.plot(found, measured=np.stack([states, states]))
    assert len(figure.axes) == 13
    figure.canvas.draw()
    assert all(np.isfinite(ax.get_ylim()).all() for ax in figure.axes)


# -- one rule for all of them ----------------------------------------------------------------------


def test_one_call_saves_both_files(tmp_path):
    path = se.simulate(([[0.5]], [[1.0]]), [0.0], [[1.0], [0.0]])
    ax = path.plot()
    names = ["a.png", "a.svg"]
    for drawn, to in ((ax, tmp_path / "a"), (ax.figure, str(tmp_path / "a.svg"))):
        assert [one.name for one in se.plots.save(drawn, to)] == names
        assert all((tmp_path / name).stat().st_size > 1000 for name in names)
    part = Figure(facecolor="black").subfigures(1, 2)[0]
    png, _ = se.plots.save(part.add_subplot(), tmp_path / "1.5", dpi=50)
    assert png.name == "1.5.png"
    assert matplotlib.image.imread(png)[0, 0, :3].max() == 0.0  # in its own background


def test_some_states_with_the_unit_they_share():
    labels = {"states": ["a", "b", "v"], "units": {"a": "rad", "b": "rad", "v": "rad/s"}}
    system = se.System(0.5 * np.eye(3), np.ones((3, 1)), **labels)
    for path in (
        se.simulate(system, np.ones(3), np.zeros((4, 1))),
        se.simulate_ensemble(system, np.ones(3), np.zeros((4, 1)), 9, rng=1),
    ):
        ax = path.plot(["b", 0])
        assert ax.get_ylabel() == "state [rad]"
        assert [text.get_text() for text in ax.texts] == ["b", "a"]
        assert path.plot("v").get_ylabel() == "state [rad/s]"
        assert path.plot().get_ylabel() == "state"


@pytest.mark.parametrize("options", [{}, {"components": True}, {"frobenius": True}])
def test_the_edge_of_a_region_is_the_shadow_of_it(options):
    """No model in the region leaves the polygon, and models come close to each part of it."""
    model, _ = identified()
    region = model.region(0.05, **options)
    rng = np.random.default_rng(1)
    for pair in (((0, 0), (0, 1)), ((0, 0), (1, 2)), ((1, 0), (0, 2))):
        (edge,) = region.plot(*pair).patches
        corners = edge.get_xy()[:-1]
        centre = np.array([region.centre[entry] for entry in pair])
        angles = np.arctan2(*(corners - centre).T[::-1])
        reached = np.zeros(12)
        for turn in range(12):  # the models that go farthest in this direction
            t = 2.0 * np.pi * turn / 12
            G = np.zeros(region.centre.shape)
            G[pair[0]], G[pair[1]] = np.cos(t), np.sin(t)
            D = np.zeros(G.shape)
            for part in region.parts:
                rows, root = part.rows, np.linalg.cholesky(part.S)
                left, _, right = np.linalg.svd(root.T @ G[rows] @ part.white.T, full_matrices=False)
                D[rows] = np.sqrt(part.factor) * root @ left @ right @ part.white
            if not options.get("frobenius"):
                assert region.contains(*np.hsplit(region.centre + (1 - 1e-9) * D, [2]))
            step = np.array([D[entry] for entry in pair])
            reached[turn] = step @ [np.cos(t), np.sin(t)]
            far = (corners - centre) @ [np.cos(t), np.sin(t)]
            assert far.max() == pytest.approx(reached[turn], rel=1e-4)
        for _ in range(50):  # any others
            D = np.zeros(G.shape)
            for part in region.parts:
                W = rng.standard_normal((len(part.rows), len(part.white)))
                W /= np.linalg.norm(W, 2)
                D[part.rows] = np.sqrt(part.factor) * np.linalg.cholesky(part.S) @ W @ part.white
            step = np.array([D[entry] for entry in pair])
            normals = np.stack([np.cos(angles), np.sin(angles)])
            assert (step @ normals <= ((corners - centre) @ normals).max(axis=0) + 1e-12).all()


def many() -> tuple[se.System, np.ndarray, list[int]]:
    """14 states that do not interact, of which 2 and 5 stay where they are; 13 inputs."""
    fade = np.full(14, 0.5)
    fade[[2, 5]] = 1.0
    B = np.eye(14)[:, 1:]
    names = {"states": [f"s{i}" for i in range(14)], "inputs": [f"F{i}" for i in range(13)]}
    return se.System(np.diag(fade), B, **names), 1.0 + np.arange(14), [2, 5]


def test_of_many_states_those_that_change_most_are_drawn():
    system, x0, still = many()
    task = se.Limits(x=(np.full(14, -50.0), np.full(14, 50.0)))
    u_none = {"cost": se.Cost(Q=0.0, Qf=np.eye(14), R=1e9), "limits": task}
    for figure in (
        se.control(system, x0, np.zeros(14), steps=3, **u_none).plot(measured=np.ones((4, 14))),
        se.control(system, x0, np.zeros(14), steps=3, **u_none).plot(certificate=False),
    ):
        drawn = [ax.get_ylabel() for ax in figure.axes]
        assert drawn[:12] == [f"s{i}" for i in range(14) if i not in still]
        assert len(drawn) == 24
        assert figure._supxlabel.get_text() == (
            "the 12 of 14 states and the 12 of 13 inputs that change most"
        )
        for ax, i in zip(figure.axes, (i for i in range(14) if i not in still), strict=False):
            (curve,) = (line for line in ax.lines if line.get_label() == "predicted")
            assert curve.get_ydata()[0] == x0[i]
