"""Generated controllers of a cart-pole within input limits, side by side: ours in C, TinyMPC, OSQP.

    python benches/controllers.py [calls]

Needs gcc, g++ and ``pip install tinympc osqp``. The linearized cart-pole of TinyMPC's examples at
100 Hz, ``|u| <= 0.5``, horizons of 50 and 125. Each code plans at the same states (those of our
loop with pushes), warm from the call before; each is compiled with ``-O2`` and timed inside C.
"differs" is the largest distance of an input from that of our plan in the core, which Clarabel
confirms; TinyMPC stops after 100 iterations. "kB" is the text and data of the linked program above
those of an empty one.
"""

from __future__ import annotations

import importlib.resources
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import osqp
import scipy.sparse as sp
import tinympc
from numpy.typing import NDArray

import stochens_rs as se

Floats = NDArray[np.float64]
A = np.array([[1, 0.01, 0, 0], [0, 1, 0.039, 0], [0, 0, 1.002, 0.01], [0, 0, 0.458, 1.002]])
B = np.array([[0.0], [0.02], [0.0], [0.067]])
Q, R, MOST = np.diag([10.0, 1.0, 10.0, 1.0]), np.eye(1), 0.5
TIMED = """
#include <stdio.h>
#include <time.h>
static double seconds(void) {{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}}
int main(int count, char **names) {{
    FILE *from = fopen(names[1], "rb"), *to = fopen(names[2], "wb");
    double x[4], out[2];
    if (count != 3 || !from || !to) return 1;
    {start}
    while (fread(x, sizeof(double), 4, from) == 4) {{
        double u = 0.0, began = seconds();
        {call}
        out[0] = seconds() - began;
        out[1] = u;
        fwrite(out, sizeof(double), 2, to);
    }}
    return fclose(to);
}}
"""


def terminal(rho: float = 1.0) -> Floats:
    """Of TinyMPC: the Riccati solution of ``Q + rho I`` and ``R + rho I``."""
    P = Q + rho * np.eye(4)
    for _ in range(5000):
        K = np.linalg.solve(R + rho * np.eye(1) + B.T @ P @ B, B.T @ P @ A)
        P = Q + rho * np.eye(4) + A.T @ P @ (A - B @ K)
    return P


def states(loop: se.Regulator, calls: int) -> tuple[Floats, Floats]:
    """States (calls, 4) of our loop with a push now and then, and its inputs (calls,)."""
    rng, x = np.random.default_rng(1), np.array([0.5, 0.0, 0.05, 0.0])
    seen, applied = np.empty((calls, 4)), np.empty(calls)
    for k in range(calls):
        seen[k], applied[k] = x, loop(x)[0]
        x = A @ x + B[:, 0] * applied[k] + 1e-3 * rng.standard_normal(4)
        if k % 40 == 39:  # pushes from which the input brings the pole back
            x = np.array([0.5, 0.1, 0.03, 0.05]) * rng.uniform(-1.0, 1.0, 4)
    if np.abs(seen[:, 2]).max() > 0.2:
        raise RuntimeError("the pole fell: after that every plan is at its limits")
    return seen, applied


def of_ours(folder: Path, N: int) -> list[str]:
    loop = se.regulate((A, B), N, limits=(-MOST, MOST), cost=se.Cost(Q=Q, R=R, Qf=terminal()))
    loop.to_c(folder / "cart.h", name="cart")
    start, call = "static cart s; cart_start(&s);", "if (cart_step(&s, x, &u)) return 2;"
    (folder / "main.c").write_text('#include "cart.h"\n' + TIMED.format(start=start, call=call))
    return ["gcc", "main.c"]


def of_tinympc(folder: Path, N: int) -> list[str]:
    problem = tinympc.TinyMPC()
    bound = np.full((1, N - 1), MOST)
    problem.setup(A, B, Q, R, N, rho=1.0, u_min=-bound, u_max=bound, max_iter=100)
    # `codegen` builds a Python module, too; its files are enough here
    problem._solver.codegen(f"{folder}/", 0)
    source = importlib.resources.files("tinympc.codegen").joinpath("codegen_src")
    shutil.copytree(str(source), folder, dirs_exist_ok=True)
    call = """
        tinyVector now(4);
        now << x[0], x[1], x[2], x[3];
        tiny_set_x0(&tiny_solver, now);
        tiny_solve(&tiny_solver);
        u = tiny_solver.solution->u(0, 0);"""
    solver = folder / "tinympc" / "admm.cpp"  # it prints a line for each call: not timed
    lines = solver.read_text().splitlines()
    solver.write_text("\n".join(line for line in lines if "std::cout" not in line) + "\n")
    head = '#include "tinympc/tiny_api.hpp"\n#include "tinympc/tiny_data.hpp"\n'
    (folder / "main.cpp").write_text(head + TIMED.format(start="", call=call))
    sources = ["tinympc/admm.cpp", "tinympc/tiny_api.cpp", "tinympc/rho_benchmark.cpp"]
    headers = ["-I.", "-Iinclude", "-Iinclude/Eigen", "-Itinympc"]
    return ["g++", "main.cpp", "src/tiny_data.cpp", *sources, *headers]


