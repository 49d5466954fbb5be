"""Linear models of MuJoCo simulations against the simulator itself."""

from __future__ import annotations

import copy
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputError, InputTypeError, StochensError
from test_hostile import NEVER

# A cart with a pole and a motor with a lag (one activation), and a free box held by nothing.
CART = """<mujoco model="cart and pole"><option timestep="0.005" integrator="implicitfast"/>
<worldbody><body name="cart"><joint name="slider" type="slide" axis="1 0 0" damping="0.5"/>
<geom size="0.1" mass="1"/><body name="pole"><joint name="hinge" type="hinge" axis="0 1 0"
damping="0.01"/><geom type="capsule" fromto="0 0 0 0 0 0.6" size="0.04" mass="0.3"/></body></body>
</worldbody><actuator><general joint="slider" name="motor" dyntype="filter" dynprm="0.05"
gainprm="20"/><motor joint="hinge" gear="2"/></actuator></mujoco>"""
FREE = """<mujoco><option timestep="0.01" gravity="0 0 0" integrator="implicitfast"/><worldbody>
<body name="box"><freejoint name="root"/><geom type="box" size="0.3 0.2 0.1" mass="2"/>
<body pos="0 0 .3"><joint type="ball"/><geom pos="0 0 .2" size="0.1" mass="1"/></body>
</body></worldbody><actuator><motor name="push" joint="root" gear="1 0 0 0 0 1"/>
</actuator></mujoco>"""


def loaded(xml):
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(xml)
    return mujoco, model, mujoco.MjData(model)


def stepped(mujoco, model, data, x, u, count):
    """Where the simulator goes from `data` moved by x and u, as a difference to `data`."""
    nv, later = model.nv, copy.copy(data)
    mujoco.mj_integratePos(model, later.qpos, x[:nv], 1.0)
    later.qvel[:] += x[nv : 2 * nv]
    later.act[:] += x[2 * nv :]
    later.ctrl[:] += u
    for _ in range(count):
        mujoco.mj_step(model, later)
    moved = np.zeros(nv)
    mujoco.mj_differentiatePos(model, moved, 1.0, data.qpos, later.qpos)
    return np.concatenate([moved, later.qvel - data.qvel, later.act - data.act])


@pytest.mark.parametrize("frame_skip", [1, 4])
@pytest.mark.parametrize("xml", [CART, FREE], ids=["cart", "free"])
def test_matrices_are_the_derivatives_of_the_simulator(xml, frame_skip):
    mujoco, model, data = loaded(xml)
    system = se.System.from_mujoco(model, data, frame_skip=frame_skip)
    n, m, h = 2 * model.nv + model.na, model.nu, 1e-5
    assert (system.n, system.m) == (n, m)
    assert system.dt == pytest.approx(frame_skip * model.opt.timestep)
    columns = [
        (
            stepped(mujoco, model, data, z[:n], z[n:], frame_skip)
            - stepped(mujoco, model, data, -z[:n], -z[n:], frame_skip)
        )
        / (2.0 * h)
        for z in h * np.eye(n + m)
    ]
    numeric = np.column_stack(columns)
    np.testing.assert_allclose(system.A, numeric[:, :n], atol=2e-6 * np.abs(numeric).max())
    np.testing.assert_allclose(system.B, numeric[:, n:], atol=2e-6 * np.abs(numeric).max())


def test_data_and_model_are_left_alone():
    _, model, data = loaded(CART)
    data.ctrl[1] = 0.0
    before = [getattr(data, word).copy() for word in ("qpos", "qvel", "act", "ctrl", "qacc")]
    se.System.from_mujoco(model, data)
    after = [getattr(data, word) for word in ("qpos", "qvel", "act", "ctrl", "qacc")]
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
    assert data.time == 0.0


def test_control_of_the_linear_system_catches_the_pole():
    mujoco, model, data = loaded(CART)
    system = se.System.from_mujoco(model, data, frame_skip=8)
    start = np.array([0.0, 0.02, 0.0, 0.0, 0.0])
    plan = se.control(system, start, np.zeros(5), steps=15)
    x, real = start.copy(), copy.copy(data)
    mujoco.mj_integratePos(model, real.qpos, start[:2], 1.0)
    for u in plan.u:
        x = system.A @ x + system.B @ u
        real.ctrl[:] = u
        for _ in range(8):
            mujoco.mj_step(model, real)
    assert np.abs(x).max() < 1e-9
    end = np.concatenate([real.qpos, real.qvel, real.act])
    assert np.abs(end).max() < 2e-3  # of 0.02 rad at the start
    free = copy.copy(data)
    mujoco.mj_integratePos(model, free.qpos, start[:2], 1.0)
    for _ in range(15 * 8):
        mujoco.mj_step(model, free)
    assert abs(free.qpos[1]) > 0.05  # without control it falls


