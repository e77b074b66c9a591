# SPDX-License-Identifier: Apache-2.0
"""For which concealed effects does it matter that the simulation lacks them? Fixed gains on benches with one each.

    python -m demo.survey

In the simulation as believed the highest gain is the best. Where it is on the bench, too, a policy trained in that
simulation needs no correction; where it is not, it does. Wrong numbers of the bench file are the box's to know.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from demo.stages import believed_bench
from hydro_bridge.cli.console import Table, add_json_argument, command, progress
from hydro_bridge.signals import Flag
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import Bench

GAINS = (60.0, 90.0, 120.0, 200.0, 300.0)
"""1/s, K_p; K_i = 15 1/s^2."""
FREQUENCIES = (1.0, 2.0)
SETTLING = 2000
EFFECTS: Mapping[str, Mapping[str, Any]] = {
    "nothing": {},
    "load cell's amplifier 25 Hz": {"sensor_lag": {"sensor": "load_force", "bandwidth": 25.0}},
    "load cell's amplifier 60 Hz": {"sensor_lag": {"sensor": "load_force", "bandwidth": 60.0}},
    "rod's load cell 60 Hz": {"sensor_lag": {"sensor": "hydraulic_force", "bandwidth": 60.0}},
    "spool 110 Hz": {"valve_lag": {"bandwidth": 110.0, "damping": 1.2}},
    "spool 60 Hz": {"valve_lag": {"bandwidth": 60.0, "damping": 0.8}},
    "dead time 1 ms": {"transport_delay": {"time": 1e-3}},
    "supply pressure 0.7": {"supply_pressure": {"ratio": 0.7}},
    "valve gain 1.2": {"valve_gain": {"ratio": 1.2}},
    "valve gain 0.8": {"valve_gain": {"ratio": 0.8}},
    "leak 1e-12 m3/s/Pa": {"leakage_internal": {"coefficient": 1e-12}},
    "overlap 0.3 mA": {"valve_deadband": {"half_width": 3e-4}},
    "dry friction 12 N": {"friction_coulomb": {"force": 12.0}},
    "air 2 %": {"entrained_air": {"volume_fraction": 0.02}},
}
TOLD: Mapping[str, Mapping[str, float]] = {
    "supply pressure 0.7": {"supply_pressure": 0.7},
    "valve gain 1.2": {"valve_nominal_flow": 1.2},
    "valve gain 0.8": {"valve_nominal_flow": 0.8},
}
"""What the box's bench file says too much or too little, and by which ratio: a diagnosis puts it right."""


def told(name: str) -> Bench:
    """The bench file that the box is given when the diagnosis has put it right."""
    bench = believed_bench()
    return replace(bench, **{key: ratio * getattr(bench, key) for key, ratio in TOLD.get(name, {}).items()})


def rmse(effects: Mapping[str, Any], kp: float, box: Bench) -> float:
    """Mean RMSE of e [N] over the sines, of a box that believes in `box`; NaN if it tripped at one."""
    config = truth_from_mapping(
        {"profile": "nominal", "bench": {"load_cell_bandwidth": None}, "effects": dict(effects)}
    )
    errors = []
    for frequency in FREQUENCIES:
        segment = Segment(seconds=4.0, amplitude=300.0, frequency=frequency, kp=kp, ki=15.0)
        states = record_offline(config, [segment], bench=box).states
        if np.any(states["flags"] & Flag.TRIPPED):
            return float("nan")
        error = (states["reference_force"] - states["load_force"])[SETTLING:]
        errors.append(float(np.sqrt(np.mean(error**2))))
    return float(np.mean(errors))


@command(ValueError)
def main() -> int:
    """Print the table."""
    options = argparse.ArgumentParser(prog="demo.survey", description=__doc__,
                                      formatter_class=argparse.RawDescriptionHelpFormatter)  # fmt: skip
    add_json_argument(options)
    chosen = options.parse_args()
    columns = {"concealed": "the one effect of the bench"}
    columns |= {f"{kp:g}": "N, mean RMSE at 1 and 2 Hz with this K_p; nan: tripped" for kp in GAINS}
    columns["told"] = "N, with the highest of them and a box whose bench file the diagnosis has put right"
    table = Table({**columns, "best": "1/s, K_p of the smallest error on the bench"})
    for name, effects in progress(EFFECTS.items(), label="benches", total=len(EFFECTS)):
        errors = [rmse(effects, kp, believed_bench()) for kp in GAINS]
        cells = {f"{kp:g}": round(error, 2) for kp, error in zip(GAINS, errors, strict=True)}
        best = GAINS[int(np.nanargmin(errors))] if np.isfinite(errors).any() else float("nan")
        right = rmse(effects, GAINS[-1], told(name)) if name in TOLD else errors[-1]
        table.add(concealed=name, best=best, told=round(right, 2), **cells)
    table.show(chosen.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