def of_osqp(folder: Path, N: int) -> list[str]:
    free = 4 * N  # x_1 .. x_N, then u_0 .. u_(N-1)
    P = sp.block_diag([sp.kron(sp.eye(N - 1), Q), terminal(), sp.kron(sp.eye(N), R)], "csc")
    moves = sp.hstack([sp.kron(sp.eye(N, k=-1), A) - sp.eye(free), sp.kron(sp.eye(N), B)])
    rows = sp.vstack([moves, sp.hstack([sp.csc_matrix((N, free)), sp.eye(N)])], "csc")
    low = np.concatenate([np.zeros(free), np.full(N, -MOST)])
    high = np.concatenate([np.zeros(free), np.full(N, MOST)])
    problem = osqp.OSQP()
    # its code cannot adapt rho; of .1 to 1000 this needs the fewest iterations here
    settings = {"eps_abs": 1e-4, "eps_rel": 1e-4, "check_termination": 5, "rho": 10.0}
    P = sp.triu(P, format="csc")
    problem.setup(P, np.zeros(5 * N), rows, low, high, verbose=False, **settings)
    problem.codegen(str(folder), parameters="vectors", prefix="cart_", force_rewrite=True)
    entries = ", ".join("{" + ", ".join(map(repr, row)) + "}" for row in A.tolist())
    start = f"""
    static OSQPFloat low[{5 * N}], high[{5 * N}];
    static const double A[4][4] = {{{entries}}};
    for (int i = 0; i < {N}; i++) {{
        low[{free} + i] = -{MOST};
        high[{free} + i] = {MOST};
    }}"""
    call = f"""
        for (int i = 0; i < 4; i++) {{
            double sum = 0.0;
            for (int j = 0; j < 4; j++) sum -= A[i][j] * x[j];
            low[i] = high[i] = sum;
        }}
        osqp_update_data_vec(&cart_solver, OSQP_NULL, low, high);
        osqp_solve(&cart_solver);
        u = cart_solver.solution->x[{free}];"""
    head = '#include "osqp.h"\n#include "cart_workspace.h"\n'
    (folder / "main.c").write_text(head + TIMED.format(start=start, call=call))
    sources = [str(p) for p in folder.rglob("*.c") if p.name not in ("main.c", "emosqp.c")]
    headers = sorted({f"-I{p.parent}" for p in folder.rglob("*.h")})
    return ["gcc", "main.c", *(s for s in sources if "example" not in s), *headers]


def linked(command: list[str], folder: Path) -> int:
    """Bytes of text and data of the program; it is ``folder/main``."""
    what = [*command, "-O2", "-o", "main", "-lm"]
    made = subprocess.run(what, cwd=folder, capture_output=True, text=True)
    if made.returncode:
        raise RuntimeError(f"{' '.join(what)}: {made.stderr[:2000]}")
    sizes = subprocess.run(["size", "main"], cwd=folder, check=True, capture_output=True, text=True)
    text, data, *_ = sizes.stdout.splitlines()[1].split()
    return int(text) + int(data)


def main(calls: int) -> None:
    print(f"{'':10} {'N':>4} {'median us':>10} {'99.9 %':>8} {'worst':>8} {'kB':>6}  differs")
    for N in (50, 125):
        cost = se.Cost(Q=Q, R=R, Qf=terminal())
        seen, applied = states(se.regulate((A, B), N, limits=(-MOST, MOST), cost=cost), calls)
        print(f"N = {N}: {calls} calls, {np.mean(np.abs(applied) > MOST - 1e-9):.0%} at a limit")
        for name, made in {"ours": of_ours, "TinyMPC": of_tinympc, "OSQP": of_osqp}.items():
            with tempfile.TemporaryDirectory() as given:
                folder = Path(given)
                command = made(folder, N)
                empty = folder / ("empty.cpp" if command[0] == "g++" else "empty.c")
                empty.write_text(TIMED.format(start="", call=""))
                bare = linked([command[0], empty.name], folder)
                bytes_ = linked(command, folder) - bare
                seen.tofile(folder / "states")
                subprocess.run(["./main", "states", "out"], cwd=folder, check=True)
                took, u = np.fromfile(folder / "out").reshape(-1, 2).T
            middle, late = 1e6 * np.quantile(took[10:], [0.5, 0.999])
            differs = np.abs(u - applied).max()
            print(
                f"{name:10} {N:4} {middle:10.2f} {late:8.2f} {1e6 * took[10:].max():8.2f} "
                f"{bytes_ / 1000:6.1f}  {differs:.1e}"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
