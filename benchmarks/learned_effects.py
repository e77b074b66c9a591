# SPDX-License-Identifier: Apache-2.0
"""Does `learn` find what a bench file names? Learnt values against the truth's, and what is left.

Truths of the emulator: the default one, the same with one thing more, and one of five effects. The bench file
names what the truth has, each at a value far from it.

Two runs to learn from, one that chooses how far the filter trusts the model, one to be judged by: 70-sample predictions
against the recording, over the recording's own noise (RMS of recording minus noise-free log).
"""

from __future__ import annotations

import sys
import time
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks._report import finish, parser
from hydro_bridge.signals import FloatArray, matrix
from hydro_sim.emulator.offline import Recording, record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation.drawn import draw
from hydro_sim.files import recordings
from hydro_sim.files.recordings import READING_COLUMNS
from hydro_sim.identification.bench_learning import Result, learn, prediction_rmse
from hydro_sim.model.bench import Bench

Entry = dict[str, Any]


def effect(name: str, **parameters: float) -> Entry:
    """An entry of a bench file."""
    identifier, *options = name.split()
    return {"id": identifier, **dict(option.split("=") for option in options), "parameters": parameters}


Named = list[tuple[Entry, dict[str, float]]]
"""Entries of a bench file at the values that learning starts from, and the truth's values."""

DEFAULT: Named = [
    (effect("valve_lag", bandwidth=70.0, damping=0.8), {"bandwidth": 110.0, "damping": 1.2}),
    (effect("friction_coulomb", force=5.0), {"force": 12.0}),
    (effect("friction_stribeck", breakaway_force=1.0, velocity=0.02), {"breakaway_force": 5.0, "velocity": 0.01}),
    (effect("friction_presliding", stiffness=2e5), {"stiffness": 5e5}),
    (effect("leakage_internal", coefficient=0.0), {"coefficient": 1e-13}),
    (effect("sensor_lag sensor=load_force", bandwidth=40.0, damping=0.8), {"bandwidth": 25.0, "damping": 0.55}),
]
"""Of the default truth. Its bristles are damped and its spool's rate is limited, which no effect of the table says."""

CASES: dict[str, tuple[Entry, Named]] = {
    "default": ({"profile": "default"}, DEFAULT),
    "deadband": (
        {"profile": "default", "effects": {"valve_deadband": {"half_width": 3e-4}}},
        [*DEFAULT, (effect("valve_deadband", half_width=5e-5), {"half_width": 3e-4})],
    ),
    "play": (
        {"profile": "default", "effects": {"backlash": {"width": 4e-4, "form": "play"}}},
        [*DEFAULT, (effect("backlash form=play", width=1e-4), {"width": 4e-4})],
    ),
    "drooping supply": (
        {"profile": "default", "effects": {"supply_droop": {"resistance": 3e10, "time_constant": 0.02}}},
        [
            *DEFAULT,
            (
                effect("supply_droop", resistance=3e9, time_constant=0.05),
                {"resistance": 3e10, "time_constant": 0.02},
            ),
        ],
    ),
    "changed spring": (
        {"profile": "default", "bench": {"spring_stiffness": 32000.0}},
        [*DEFAULT, (effect("spring_stiffness", ratio=1.0), {"ratio": 1.6})],
    ),
    "five at once": (
        {
            "profile": "nominal",
            "effects": {
                "friction_coulomb": {"force": 15.0},
                "spring_hardening": {"coefficient": 2e7},
                "entrained_air": {"volume_fraction": 0.005},
                "supply_droop": {"resistance": 2e10, "time_constant": 0.03},
                "valve_deadband": {"half_width": 2e-4},
            },
        },
        [
            (effect("friction_coulomb", force=5.0), {"force": 15.0}),
            (effect("spring_hardening", coefficient=0.0), {"coefficient": 2e7}),
            (effect("entrained_air", volume_fraction=0.001), {"volume_fraction": 0.005}),
            (
                effect("supply_droop", resistance=2e9, time_constant=0.06),
                {"resistance": 2e10, "time_constant": 0.03},
            ),
            (effect("valve_deadband", half_width=5e-5), {"half_width": 2e-4}),
            (
                effect("sensor_lag sensor=load_force", bandwidth=40.0, damping=0.8),
                {"bandwidth": 25.0, "damping": 0.7071},
            ),
        ],
    ),
}
"""The truth; what the bench file names."""


