"""Networks read from cases: published numbers, independent computations, the real packages."""

from __future__ import annotations

import copy
import re

import numpy as np
import pytest

import stochens_rs as se
from grids import MACHINES_9, MACHINES_39, admittances, modes, nine_buses, write_m
from stochens_rs.cases import matpower, swing_models
from stochens_rs.exceptions import InputError, InputTypeError, ShapeError

NINE = nine_buses()
FREE = 2.0 * np.pi * 60.0


def solved_39():
    """The 39 buses as pypower ships and solves them."""
    api = pytest.importorskip("pypower.api", reason="pypower ships the data of the 39 buses")
    result, success = api.runpf(api.case39(), api.ppoption(VERBOSE=0, OUT_ALL=0))
    assert success
    return result


# -- published numbers ---------------------------------------------------------------------------


def test_nine_buses_have_the_printed_reduced_network():
    """Anderson and Fouad, examples 2.6 and 2.7: voltages behind x'd and reduced admittances."""
    network = matpower.read_network(NINE)
    data = matpower.matched(network, swing_models.read_machines(MACHINES_9))
    E, Y = matpower.internal(network, data.xd1)
    np.testing.assert_allclose(np.abs(E), [1.0566, 1.0502, 1.0170], atol=6e-5)
    np.testing.assert_allclose(np.rad2deg(np.angle(E)), [2.2717, 19.7315, 13.1752], atol=0.01)
    printed = [
        [0.846 - 2.988j, 0.287 + 1.513j, 0.210 + 1.226j],
        [0.287 + 1.513j, 0.420 - 2.724j, 0.213 + 1.088j],
        [0.210 + 1.226j, 0.213 + 1.088j, 0.277 - 2.368j],
    ]
    np.testing.assert_allclose(Y, printed, atol=7e-4)


def test_39_buses_have_the_published_modes():
    """Modes of the ten machines with detailed machines, after Intl. Trans. Electrical Energy
    Systems 2023, 2990504, table 2, first dispatch [rad/s]; the classical model is to have the
    inter-area mode and the five next ones within 4 %, the local ones above within 10 %.
    """
    published = np.array([4.00, 6.08, 6.57, 7.04, 7.92, 8.15, 8.65, 8.93])
    system = se.cases.from_matpower(solved_39(), MACHINES_39)
    found = 2.0 * np.pi * modes(system)
    assert found.size == 9  # the table lists the eight with little damping
    np.testing.assert_allclose(found[:6], published[:6], rtol=0.04)
    np.testing.assert_allclose(found[6:8], published[6:8], rtol=0.10)
    assert 0.55 < modes(system)[0] < 0.70  # Hz, bus 39 against all others
    slow = np.argmin(np.abs(np.log(np.linalg.eigvals(system.A)) / 0.01 - 1j * found[0]))
    shape = np.linalg.eig(system.A)[1][:10, slow]
    assert (np.real(shape[:9] / shape[9]) < 0.0).all()


def test_a_wrong_operating_point_moves_the_modes():
    """The anti-test of the two above: unit voltages and no load give other numbers."""
    flat = se.cases.swing([row[:2] + row[3:4] for row in se_branches()], MACHINES_9)
    exact = se.cases.from_matpower(NINE, MACHINES_9)
    assert (np.abs(modes(flat) / modes(exact) - 1.0) > 0.01).any()


def se_branches():
    return [tuple(row[:5]) for row in NINE["branch"]]


# -- independent computations --------------------------------------------------------------------