def test_names_of_joints_and_actuators():
    _, model, data = loaded(CART)
    cart = se.System.from_mujoco(model, data)
    assert cart.name == "cart and pole (MuJoCo)"
    assert cart.state_names == ("q_slider", "q_hinge", "v_slider", "v_hinge", "act_motor")
    assert cart.input_names == ("motor", "actuator1")
    _, model, data = loaded(FREE)
    free = se.System.from_mujoco(model, data)
    assert free.state_names[:2] == ("q_root[0]", "q_root[1]")
    assert free.state_names[-1] == "v_joint1[2]"
    assert len(set(free.state_names)) == 18


def test_models_of_gymnasium():
    """All of them use RK4; with another integrator the pendulum balances a little off 0."""
    mujoco = pytest.importorskip("mujoco")
    gymnasium = pytest.importorskip("gymnasium", reason="its wheel has the models")
    folder = Path(gymnasium.__file__).parent / "envs/mujoco/assets"
    model = mujoco.MjModel.from_xml_path(str(folder / "inverted_pendulum.xml"))
    data = mujoco.MjData(model)
    with pytest.raises(InputError, match=r"RK4, which MuJoCo cannot differentiate: set model.opt"):
        se.System.from_mujoco(model, data)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    with pytest.raises(InputError, match=r"v_hinge moves by 0.00.* in one control step") as caught:
        se.System.from_mujoco(model, data, frame_skip=4)
    assert len(str(caught.value)) <= 300
    mujoco.mj_forward(model, data)
    for _ in range(20):  # Newton: the angle at which gravity does not turn the pole
        data.qpos[1] = 0.0 if not _ else data.qpos[1] - data.qacc[1] / slope(mujoco, model, data)
        mujoco.mj_forward(model, data)
    system = se.System.from_mujoco(model, data, frame_skip=4)
    assert repr(system) == "<System inverted pendulum (MuJoCo): n=4 m=1 dt=0.08>"
    assert np.abs(np.linalg.eigvals(system.A)).max() > 1.1  # it falls


def slope(mujoco, model, data):
    other = copy.copy(data)
    other.qpos[1] += 1e-6
    mujoco.mj_forward(model, other)
    return (other.qacc[1] - data.qacc[1]) / 1e-6


def test_drift_that_is_allowed_is_left_out():
    _, model, data = loaded(CART)
    data.qpos[1] = 0.001
    with pytest.raises(InputError, match="is not at an equilibrium"):
        se.System.from_mujoco(model, data)
    assert se.System.from_mujoco(model, data, tolerance=0.01).n == 5


def test_bad_arguments_are_refused():
    mujoco, model, data = loaded(CART)
    other = mujoco.MjModel.from_xml_string(FREE)
    bare = mujoco.MjModel.from_xml_string(FREE[: FREE.index("<actuator>")] + "</mujoco>")
    lost = copy.copy(data)
    lost.qvel[0] = np.nan
    for arguments, options, error, text in (
        ((1, data), {}, InputTypeError, "`model` must be a mujoco.MjModel, got int 1"),
        ((model, model), {}, InputTypeError, "`data` must be a mujoco.MjData"),
        ((other, data), {}, InputError, "`data` must be of `model`"),
        ((bare, mujoco.MjData(bare)), {}, InputError, "must have joints and actuators"),
        ((model, lost), {}, InputError, "`data.qvel[0]` is nan"),
        ((model, data), {"frame_skip": 0}, InputError, "`frame_skip` must be in"),
        ((model, data), {"eps": 0.0}, InputError, "`eps` must be > 0"),
        ((model, data), {"centered": 1}, InputTypeError, "`centered` must be True or False"),
        ((model, data), {"tolerance": -1.0}, InputError, "`tolerance` must be >= 0"),
    ):
        with pytest.raises(error, match=re.escape(text)):
            se.System.from_mujoco(*arguments, **options)


@pytest.mark.parametrize("what", NEVER)
def test_foreign_objects_are_refused_in_one_line(what):
    _, model, data = loaded(CART)
    for arguments in ((NEVER[what], data), (model, NEVER[what])):
        with pytest.raises(StochensError) as caught:
            se.System.from_mujoco(*arguments)
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) <= 300


def test_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match=r"pip install 'stochens_rs\[mujoco\]'"):
        se.System.from_mujoco(None, None)
