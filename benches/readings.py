"""Time of a call of a loop from readings: a stable system of two outputs, one thread.

With a gain, and with plans over K steps within limits, for windows of p lags; medians.

    python benches/readings.py
"""

from __future__ import annotations

import warnings

import numpy as np

import stochens_rs as se


def main() -> None:
    """Print the table."""
    rng = np.random.default_rng(1)
    A = np.array([[0.9, 0.2], [-0.1, 0.95]])
    y, u = np.zeros((2000, 2)), rng.standard_normal((1999, 1))
    for t in range(1999):
        y[t + 1] = A @ y[t] + [0.1, 0.05] * u[t] + 0.01 * rng.standard_normal(2)
    data = se.Trajectories([y], [u], outputs=True)
    print("lags  states  gain [us]  plan of 20 steps [us]")
    for lags in (4, 8, 16):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = se.identify(data, lags=lags, checks=False)
        times = []
        for made, steps in ((se.gain(model, 1.0, 1.0), None), (model, 20)):
            loop = se.regulate(made, steps, limits=(-1.0, 1.0), offset_free=True)
            for row in y[:1000]:
                loop(row)
            times.append(1e6 * np.median([call.seconds for call in loop.log[-900:]]))
        print(f"{lags:4}  {model.n:6}  {times[0]:9.1f}  {times[1]:21.1f}")


if __name__ == "__main__":
    main()