def electrical(case, machines, deltas, E):
    """Powers of machines at given rotor angles, from the unreduced network equations."""
    Y = admittances(case)
    V = case["bus"][:, 7] * np.exp(1j * np.deg2rad(case["bus"][:, 8]))
    load = (case["bus"][:, 2] - 1j * case["bus"][:, 3]) / case["baseMVA"] / np.abs(V) ** 2
    place = {int(number): k for k, number in enumerate(case["bus"][:, 0])}
    current, whole = np.zeros(len(Y), dtype=complex), Y + np.diag(load)
    for k, (bus, machine) in enumerate(machines.items()):
        y = -1j / machine["xd1"]
        whole[place[bus], place[bus]] += y
        current[place[bus]] += y * abs(E[k]) * np.exp(1j * deltas[k])
    V = np.linalg.solve(whole, current)
    inner = np.abs(E) * np.exp(1j * deltas)
    at = [place[bus] for bus in machines]
    xd1 = np.array([machine["xd1"] for machine in machines.values()])
    return (inner * ((inner - V[at]) / (1j * xd1)).conj()).real


def with_taps():
    """The nine buses with taps, a phase shifter, a shunt, one line out and a second unit."""
    from grids import solve

    case = copy.deepcopy(NINE)
    case["branch"][0, 8], case["branch"][1, 8:10] = 1.03, (0.97, 4.0)
    case["bus"][4, 4:6] = 3.0, 12.0
    case["branch"] = np.vstack([case["branch"], case["branch"][3]])
    case["branch"][-1, 10] = 0.0
    return solve(case)


@pytest.mark.parametrize("case", [NINE, with_taps()], ids=["plain", "taps"])
def test_stiffness_is_the_derivative_of_the_powers(case):
    network = matpower.read_network(case)
    data = matpower.matched(network, swing_models.read_machines(MACHINES_9))
    E, _ = matpower.internal(network, data.xd1)
    K = matpower.synchronizing(network, data.xd1)
    start = np.angle(E)
    np.testing.assert_allclose(
        electrical(case, MACHINES_9, start, E), case["gen"][:, 1] / 100.0, atol=1e-9
    )
    h = 1e-6
    numeric = np.column_stack([
        (electrical(case, MACHINES_9, start + e, E) - electrical(case, MACHINES_9, start - e, E))
        / (2.0 * h)
        for e in h * np.eye(3)
    ])  # fmt: skip
    np.testing.assert_allclose(K, numeric, atol=1e-8)
    np.testing.assert_allclose(K.sum(axis=1), 0.0, atol=1e-12)


def test_system_follows_the_nonlinear_machines():
    """x' of 1250 Euler steps of the swing equations against the linear system, small push."""
    machines = {bus: {**row, "D": 5.0} for bus, row in MACHINES_9.items()}
    network = matpower.read_network(NINE)
    data = matpower.matched(network, swing_models.read_machines(machines))
    E, _ = matpower.internal(network, data.xd1)
    start, power = np.angle(E), NINE["gen"][:, 1] / 100.0
    push, h = np.array([0.01, 0.0, -0.01]), 4e-4
    delta, omega = start.copy(), np.zeros(3)
    for _ in range(1250):
        P = electrical(NINE, machines, delta, E)
        omega = omega + h * FREE / (2.0 * data.H) * (power + push - P - data.D * omega / FREE)
        delta = delta + h * omega
    system = se.cases.from_matpower(NINE, machines, dt=0.01)
    x = np.zeros(6)
    for _ in range(50):
        x = system.A @ x + system.B @ push
    np.testing.assert_allclose(x, np.concatenate([delta - start, omega]), rtol=0.02, atol=2e-5)


def test_bases_are_converted():
    rating = np.array([247.5, 192.0, 128.0])
    own = {
        bus: {"H": row["H"] * 100.0 / mva, "D": 2.0 * 100.0 / mva, "xd1": row["xd1"] * mva / 100.0}
        for (bus, row), mva in zip(MACHINES_9.items(), rating, strict=True)
    }
    system = se.cases.from_matpower(NINE, {b: {**r, "D": 2.0} for b, r in MACHINES_9.items()})
    case = copy.deepcopy(NINE)
    case["gen"][:, 6] = rating
    rows = {bus: {**row, "mva": mva} for (bus, row), mva in zip(own.items(), rating, strict=True)}
    for found in (
        se.cases.from_matpower(case, own, base="machine"),
        se.cases.from_matpower(NINE, rows, base="machine"),
    ):
        np.testing.assert_allclose(found.A, system.A, atol=1e-12)
        np.testing.assert_allclose(found.B, system.B, atol=1e-12)
    with pytest.raises(InputError, match="has a column mva: pass base='machine'"):
        se.cases.from_matpower(NINE, rows)


