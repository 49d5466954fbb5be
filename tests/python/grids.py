"""Networks for the tests: published data, solved here by a plain Newton method in polar form."""

from __future__ import annotations

import numpy as np

# P. M. Anderson and A. A. Fouad, Power System Control and Stability, sec. 2.10 (nine buses, three
# machines, 100 MVA): from, to, r, x, charging.
BRANCHES_9 = (
    (1, 4, 0.0, 0.0576, 0.0), (2, 7, 0.0, 0.0625, 0.0), (3, 9, 0.0, 0.0586, 0.0),
    (4, 5, 0.010, 0.085, 0.176), (4, 6, 0.017, 0.092, 0.158), (5, 7, 0.032, 0.161, 0.306),
    (6, 9, 0.039, 0.170, 0.358), (7, 8, 0.0085, 0.072, 0.149), (8, 9, 0.0119, 0.1008, 0.209),
)  # fmt: skip
LOADS_9 = {5: (125.0, 50.0), 6: (90.0, 30.0), 8: (100.0, 35.0)}
PLANTS_9 = {1: (71.6, 1.04), 2: (163.0, 1.025), 3: (85.0, 1.025)}  # MW, pu
MACHINES_9 = {
    1: {"H": 23.64, "D": 0.0, "xd1": 0.0608},
    2: {"H": 6.4, "D": 0.0, "xd1": 0.1198},
    3: {"H": 3.01, "D": 0.0, "xd1": 0.1813},
}

# M. A. Pai, Energy Function Analysis for Power System Stability, 1989 (100 MVA).
MACHINES_39 = {
    "bus": list(range(30, 40)),
    "H": [42.0, 30.3, 35.8, 28.6, 26.0, 34.8, 26.4, 24.3, 34.5, 500.0],
    "xd1": [0.031, 0.0697, 0.0531, 0.0436, 0.132, 0.05, 0.049, 0.057, 0.057, 0.006],
    "D": [0.0] * 10,
}


def nine_buses():
    """The case with nine buses, solved."""
    bus = np.zeros((9, 13))
    bus[:, 0], bus[:, 1], bus[:, 7] = range(1, 10), 1, 1.0
    for number, (P, Q) in LOADS_9.items():
        bus[number - 1, 2:4] = P, Q
    gen = np.zeros((3, 10))
    for k, (number, (P, V)) in enumerate(PLANTS_9.items()):
        gen[k, [0, 1, 5, 6, 7]] = number, P, V, 100.0, 1.0
        bus[number - 1, 1], bus[number - 1, 7] = (3 if k == 0 else 2), V
    branch = np.zeros((len(BRANCHES_9), 13))
    branch[:, :5], branch[:, 10] = BRANCHES_9, 1.0
    return solve({"baseMVA": 100.0, "bus": bus, "gen": gen, "branch": branch})


def admittances(case):
    """Bus admittances branch by branch: another way than that of the package."""
    place = {int(number): k for k, number in enumerate(case["bus"][:, 0])}
    n = len(place)
    Y = np.diag((case["bus"][:, 4] + 1j * case["bus"][:, 5]) / case["baseMVA"])
    for row in case["branch"][case["branch"][:, 10] > 0]:
        incidence = np.zeros((2, n))
        incidence[0, place[int(row[0])]] = incidence[1, place[int(row[1])]] = 1.0
        tap = (row[8] or 1.0) * np.exp(1j * np.deg2rad(row[9]))
        ideal = np.diag([1.0 / tap, 1.0])  # the transformer at the `from` end
        y, half = 1.0 / (row[2] + 1j * row[3]), 0.5j * row[4]
        pi = np.array([[y + half, -y], [-y, y + half]])
        Y = Y + incidence.T @ (ideal.conj() @ pi @ ideal) @ incidence
    return Y


def solve(case):
    """Newton's method with numerical derivatives for angles and free voltages."""
    bus, gen, mva = case["bus"].copy(), case["gen"].copy(), case["baseMVA"]
    Y, n = admittances(case), len(bus)
    place = {int(number): k for k, number in enumerate(bus[:, 0])}
    load = (bus[:, 2] + 1j * bus[:, 3]) / mva
    fed = np.zeros(n, dtype=complex)
    for row in gen:
        fed[place[int(row[0])]] += row[1] / mva
    angles, volts = np.flatnonzero(bus[:, 1] != 3), np.flatnonzero(bus[:, 1] == 1)

    def voltages(z):
        angle, size = np.zeros(n), bus[:, 7].copy()
        angle[angles], size[volts] = z[: len(angles)], z[len(angles) :]
        return size * np.exp(1j * angle)

    def missed(z):
        V = voltages(z)
        S = V * (Y @ V).conj() - (fed - load)
        return np.concatenate([S.real[angles], S.imag[volts]])

    z = np.concatenate([np.zeros(len(angles)), np.ones(len(volts))])
    for _ in range(12):
        J = np.column_stack([(missed(z + e) - missed(z - e)) / 2e-6 for e in 1e-6 * np.eye(len(z))])
        z = z - np.linalg.solve(J, missed(z))
    assert np.abs(missed(z)).max() < 1e-10
    V = voltages(z)
    S = V * (Y @ V).conj() + load
    for row in gen:
        row[1:3] = S[place[int(row[0])]].real * mva, S[place[int(row[0])]].imag * mva
    bus[:, 7], bus[:, 8] = np.abs(V), np.rad2deg(np.angle(V))
    return {**case, "bus": bus, "gen": gen}


def write_m(path, case):
    """Write a case in MATPOWER's format."""
    lines = [
        f"function mpc = {path.stem}",
        "mpc.version = '2';",
        f"mpc.baseMVA = {case['baseMVA']};",
    ]
    for key in ("bus", "gen", "branch"):
        rows = "\n".join("\t" + "\t".join(repr(float(x)) for x in row) + ";" for row in case[key])
        lines += ["", f"mpc.{key} = [", rows, "];"]
    path.write_text("\n".join(lines) + "\n")
    return path


def modes(system):
    """Frequencies of the oscillations of a discrete-time system, in Hz, ascending."""
    poles = np.log(np.linalg.eigvals(system.A).astype(complex)) / system.dt
    return np.sort(poles.imag[poles.imag > 0.1]) / (2.0 * np.pi)
