# SPDX-License-Identifier: Apache-2.0
"""Tracking error of fixed gains on the emulated bench, 300 N sines: how it falls with K_p, and where it turns unstable.

The first 2 s of each run are left out (`--settle`). The integral forgets its start with K_p / K_i, 6 s at (90, 15): the
same gains have another error at 0.5 Hz when they are looked at earlier (results.md). `tripped`: the load force passed
the box's limit and the box disarmed.
"""

from __future__ import annotations

import sys

import numpy as np

from benchmarks._report import finish, parser
from hydro_bridge.signals import SAMPLE_PERIOD, Flag
from hydro_sim.emulator.jobs import truth
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import TruthConfig
from hydro_sim.excitation.schedules import Segment

FREQUENCIES = (0.5, 1.0, 1.5, 2.0)


def rmse(config: TruthConfig, kp: float, ki: float, frequency: float, seconds: float, settle: float = 2.0) -> float:
    """RMSE of e = f_r - f_l [N] from `settle` [s] to the end; infinite if the box tripped."""
    segment = Segment(seconds=seconds, amplitude=300.0, frequency=frequency, kp=kp, ki=ki)
    states = record_offline(config, [segment]).states
    if np.any(states["flags"] & Flag.TRIPPED):
        return float("inf")
    error = (states["reference_force"] - states["load_force"])[round(settle / SAMPLE_PERIOD) :]
    return float(np.sqrt(np.mean(error**2)))


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write."""
    options = parser("fixed_gains", __doc__)
    options.add_argument("--truth", metavar="FILE", help="default: the emulator's default truth")
    options.add_argument("--kp", type=float, nargs="+", default=[15, 30, 60, 90, 100, 110, 120, 130, 140, 150])
    options.add_argument("--ki", type=float, default=15.0)
    options.add_argument("--seconds", type=float, default=12.0, help="of each run")
    options.add_argument("--settle", type=float, default=2.0, help="s left out at its beginning")
    asked = options.parse_args(arguments)
    if not 0.0 <= asked.settle < asked.seconds:
        options.error(f"--settle {asked.settle:g} leaves nothing of {asked.seconds:g} s")
    config = truth(asked.truth)
    print(f"{'K_p':>6} " + "".join(f"{frequency:>10g} Hz" for frequency in FREQUENCIES))
    table = {}
    for kp in asked.kp:
        table[kp] = [rmse(config, kp, asked.ki, frequency, asked.seconds, asked.settle) for frequency in FREQUENCIES]
        print(f"{kp:>6g} " + "".join(f"{value:>11.1f} N" if value < 1e9 else f"{'tripped':>13}" for value in table[kp]))
    finish({"unit": "N", "ki": asked.ki, "frequencies": FREQUENCIES, "rmse": table}, asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
