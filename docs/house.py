"""A house with a heat pump: the plant of docs/heat-a-house.md, and its log.

    python docs/house.py

writes docs/data/house: eleven weeks of a house that its own thermostat heats, 10 minutes a row.
Heat flows between water, room, walls and the weather, the sun comes in, and people
come and go. The heat pump was moved by up to 2.5 kW at random every four hours.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
FOLDER = Path(__file__).parent / "data" / "house"
MINUTES = 10  # of a sample
DAY = 24 * 60 // MINUTES  # samples
WEEKS = 11
MOST = 10.0  # of the heat pump [kW]
# Heat of 1 K [kWh/K] of water, room, walls; conductances [kW/K]
WATER, ROOM, WALLS = 0.35, 3.0, 14.0
TO_ROOM, TO_WALLS, OUT, WINDOWS = 1.2, 0.7, 0.2, 0.11
GLASS = 4.0  # m2 of windows times what they let through
READ = 0.03  # deviation of the error of the thermometer [K]
LOST = 0.01  # share of rows that were not written


def weather(days: int, rng: np.random.Generator) -> Floats:
    """Outdoor temperature [C] and sun [kW/m2] of each sample, (days * DAY + 1, 2), in February."""
    hour = np.arange(days * DAY + 1) % DAY * 24.0 / DAY
    front, cloud, found = 0.0, 0.0, []
    for h in hour:
        front = 0.999 * front + 0.18 * rng.standard_normal()  # fronts take a week
        cloud = 0.98 * cloud + 0.2 * rng.standard_normal()
        clear = max(0.0, np.sin(np.pi * (h - 7.0) / 10.0)) if 7.0 < h < 17.0 else 0.0
        found.append([2.0 + front - 3.0 * np.cos(2.0 * np.pi * (h - 3.0) / 24.0), 0.0])
        found[-1][1] = 0.5 * clear / (1.0 + np.exp(2.0 * cloud))
    return np.array(found)


class House:
    """Temperatures [C] of water, room and walls, one sample after the other.

    Parameters
    ----------
    rng : numpy.random.Generator
        People, and the errors of the thermometer.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.x, self.people = rng, np.array([25.0, 19.5, 17.0]), 0.3

    def read(self) -> Floats:
        """The temperature of the room as the thermometer shows it, (1,)."""
        return self.x[1:2] + READ * self.rng.standard_normal(1)

    def step(self, heat: float, outdoor: float, sun: float) -> None:
        """Heat with so many kW for one sample."""
        self.people += 0.1 * (0.3 - self.people) + 0.04 * self.rng.standard_normal()
        for _ in range(MINUTES):
            water, room, walls = self.x
            into = TO_ROOM * (water - room)
            through = TO_WALLS * (room - walls)
            flow = np.array([
                (heat - into) / WATER,
                (into - through - WINDOWS * (room - outdoor) + GLASS * sun + self.people) / ROOM,
                (through - OUT * (walls - outdoor)) / WALLS,
            ])  # fmt: skip
            self.x = self.x + flow / 60.0


def wanted(days: int) -> Floats:
    """21 C from 6 to 22 o'clock and 19 C at night, by 1 K an hour, (days * DAY,)."""
    hour = np.arange(days * DAY) % DAY * 24.0 / DAY
    return np.interp(hour, [4.0, 6.0, 22.0, 24.0], [19.0, 21.0, 21.0, 19.0])


def thermostat(read: Floats, target: float) -> float:
    """What heats the house in the log [kW]."""
    return float(np.clip(3.5 + 2.0 * (target - read[0]), 0.0, MOST))


def main() -> None:
    """Write the log, a file for each week."""
    rng = np.random.default_rng(7)
    house, targets, sky = House(rng), wanted(7 * WEEKS), weather(7 * WEEKS, rng)
    head, moved, lines = "time [min];room [C];heat [kW];outdoor [C];sun [kW/m2]", 0.0, []
    for k, target in enumerate(targets):
        read = house.read()
        if k % (240 // MINUTES) == 0:
            moved = 2.5 * rng.uniform(-1.0, 1.0)
        heat = round(float(np.clip(thermostat(read, target) + moved, 0.0, MOST)), 2)
        if rng.random() >= LOST:
            cells = f"{MINUTES * k};{read[0]:.2f};{heat};{sky[k, 0]:.1f};{sky[k, 1]:.3f}"
            lines.append(cells.replace(".", ","))
        if (k + 1) % (7 * DAY) == 0:
            path = FOLDER / f"week_{(k + 1) // (7 * DAY)}.csv"
            path.write_text("\n".join([head, *lines]) + "\n")
            lines = []
        house.step(heat, *sky[k])


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    main()