def test_units_at_one_bus_keep_their_order():
    case = copy.deepcopy(NINE)
    case["gen"] = np.vstack([case["gen"], case["gen"][1]])
    case["gen"][1, 1:3] *= 0.25
    case["gen"][3, 1:3] *= 0.75
    parts = {"bus": [2, 1, 3, 2], "H": [1.6, 23.64, 3.01, 4.8], "D": [0.0] * 4}
    # Two units that share power as 1 : 3 and swing together are the one of before.
    parts["xd1"] = [0.1198 * 4.0, 0.0608, 0.1813, 0.1198 * 4.0 / 3.0]
    two = se.cases.from_matpower(case, parts)
    assert (two.n, two.m) == (8, 4)
    one = modes(se.cases.from_matpower(NINE, MACHINES_9))
    gap = np.abs(modes(two)[:, None] - one[None, :]).min(axis=0)
    np.testing.assert_allclose(gap, 0.0, atol=1e-8)
    labels = swing_models.swing_labels([1, 2, 2])
    assert labels["states"][:3] == ["delta_1", "delta_2", "delta_2_2"]
    assert labels["inputs"] == ["T_m_1", "T_m_2", "T_m_2_2"]
    assert labels["units"]["omega_2_2"] == "rad/s"


# -- the real packages ---------------------------------------------------------------------------


def test_file_of_matpower(tmp_path):
    pytest.importorskip("matpowercaseframes", reason="it reads .m files")
    path = write_m(tmp_path / "nine.m", NINE)
    found = se.cases.from_matpower(path, MACHINES_9)
    assert found == se.cases.from_matpower(NINE, MACHINES_9)
    assert found.name == "nine (classical model, 60 Hz, zoh)"


def test_comments_and_other_tables_are_no_statements(tmp_path):
    pytest.importorskip("matpowercaseframes", reason="it reads .m files")
    path = write_m(tmp_path / "nine.m", NINE)
    path.write_text(
        path.read_text()
        + """
%% loads = kW; [x] = 'text'
%{
mpc.bus(:, 3) = 1;
%}
mpc.gencost = [2 0 0 3 0.1 5 150];
end
"""
    )
    assert se.cases.read_matpower(path)["gencost"].shape == (1, 7)
    assert se.cases.from_matpower(path, MACHINES_9) == se.cases.from_matpower(NINE, MACHINES_9)


@pytest.mark.parametrize("statement", [
    "mpc.branch(3, :) = [];", "if 1\n x = 2;\nend", "scale(mpc);", "mpc.bus(:, 3) = 1;",
    "mpc.bus = [1 2];", "mpc.x = [1]'; mpc.bus(1, 3) = 0; mpc.y = [1]';", "mpc.x = 2 * 3;",
    "end, mpc.bus(1, 3) = 0;", "define_constants;",
])  # fmt: skip
def test_statements_are_refused_with_their_line(tmp_path, statement):
    pytest.importorskip("matpowercaseframes", reason="it reads .m files")
    path = write_m(tmp_path / "nine.m", NINE)
    lines = path.read_text().count("\n")
    path.write_text(path.read_text() + f"\n% below\n  {statement}\n")
    said = rf"nine\.m, line {lines + 3}: .* is no table of numbers, .*: run loadcase and savecase"
    with pytest.raises(InputError, match=said) as caught:
        se.cases.read_matpower(path)
    assert "\n" not in str(caught.value)


