# SPDX-License-Identifier: Apache-2.0
"""The analytic plant of the nominal bench: tracking of 300 N sines by fixed gains, the largest stable K_p, and speed.

The first 2 s of each run are left out, noise is on. `tripped`: the load force passed the limit and the box disarmed.
"""

from __future__ import annotations

import sys
import timeit
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks._report import finish, parser
from hydro_bridge.signals import Flag, ReferenceSignal, Waveform
from hydro_sim.box.box import Box
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

FREQUENCIES = (0.5, 1.0, 1.5, 2.0)
GAINS = ((15.0, 5.0), (90.0, 15.0), (120.0, 15.0))
SETTLING = 2000
CALLS = 5000


def rmse(plant: Bench, box: Bench, gains: tuple[float, float], frequency: float) -> float:
    """RMSE of e = f_r - f_l [N] over 10 s; infinite if the box tripped."""
    signal = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=frequency)
    run = simulate(AnalyticPlant(plant), box, Schedule(reference=signal, gains=gains, seconds=12.0))
    if np.any(run["flags"] & Flag.TRIPPED):
        return float("inf")
    return float(np.sqrt(np.mean((run["reference_force"] - run["load_force"])[SETTLING:] ** 2)))


def largest_stable_gain(bench: Bench, *, low: float = 10.0, high: float = 300.0) -> float:
    """Largest K_p [1/s] with K_i = 15 after which a 3 N step settles without noise, to 0.5; `high` if all do."""

    def settles(gain: float) -> bool:
        schedule = Schedule(reference=ReferenceSignal(offset=3.0), gains=(gain, 15.0), seconds=8.0)
        run = simulate(AnalyticPlant(bench, noise=0.0), bench, schedule)
        left = float(np.max(np.abs((run["reference_force"] - run["load_force"])[-1000:])))
        return bool(run["flags"][-1] & Flag.ARMED) and left < 0.3

    if settles(high):
        return high
    while high - low > 0.5:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if settles(middle) else (low, middle)
    return low


EFFECTS = {
    "a leak": ({"id": "leakage_internal", "parameters": {"coefficient": 1e-13}},),
    "air in the oil": ({"id": "entrained_air", "parameters": {"volume_fraction": 0.005}},),
    "six effects": (
        {"id": "leakage_internal", "parameters": {"coefficient": 1e-13}},
        {"id": "valve_lag", "parameters": {"bandwidth": 110.0, "damping": 1.2}},
        {"id": "sensor_lag", "sensor": "load_force", "parameters": {"bandwidth": 25.0, "damping": 0.55}},
        {"id": "friction_coulomb", "parameters": {"force": 12.0}},
        {"id": "friction_stribeck", "parameters": {"breakaway_force": 5.0, "velocity": 0.01}},
        {"id": "friction_presliding", "parameters": {"stiffness": 5e5}},
    ),
}
"""Of a corrected.yaml; the six are those of the emulator's default truth."""


def speeds_with_effects(bench: Bench) -> dict[str, float]:
    """Samples per second of the compiled loop, best of five."""
    schedule, rates = Schedule(reference=ReferenceSignal(), gains=(90.0, 15.0), seconds=20.0), {}
    for name, effects in EFFECTS.items():
        plant = AnalyticPlant(replace(bench, effects=effects))
        simulate(plant, bench, schedule)
        taken = min(timeit.repeat(partial(simulate, plant, bench, schedule), number=1, repeat=5))
        rates[f"offline_samples_per_s with {name}"] = schedule.samples / taken
    return rates


def speeds(bench: Bench) -> dict[str, float]:
    """One call [us] and samples per second of the compiled loop, best of five."""
    box, plant = Box(bench), AnalyticPlant(bench)
    x = plant.reset(0)
    schedule = Schedule(reference=ReferenceSignal(), gains=(90.0, 15.0), seconds=20.0)
    taken = min(timeit.repeat(lambda: simulate(plant, bench, schedule), number=1, repeat=5))
    return {
        "box_tick_us": 1e6 / CALLS * min(timeit.repeat(lambda: box.tick(x, 0.0), number=CALLS, repeat=5)),
        "plant_step_us": 1e6 / CALLS * min(timeit.repeat(lambda: plant.step(0.0), number=CALLS, repeat=5)),
        "offline_samples_per_s": schedule.samples / taken,
    }


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write."""
    asked = parser("analytic_plant", __doc__).parse_args(arguments)
    bench = Bench.nominal()
    results: dict[str, object] = {"unit": "N", "frequencies": FREQUENCIES}
    print(f"{'load cell':<16} {'K_p, K_i':>10} " + "".join(f"{frequency:>9g} Hz" for frequency in FREQUENCIES))
    for name, plant in (("as in bench.yaml", bench), ("ideal", replace(bench, load_cell_bandwidth=None))):
        table = {}
        for gains in GAINS:
            row = table[f"{gains[0]:g}, {gains[1]:g}"] = [rmse(plant, bench, gains, f) for f in FREQUENCIES]
            shown = "".join(f"{value:>10.1f} N" if value < 1e9 else f"{'tripped':>12}" for value in row)
            print(f"{name:<16} {gains[0]:>5g}, {gains[1]:>3g} {shown}")
        stable = largest_stable_gain(plant)
        print(f"{name:<16} largest stable K_p up to 300: {stable:.0f} 1/s")
        results[name] = {"rmse": table, "largest_stable_kp": stable}
    results["speed"] = measured = speeds(bench) | speeds_with_effects(bench)
    for what, value in measured.items():
        print(f"{what} {value:.4g}")
    finish(results, asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