def recorded(case: str, seconds: float, seed: int) -> Recording:
    """A run of the truth."""
    return record_offline(
        truth_from_mapping({"profile": "default", **deepcopy(CASES[case][0])}), draw(seconds, seed), seed=seed
    )


def started(case: str) -> Bench:
    """The bench file that learning starts from."""
    entries = [entry for entry, _ in CASES[case][1]]
    return replace(Bench.nominal(), load_cell_bandwidth=None, effects=tuple(entries))


def floor(recording: Recording) -> FloatArray:
    """RMS of the readings' noise, shape (5,)."""
    difference = matrix(recording.states) - matrix(recording.noise_free)
    return np.asarray(np.sqrt(np.nanmean(difference[:, READING_COLUMNS] ** 2, axis=0)))


def judged(case: str, count: int, seconds: float) -> dict[str, Any]:
    """One row of the result."""
    began = time.process_time()
    states = {f"run{seed}": recorded(case, seconds, seed).states for seed in (11, 12, 13)}
    bench, held_out = started(case), recorded(case, seconds, 21)
    print(f"{case}: recorded, {time.process_time() - began:.1f} s of CPU", file=sys.stderr)
    data, runs = recordings.split(states), recordings.runs("held out", held_out.states)
    before = prediction_rmse(bench, runs)
    began = time.process_time()
    result = learn(bench, data, count=count, report=lambda text: print(text, file=sys.stderr, flush=True))
    spent = time.process_time() - began
    return {
        "parameters": _compared(case, result), "cpu": round(spent, 1), "noise_measured": result.noise.tolist(),
        "over_floor": (prediction_rmse(result.bench, runs) / floor(held_out)).tolist(),
        "over_floor_before": (before / floor(held_out)).tolist(),
    }  # fmt: skip


def _compared(case: str, result: Result) -> list[dict[str, Any]]:
    true = [value for _, values in CASES[case][1] for value in values.values()]
    return [
        {"name": one.name, "unit": one.unit, "before": one.before, "learnt": one.value, "low": one.low,
         "high": one.high, "truth": value}
        for one, value in zip(result.parameters, true, strict=True)
    ]  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Record, learn, judge, print, write."""
    options = parser("learned_effects", __doc__)
    options.add_argument("--only", choices=list(CASES), nargs="+", default=list(CASES), help="default all")
    options.add_argument("--windows", type=int, default=120, help="that are learnt from (default 120)")
    options.add_argument("--seconds", type=float, default=20.0, help="of each recording (default 20)")
    asked = options.parse_args(arguments)
    outcome = {}
    for case in asked.only:
        outcome[case] = row = judged(case, asked.windows, asked.seconds)
        print(f"\n{case}: {row['cpu']} s of CPU")
        for one in row["parameters"]:
            print(f"{one['name']:<44}{one['before']:>10.4g} ->{one['learnt']:>11.5g}  [{one['low']:.4g}, "
                  f"{one['high']:.4g}] {one['unit']}, truth {one['truth']:g}")  # fmt: skip
        for name in ("over_floor_before", "over_floor"):
            values = np.array(row[name])
            print(
                f"{name}: "
                + "  ".join(f"{value:.3g}" for value in values)
                + f"   geometric mean {np.exp(np.mean(np.log(values))):.3g}"
            )
    finish({"readings": ["f_h", "f_l", "p_a", "p_b", "x_p"], **outcome}, asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