def test_what_is_at_an_isolated_bus_is_out_of_service():
    case = copy.deepcopy(NINE)
    case["bus"] = np.vstack([case["bus"], case["bus"][8]])
    case["bus"][9, :9] = 50, 4, 10, 3, 0, 0, 1, 0, 0
    case["branch"] = np.vstack([case["branch"], case["branch"][0], case["branch"][0]])
    case["branch"][-2, :2], case["branch"][-1, :2] = (5, 50), (50, 7)
    case["gen"] = np.vstack([case["gen"], case["gen"][0]])
    case["gen"][-1, 0] = 50
    assert se.cases.from_matpower(case, MACHINES_9) == se.cases.from_matpower(NINE, MACHINES_9)


def test_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matpowercaseframes", None)
    path = write_m(tmp_path / "nine.m", NINE)
    with pytest.raises(ImportError, match=r"pip install 'stochens_rs\[grids\]'"):
        se.cases.from_matpower(path, MACHINES_9)


@pytest.mark.filterwarnings("ignore")  # of pandapower
@pytest.mark.parametrize("model", ["t", "pi"])
def test_net_of_pandapower(model):
    reason = "it needs an older pandas than the suite: run in an environment of its own"
    pp = pytest.importorskip("pandapower", reason=reason)
    import pandapower.networks

    net = pandapower.networks.case39()
    with pytest.raises(InputError, match=r"call pandapower.runpp\(net\) first"):
        se.cases.from_matpower(net, MACHINES_39)
    pp.runpp(net, trafo_model=model, numba=False)
    machines = {**MACHINES_39, "bus": [bus - 1 for bus in MACHINES_39["bus"]]}  # from 0
    found = se.cases.from_matpower(net, machines, mismatch=1e-7)
    expected = se.cases.from_matpower(solved_39(), MACHINES_39)
    np.testing.assert_allclose(modes(found), modes(expected), atol=1e-7)
    assert found.name == "case39 (classical model, 60 Hz, zoh)"


def test_tables_of_machines(tmp_path):
    pd = pytest.importorskip("pandas")
    expected = se.cases.from_matpower(NINE, MACHINES_9)
    frame = pd.DataFrame(MACHINES_9).T.rename_axis("bus")
    path = tmp_path / "machines.csv"
    frame.reset_index().assign(remark="hydro, steam").to_csv(path, index=False)
    for machines in (frame, frame.reset_index(), path, str(path), frame.iloc[::-1]):
        assert se.cases.from_matpower(NINE, machines) == expected


# -- hostile input -------------------------------------------------------------------------------


def changed(key, row, column, value, case=NINE):
    case = copy.deepcopy(case)
    case[key][row, column] = value
    return case


BAD_CASES = [
    (7, InputTypeError, "pandapower net, got int 7"),
    ({}, InputError, "baseMVA is missing"),
    ({**NINE, "bus": NINE["bus"][:, :5]}, ShapeError, "at least the 9 columns"),
    (changed("bus", 4, 7, 0.0), InputError, "must have voltages > 0, got 0 at bus 5"),
    (changed("bus", 4, 0, 4.0), InputError, "must have every bus number once"),
    (changed("bus", 4, 2, 160.0), InputError, "the balance is off by 0.35 pu at bus 5"),
    (changed("branch", 2, 1, 77.0), InputError, "`case['branch']` names bus 77"),
    (changed("branch", 2, 3, 0.0), InputError, "`case['branch'][2]` has no impedance"),
    (changed("gen", slice(None), 7, 0.0), InputError, "`case['gen']` has no row in service"),
    ({**NINE, "dcline": [[1, 2, 1.0]]}, InputError, "DC lines"),
]  # fmt: skip


@pytest.mark.parametrize(("case", "error", "text"), BAD_CASES)
def test_bad_cases_are_refused(case, error, text):
    with pytest.raises(error, match=re.escape(text)) as caught:
        se.cases.from_matpower(case, MACHINES_9)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) <= 300
