# SPDX-License-Identifier: Apache-2.0
"""Does `learn` find what a bench file names? Learnt values against the emulator's default truth, and what is left.

The bench file names what the truth has, each at a value far from it. Two runs to learn from, one that chooses how far
the filter trusts the model, one to be judged by: 70-sample predictions against the recording, over the recording's own
noise (RMS of recording minus noise-free log).
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np

from benchmarks._report import finish, parser
from hydro_bridge.signals import matrix
from hydro_sim.emulator.offline import Recording, record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation.drawn import draw
from hydro_sim.files import recordings
from hydro_sim.files.recordings import READING_COLUMNS
from hydro_sim.identification.bench_learning import learn, prediction_rmse
from hydro_sim.model.bench import Bench

NAMED: dict[str, dict[str, tuple[float, float]]] = {
    "valve_lag": {"bandwidth": (70.0, 110.0), "damping": (0.8, 1.2)},
    "friction_coulomb": {"force": (5.0, 12.0)},
    "friction_stribeck": {"breakaway_force": (1.0, 5.0), "velocity": (0.02, 0.01)},
    "friction_presliding": {"stiffness": (2e5, 5e5)},
    "leakage_internal": {"coefficient": (0.0, 1e-13)},
    "sensor_lag": {"bandwidth": (40.0, 25.0), "damping": (0.8, 0.55)},
    "valve_deadband": {"half_width": (5e-5, 3e-4)},
}
"""Where learning starts, and the truth. Its bristles are damped and its spool's rate is limited: no effect says so."""


def recorded(deadband: bool, seconds: float, seed: int) -> Recording:
    """A run of the truth."""
    effects = {"valve_deadband": {"half_width": 3e-4}} if deadband else {}
    truth = truth_from_mapping({"profile": "default", "effects": effects})
    return record_offline(truth, draw(seconds, seed), seed=seed)


def main(arguments: list[str] | None = None) -> int:
    """Record, learn, judge, print, write."""
    options = parser("learned_effects", __doc__)
    options.add_argument("--deadband", action="store_true", help="a deadband of 0.3 mA, too")
    options.add_argument("--windows", type=int, default=120, help="that are learnt from (default 120)")
    options.add_argument("--seconds", type=float, default=20.0, help="of each recording (default 20)")
    asked = options.parse_args(arguments)
    named = {name: values for name, values in NAMED.items() if asked.deadband or name != "valve_deadband"}
    sensor = {"sensor_lag": {"sensor": "load_force"}}
    started = replace(Bench.nominal(), load_cell_bandwidth=None, effects=tuple(
        {"id": name, **sensor.get(name, {}), "parameters": {key: begin for key, (begin, _) in values.items()}}
        for name, values in named.items()
    ))  # fmt: skip
    states = {f"run{seed}": recorded(asked.deadband, asked.seconds, seed).states for seed in (11, 12, 13)}
    held_out = recorded(asked.deadband, asked.seconds, 21)
    runs, difference = (
        recordings.runs("held out", held_out.states),
        matrix(held_out.states) - matrix(held_out.noise_free),
    )
    floor = np.sqrt(np.nanmean(difference[:, READING_COLUMNS] ** 2, axis=0))
    began = time.process_time()
    result = learn(
        started, recordings.split(states), count=asked.windows, report=lambda text: print(text, file=sys.stderr)
    )
    spent = time.process_time() - began
    truths = [true for values in named.values() for _, true in values.values()]
    for one, true in zip(result.parameters, truths, strict=True):
        print(f"{one.name:<44}{one.before:>10.4g} ->{one.value:>11.5g}  [{one.low:.4g}, {one.high:.4g}] {one.unit}, "
              f"truth {true:g}")  # fmt: skip
    over = {
        name: prediction_rmse(bench, runs) / floor for name, bench in (("before", started), ("learnt", result.bench))
    }
    for name, values in over.items():
        told = "  ".join(f"{value:.3g}" for value in values)
        print(f"over the noise, {name}: {told}   geometric mean {np.exp(np.mean(np.log(values))):.3g}")
    print(f"{spent:.1f} s of CPU")
    parameters = {one.name: {"learnt": one.value, "low": one.low, "high": one.high} for one in result.parameters}
    over_noise = {name: values.tolist() for name, values in over.items()}
    finish({"parameters": parameters, "over_noise": over_noise, "cpu": spent}, asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
