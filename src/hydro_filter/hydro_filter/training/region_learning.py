# SPDX-License-Identifier: Apache-2.0
"""Certified region of a bench file: the box of a run's states, the metric proved to contract over it, and its file.

The box is the range of every state in a run that follows a sine of 1 Hz at the law's largest gains of the region,
widened by a tenth at either end. The largest force of `FORCE_AMPLITUDES` whose box has a proof gives the region.
Unproved regions are not written.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.signals import SAMPLE_PERIOD, FloatArray, Law, ReferenceSignal, Waveform, to_matrix
from hydro_filter.model.coordinates import LOOP_SIZE, Q_LOAD
from hydro_filter.model.loop import closing_current, make_loop, recorded_samples
from hydro_filter.model.records import linearize
from hydro_filter.region.certified_region import (
    TOLERANCED_PARAMETERS,
    Bounds,
    CertifiedRegion,
    ToleranceCell,
    delay_samples,
    region_path,
)
from hydro_filter.region.parameters import STATE_NAMES, bench_parameters, containment_share, region_states
from hydro_filter.region.proof import prove_cell
from hydro_filter.training.region_metric import solve_cell
from hydro_sim.box.box import BoxConfig
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import Sensors
from hydro_sim.simulation.offline import Schedule, simulate

FORCE_AMPLITUDES = (1.0, 2.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)
"""Amplitudes over the bench's force: 300, 200, 100 and 50 N on the nominal one."""
RUN_TIME, SETTLING_SAMPLES = 6.0, 1000
RANGE_MARGIN = 0.1
"""Margin at either end of a range, over its width."""
SPLIT_TOLERANCES = (*TOLERANCED_PARAMETERS, "dead_time")
"""Tolerances that may be split: a bench has one value of each, so that every part may have a metric of its own."""
RATE_MARGINS, FAST_RATE_MARGINS = (0.9, 0.6, 1.3, 2.5), (3.0, 5.0, 8.0, 1.5)
"""1/s, margins on lambda for the radius that the vertices leave out, tried in turn: for C_1 = 1, a slow loop, and
for smaller C_1."""
SEGMENT_PARTS = 6
"""Intervals per segment of the gain table in the proof."""


@dataclass(frozen=True, kw_only=True)
class RegionTarget:
    """Specification of a region to be proved."""

    law: BoxLaw | None = None
    """The compensated law; None: the paper's."""
    gains: tuple[float, ...] = (15.0, 25.0, 35.0, 45.0, 55.0, 65.0, 75.0, 85.0, 90.0)
    """K_p [1/s] of the metric's table."""
    integral_gain: float = 15.0
    """K_i [1/s^2] of the run."""
    gain_rate: float = 0.0
    """Fastest change of K_p [1/s^2]."""
    rate: float = 0.1
    """lambda [1/s]."""
    tolerance: float = 0.0
    """Tolerance of each of `toleranced_parameters`, to either side, as a share."""
    toleranced_parameters: tuple[str, ...] = TOLERANCED_PARAMETERS
    """Parameters of the bench that have the tolerance."""
    tolerance_parts: int = 1
    """Parts of each tolerance of `SPLIT_TOLERANCES`; every combination of parts has a metric of its own."""
    dead_time_tolerance: float = 0.0
    """s, tolerance of the dead time, above that of the bench file."""
    forces: tuple[float, ...] = FORCE_AMPLITUDES


def simulate_states(
    model: Bench, bench: Bench, target: RegionTarget, force: float, gain: float, seed: int = 0
) -> FloatArray:
    """Return the states `STATE_NAMES`, shape (n, 10), of a run with a sine of `force` [N], 1 Hz, at K_p = `gain`."""
    loop = make_loop(model, bench)
    plant = AnalyticPlant(model, settings=Sensors.of_size(model.size))
    signal = ReferenceSignal(waveform=Waveform.SINE, amplitude=force, offset=0.0, frequency=1.0)
    law = Law.PAPER if target.law is None else Law.COMPENSATED
    config = BoxConfig().of_bench(bench)
    if target.law is not None:
        config = replace(config, compensated=target.law)
    plan = Schedule(reference=signal, gains=(gain, target.integral_gain), seconds=RUN_TIME, law=law)
    states = simulate(plant, bench, plan, config=config, seed=seed)
    opening = linearize(loop.record, recorded_samples(states), linearized=np.zeros(len(states), np.bool_)).opening
    valve = np.column_stack((opening, states["nominal_valve_current"] - closing_current(loop)))
    return region_states(bench_parameters(model, bench)[0], to_matrix(states), valve)[SETTLING_SAMPLES:]


def _box(samples: FloatArray, dry: float, mass: float) -> dict[str, Bounds]:
    low, high = samples.min(axis=0), samples.max(axis=0)
    wider = RANGE_MARGIN * (high - low)
    ranges = {name: (float(a), float(b)) for name, a, b in zip(STATE_NAMES, low - wider, high + wider, strict=True)}
    for name in ("velocity", "opening_rate", "opening_error", "pressure_a_rate", "pressure_b_rate"):
        size = max(map(abs, ranges[name]))
        ranges[name] = (-size, size)
    # x'_box is a millisecond late; friction and the loop bound the piston's acceleration
    late = 1.5 * SAMPLE_PERIOD * max(dry / mass, 0.05 * ranges["velocity"][1] / SAMPLE_PERIOD)
    return ranges | {"velocity_error": (-late, late)}


