"""Names and units of states and inputs: checked once, kept, and shown with every result."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import cli
from stochens_rs._base.names import Labels, default_labels
from stochens_rs.exceptions import InputError

A, B = [[1.0, 0.1], [0.0, 0.9]], [[0.0], [0.1]]
NAMED = {"states": ["p", "v"], "inputs": ["F"], "units": {"F": "N", "p": "m"}}
CART = se.System(A, B, dt=0.1, **NAMED)
LABELS = Labels(("p", "v"), ("F",), (("p", "m"), ("F", "N")))


def test_a_system_keeps_names_and_units():
    assert CART.state_names == ("p", "v")
    assert CART.input_names == ("F",)
    assert CART.units == {"p": "m", "F": "N"}
    assert CART.labels == LABELS
    assert CART.labels.given
    CART.units["v"] = "a copy"
    assert "v" not in CART.units


def test_text_of_axes_and_errors():
    assert LABELS.state_axes == ("p [m]", "v")
    assert LABELS.input_axes == ("F [N]",)
    assert (LABELS.entry(1), LABELS.entry(0, inputs=True)) == ("state 'v'", "input 'F'")
    assert default_labels(2, 1).entry(1) == "state 1"
    assert Labels(("p", "v"), ("F",), (("F", " N\n/m "), ("p", ""))).units == (("F", "N /m"),)


def model():
    gen = np.random.default_rng(1)
    x, u = gen.standard_normal((60, 2)), gen.standard_normal((60, 1))
    after = x @ np.transpose(A) + u @ np.transpose(B) + 0.01 * gen.standard_normal((60, 2))
    data = se.Trajectories.from_pairs(x, u, after, state_names=["p", "v"], input_names=["F"])
    return se.identify(data)


def test_every_result_has_the_names():
    x0, xf = [1.0, 0.0], [0.0, 0.0]
    fit = se.fuse(se.sample(CART.A, 50, rng=1))
    assert se.control((fit, CART.B), x0, xf).labels == default_labels(2, 1)
    assert se.steer(CART, x0, xf, 50, steps=3, rng=1).labels == LABELS
    assert se.control(CART, x0, xf, steps=3, limits=(-1.0, 1.0)).labels == LABELS
    assert se.simulate_ensemble(CART, x0, [[1.0]], 5, rng=1).labels == LABELS
    found, bare = model(), Labels(("p", "v"), ("F",))
    assert found.system.labels == found.labels == bare
    assert se.control(found, x0, xf, steps=3).labels == bare
    assert se.predict(found, x0, [[1.0]]).labels == bare
    plan = se.control(CART, x0, xf, steps=3)
    assert pickle.loads(pickle.dumps(plan)).labels == LABELS


def test_hostile_names_are_drawn_as_they_are(tmp_path):
    names = ["$\\frac", "_hidden", "a\u00a0b", "50 $ and 60 $", "<b>&", "x" * 300, "\\$", "^_{"]
    system = se.System(0.5 * np.eye(8), np.ones((8, 1)), states=names, inputs=["__$"])
    path = se.simulate(system, np.ones(8), [[1.0]])
    ax = path.plot()
    ax.figure.savefig(tmp_path / "names.png")
    shown = [text.get_text() for text in ax.get_legend().get_texts()]
    assert len(shown) == 8
    assert shown[2] == "a b"
    assert len(shown[5]) == 40
    se.control(system, np.ones(8), np.zeros(8), limits=(-1, 1)).plot().savefig(tmp_path / "p.png")
    assert "&lt;b&gt;&amp;" in path._repr_html_()


def test_no_control_character_reaches_a_repr_or_a_terminal(tmp_path, capsys):
    with pytest.raises(InputError, match=r"`name` must be one line without .* got str '\\x07'"):
        se.System(A, B, name="\x07")
    with pytest.raises(InputError, match="`state_names` must be one line without"):
        se.Trajectories([[0.0], [1.0]], [[1.0]], state_names=["\x1b]0;title\x07"])
    table = {"\x1b[31mx": [0.0, 1.0, 2.0], "u": [1.0, 1.0, 1.0]}
    with pytest.raises(InputError, match="one line without"):
        se.Trajectories.from_table(table, states=["\x1b[31mx"], inputs=["u"])
    with pytest.raises(InputError) as caught:  # the names of other columns are in the message
        se.Trajectories.from_table(table, states=["y"], inputs=["u"])
    assert str(caught.value).isprintable()
    path = tmp_path / "a.csv"
    path.write_text("\x1b[31mx,y,u\n0,0,1\n1,0,1\n2,0,1\n")
    assert cli.main(["identify", str(path), "--states", "y", "--inputs", "u"]) == 2
    said = capsys.readouterr()
    assert "one line of text without control characters" in said.err
    assert "\x1b" not in said.out + said.err
