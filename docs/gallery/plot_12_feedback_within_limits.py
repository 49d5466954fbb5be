"""
How does a feedback keep within the limits of the actuators?
============================================================

``regulate`` makes a feedback that plans 20 steps ahead at every state and returns the first input.
A wagon with a trailer on a spring is brought to its place by a motor of 1 N that may change by
0.4 N in a step, with noise and a push on the way.
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

# Positions of wagon and trailer [m], their speeds [m/s]; force [N]; steps of 0.1 s.
A = np.array([[0.980, 0.020, 0.099, 0.001], [0.020, 0.980, 0.001, 0.099],
              [-0.391, 0.391, 0.970, 0.020], [0.391, -0.391, 0.020, 0.970]])  # fmt: skip
B = np.array([[0.005], [0.0], [0.099], [0.001]])
system = se.System(A, B, dt=0.1)

# %%
# The rate needs the input that acts now. Each call starts at the active limits of the call before.
limits = se.Limits(u=(-1.0, 1.0), rate=0.4, previous=0.0)
loop = se.regulate(system, 20, limits=limits, cost=se.Cost(Q=[1.0, 1.0, 0.1, 0.1], R=0.02))
x, rng, states = np.array([-1.0, -1.0, 0.0, 0.0]), np.random.default_rng(2), []
for k in range(150):
    states.append(x)
    x = A @ x + B @ loop(x) + 0.002 * rng.standard_normal(4)
    if k == 80:
        x[3] += 0.5  # a push against the trailer
print(loop)
microseconds = np.array([call.seconds for call in loop.log]) * 1e6

# %%
force = np.array([call.u[0] for call in loop.log])
times, states = 0.1 * np.arange(150), np.array(states)
fig, (top, bottom) = plt.subplots(2, 1, figsize=(7.5, 5), sharex=True)
top.plot(times, states[:, 0], color="C0", lw=2)
top.plot(times, states[:, 1], color="C1", lw=2)
top.axhline(0.0, color="0.6", lw=0.8)
top.text(1.1, -0.95, "trailer", color="C1")
top.text(0.1, -0.55, "wagon", color="C0")
top.annotate(
    "push", (8.1, 0.0), (6.9, 0.17), color="0.3", arrowprops={"arrowstyle": "->", "color": "0.3"}
)
top.set(ylabel="position [m]", title="A wagon and its trailer, pushed at 8.1 s")
bottom.axhspan(-1.0, 1.0, color="0.92")
bottom.step(times, force, where="post", color="C2", lw=2)
bottom.text(10, 0.85, "grey: within the limits", color="0.35", va="center")
bottom.set(xlabel="time [s]", ylabel="force [N]", title="The force of its motor")
plt.show()

# %%
# The time of a call counts in a loop; the first one computes what the others use again.
print(f"median {np.median(microseconds):.0f} us, largest {microseconds.max():.0f} us")