@threadpool_limits.wrap(limits=1, user_api="blas")  # the matrices are small: more threads only wait for one another
def certify_region(model: Bench, bench: Bench, target: RegionTarget) -> CertifiedRegion | None:
    """Return the certified region of the largest provable amplitude; None: none is proved."""
    ours, law = bench_parameters(model, bench)
    sensors, began = Sensors.of_size(model.size), time.process_time()
    unit = make_loop(model, bench).scale[:LOOP_SIZE].tolist()
    band = (1.0 - target.tolerance, 1.0 + target.tolerance)
    tolerances = {name: band if name in target.toleranced_parameters else (1.0, 1.0) for name in TOLERANCED_PARAMETERS}
    tolerances["dead_time"] = (ours["dead_time"], ours["dead_time"] + target.dead_time_tolerance)
    c_1 = 1.0 if target.law is None else target.law.velocity_compensation
    memory = ours["velocity_memory"]
    noise = {
        "friction": ours["dry_friction"], "overlap": ours["overlap"], "force_noise": 4.0 * sensors.force_noise,
        "pressure_noise": 4.0 * sensors.pressure_noise,
        "velocity_noise": (1.0 - memory) * sensors.position_step / SAMPLE_PERIOD,
    }  # fmt: skip
    weights = (0.5, 0.25, 0.25 if c_1 > 0.0 else 0.0, 0.0)
    if ours["overlap"] > 0.0:
        weights = (0.35, 0.15, 0.15 if c_1 > 0.0 else 0.0, 0.35)
    for share in target.forces:
        force = share * model.size.force
        samples = simulate_states(model, bench, target, force, target.gains[-1])
        region = CertifiedRegion(
            believed=law, bench=ours, tolerances=tolerances,
            states=_box(samples, ours["dry_friction"], ours["moving_mass"]),
            velocity_compensation=(c_1, c_1), proportional_gain=(target.gains[0], target.gains[-1]),
            gain_rate=target.gain_rate, disturbances=noise, weights=weights, contraction_rate=target.rate,
            tube_rate=target.rate, tube=math.inf,
            scale=(*unit, *[unit[1]] * delay_samples(tolerances["dead_time"][1])),
        )  # fmt: skip
        cells: list[ToleranceCell] = []
        for part in _parts(tolerances, target.tolerance_parts):
            if (cell := _proved(region, part, target.gains)) is None:
                break
            cells.append(cell)
        else:
            inverse = [np.linalg.inv(one)[Q_LOAD, Q_LOAD] for cell in cells for one in cell.matrices]
            tubes = [region.scale[Q_LOAD] * math.sqrt(one) for one in inverse]
            facts = {
                "force": force, "seconds": round(time.process_time() - began, 1), "tubes": tubes,
                "inside": containment_share(region.states, samples), "model": model.digest, "box": bench.digest,
            }  # fmt: skip
            return replace(region, cells=tuple(cells), tube=max(tubes) * (1.0 + 1e-9), facts=facts)
    return None


def _parts(tolerances: dict[str, Bounds], split: int) -> Iterator[dict[str, Bounds]]:
    names = [name for name in SPLIT_TOLERANCES if tolerances[name][0] < tolerances[name][1]]
    ends = {name: np.linspace(*tolerances[name], split + 1) for name in names}
    for places in product(range(split), repeat=len(names)):
        parts = {n: (float(ends[n][i]), float(ends[n][i + 1])) for n, i in zip(names, places, strict=True)}
        yield tolerances | parts


def _proved(region: CertifiedRegion, tolerances: dict[str, Bounds], gains: tuple[float, ...]) -> ToleranceCell | None:
    for reserve in RATE_MARGINS if region.velocity_compensation[1] == 1.0 else FAST_RATE_MARGINS:
        cell, left = None, -math.inf
        try:
            cell = solve_cell(region, tolerances, np.array(gains), reserve)
            left = prove_cell(region, cell, SEGMENT_PARTS) if cell is not None else left
        except (ValueError, np.linalg.LinAlgError) as error:
            print(f"{error}", file=sys.stderr)
        print(f"reserve {reserve:g} 1/s: room {left:.2g}", file=sys.stderr)
        if cell is not None and left > 0.0:
            return cell
    return None


PAPER_GAINS = (
    (15.0, 25.0, 35.0, 45.0, 55.0, 65.0, 75.0, 85.0, 90.0),
    (15.0, 25.0, 35.0, 45.0, 55.0, 60.0),
    (15.0, 22.5, 30.0),
)
"""Tables of K_p [1/s] for the paper's law, tried in turn: up to the guard's default limit, and smaller ones."""
GAIN_SHARES = (0.15, 0.2, 0.25, 0.325, 0.4, 0.5, 0.625, 0.75, 0.875, 1.0)
"""K_p over the compensated law's base K_p; at smaller gains the loop decays slower than the proof's conservatism."""


def write_regions(out: Path, model: Bench, bench: Bench, laws: Sequence[BoxLaw | None]) -> None:
    """Prove a region for each law (None: the paper's), write it next to the metric file `out`, print a summary."""
    for law in laws:
        name = "paper's law" if law is None else "compensated law"
        tables = PAPER_GAINS if law is None else (tuple(share * law.base_kp for share in GAIN_SHARES),)
        region = None
        for gains in tables:
            target = RegionTarget(gains=gains, gain_rate=5.0) if law is None else RegionTarget(
                law=law, gains=gains, gain_rate=50.0, rate=0.5, integral_gain=law.base_ki
            )  # fmt: skip
            if (region := certify_region(model, bench, target)) is not None:
                break
        if region is None:
            print(f"{name}: no region is proved", file=sys.stderr)
            continue
        path = region_path(out, compensated=law is not None)
        region.save(path)
        low, high = region.proportional_gain
        print(
            f"{path}: {name}, K_p {low:g} to {high:g} 1/s, the states of a sine of {region.facts['force']:.0f} N: "
            f"decay at {region.contraction_rate:g} 1/s, tube {region.tube:.0f} N"
        )
