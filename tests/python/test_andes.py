"""Systems of ANDES against ANDES' own simulation and against the classical model."""

from __future__ import annotations

import re

import numpy as np
import pytest

import stochens_rs as se
from grids import MACHINES_9, nine_buses
from stochens_rs.exceptions import InputError, InputTypeError
from test_hostile import NEVER

# Of ANDES and of the packages it imports.
pytestmark = pytest.mark.filterwarnings("ignore")
FREE = 2.0 * np.pi * 60.0


@pytest.fixture(scope="module")
def andes():
    reason = "ANDES (GPL) is no extra: run in an environment of its own"
    package = pytest.importorskip("andes", reason=reason)
    package.config_logger(50)
    return package


def loaded(andes, name):
    system = andes.load(andes.get_case(name), no_output=True, default_config=True)
    system.PFlow.run()
    system.EIG.run()
    return system


def nine(andes, damping):
    """The nine buses with classical machines, made device by device."""
    case, system = nine_buses(), andes.System(no_output=True, default_config=True)
    for row in case["bus"]:
        system.add("Bus", idx=int(row[0]), name=f"{row[0]:g}", Vn=110.0, v0=row[7])
        if row[2]:
            system.add("PQ", idx=f"L{row[0]:g}", bus=int(row[0]), Vn=110.0,
                       p0=row[2] / 100.0, q0=row[3] / 100.0)  # fmt: skip
    for row in case["branch"]:
        system.add("Line", bus1=int(row[0]), bus2=int(row[1]), r=row[2], x=row[3], b=row[4],
                   Vn1=110.0, Vn2=110.0, Sn=100.0)  # fmt: skip
    for k, row in enumerate(case["gen"]):
        bus = int(row[0])
        kind = "PV" if k else "Slack"
        system.add(kind, idx=f"G{bus}", bus=bus, Sn=100.0, Vn=110.0, p0=row[1] / 100.0, v0=row[5])
        system.add("GENCLS", idx=f"M{bus}", bus=bus, gen=f"G{bus}", Sn=100.0, Vn=110.0, fn=60.0,
                   M=2.0 * MACHINES_9[bus]["H"], D=damping, xd1=MACHINES_9[bus]["xd1"])  # fmt: skip
    system.setup()
    system.PFlow.run()
    system.EIG.run()
    return case, system


def test_classical_machines_are_those_of_from_matpower(andes):
    """Two programs, one model: A and B agree entry by entry."""
    case, system = nine(andes, damping=2.0)
    found = se.cases.from_andes(system, dt=0.02)
    machines = {bus: {**row, "D": 2.0} for bus, row in MACHINES_9.items()}
    expected = se.cases.from_matpower(case, machines, dt=0.02)
    names = list(system.EIG.x_name)
    order = [names.index(f"{word} GENCLS M{k}") for word in ("delta", "omega") for k in (1, 2, 3)]
    unit = np.repeat([1.0, FREE], 3)  # ANDES has speeds in per unit
    np.testing.assert_allclose(
        unit[:, None] * found.A[np.ix_(order, order)] / unit, expected.A, atol=2e-6
    )
    np.testing.assert_allclose(unit[:, None] * found.B[order], expected.B, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("name", ["kundur/kundur_full.xlsx", "ieee14/ieee14_full.xlsx"])
def test_system_follows_the_simulation_of_andes(andes, name):
    """Detailed machines, exciters and governors; 0.001 pu less torque for 0.5 s.

    Less, because a governor of the 14 buses is at its upper limit.
    """
    system = loaded(andes, name)
    linear = se.cases.from_andes(system, dt=0.01)
    kept = [list(system.dae.x_name).index(name) for name in system.EIG.x_name]
    start, push = system.dae.x.copy(), -1e-3
    system.TDS.config.tf, system.TDS.config.tstep, system.TDS.config.no_tqdm = 0.5, 1e-3, 1
    system.TDS.config.fixt, system.TDS.config.shrinkt = 1, 0
    system.GENROU.tm0.v[0] += push
    system.TDS.run()
    x, u = np.zeros(linear.n), np.zeros(linear.m)
    u[0] = push
    for _ in range(50):
        x = linear.A @ x + linear.B @ u
    moved = (system.dae.x - start)[kept]
    for word in ("delta", "omega"):
        own = [k for k, state in enumerate(system.EIG.x_name) if state.startswith(word)]
        np.testing.assert_allclose(x[own], moved[own], atol=0.02 * np.abs(moved[own]).max())
    assert np.abs(moved).max() > 1e-6


def test_system_of_andes_is_left_alone(andes):
    system = loaded(andes, "kundur/kundur_full.xlsx")
    before = [system.dae.x.copy(), system.dae.y.copy(), system.GENROU.tm0.v.copy()]
    first = se.cases.from_andes(system)
    after = [system.dae.x, system.dae.y, system.GENROU.tm0.v]
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
    assert se.cases.from_andes(system) == first
    assert se.cases.from_andes(system, inputs=[("TGOV1", "pref0"), ("GENROU", "tm0")]).m == 8


def test_systems_that_cannot_be_followed_are_refused(andes):
    with pytest.raises(InputError, match=r"reduced it by constraints between states \(220"):
        se.cases.from_andes(loaded(andes, "ieee39/ieee39_full.xlsx"))
    system = andes.load(andes.get_case("kundur/kundur_full.xlsx"), no_output=True)
    with pytest.raises(InputError, match=r"call PFlow.run\(\) and EIG.run\(\) first"):
        se.cases.from_andes(system)


def test_bad_arguments_are_refused(andes):
    system = loaded(andes, "kundur/kundur_full.xlsx")
    for inputs, error, text in (
        (5, InputTypeError, "`inputs` must be a list"),
        ([], InputError, "must name at least one device"),
        (["tm0"], InputError, "must hold pairs of a model and its parameter"),
        ([("GENROU", "power")], InputError, "must hold pairs of a model and its parameter"),
        ([("GENROU", "name")], InputError, "GENROU.name must be an array of numbers"),
        ([("GENROU", "M")], InputError, "has no effect on the equations"),
    ):
        with pytest.raises(error, match=re.escape(text)):
            se.cases.from_andes(system, inputs=inputs)
    system.GENROU.tm0.v[0] += 0.5
    with pytest.raises(InputError, match=r"not in steady state: its equations are off by 0.5"):
        se.cases.from_andes(system)


@pytest.mark.parametrize("what", NEVER)
def test_other_objects_are_refused(what):
    with pytest.raises(InputTypeError, match="`system` must be an ANDES system"):
        se.cases.from_andes(NEVER[what])
