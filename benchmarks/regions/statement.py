# SPDX-License-Identifier: Apache-2.0
"""Statement of a region: the box of a run's states, the metric proved to contract over it, and what was assumed.

The box is the range of every state in a run that follows a sine of 1 Hz at the region's largest gain, widened by a
tenth at either end.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.regions.metric import solve_metric
from benchmarks.regions.parameters import (
    STATE_NAMES,
    TOLERANCED_PARAMETERS,
    Bounds,
    bench_parameters,
    containment_share,
    region_states,
)
from benchmarks.verify_region import verify
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.signals import SAMPLE_PERIOD, FloatArray, Law, ReferenceSignal, Waveform, to_matrix
from hydro_filter.model.coordinates import LOOP_SIZE, Q_LOAD
from hydro_filter.model.loop import closing_current, make_loop, recorded_samples
from hydro_filter.model.records import linearize
from hydro_sim.box.box import BoxConfig
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import Sensors
from hydro_sim.simulation.offline import Schedule, simulate

RUN_TIME, SETTLING_SAMPLES = 6.0, 1000
RANGE_MARGIN = 0.1
"""Margin at either end of a range, over its width."""
RATE_MARGINS, FAST_RATE_MARGINS = (0.9, 0.6, 1.3, 2.5), (3.0, 5.0, 8.0, 1.5)
"""1/s, margins on lambda for the radius that the vertices leave out, tried in turn: for C_1 = 1, a slow loop, and
for smaller C_1."""
ASSUMPTIONS = (
    "The bench has the structure of the bench file: two chambers of constant bulk modulus with laminar leakage, sharp "
    "edges of the valve, a spool and a load cell of second order, a mass, a linear spring, end stops out of reach.",
    "The states of both trajectories, and of those between them, stay within the box over the sample, and the spool "
    "does not change its side of zero: g differs on both sides.",
    "Both trajectories have the same weighted sum of the pressures, which the loop hardly moves, and the same "
    "integral.",
    "The force law's current is within the valve's limit, above the floor of g, and acts at the sample at which it was "
    "computed, held for 1 ms, without jitter.",
    "A disturbance is constant within a sample: dry friction up to its level, what an overlap takes from the opening, "
    "noise up to four standard deviations, the encoder's step.",
    "Piston areas, stroke, mass, viscous friction, the spool's damping, load cell and leakage are those of the file.",
)


@dataclass(frozen=True, kw_only=True)
class RegionTarget:
    """Specification of a region to be proved."""

    law: BoxLaw | None = None
    """The compensated law; None: the paper's."""
    gains: tuple[float, ...]
    """K_p [1/s] of the metric's table."""
    gain_rate: float = 0.0
    """Fastest change of K_p [1/s^2]."""
    rate: float = 0.1
    """lambda [1/s]."""
    tolerance: float = 0.0
    """Tolerance of each of `toleranced_parameters`, to either side, as a share."""
    toleranced_parameters: tuple[str, ...] = TOLERANCED_PARAMETERS
    tolerance_parts: int = 1
    """Parts of each tolerance; every combination of parts has a metric of its own."""
    dead_time_tolerance: float = 0.0
    """s, tolerance of the dead time, above that of the bench file."""
    force: float
    """Amplitude of the box's run over the bench's force."""


def simulate_states(model: Bench, bench: Bench, target: RegionTarget, force: float, seed: int = 0) -> FloatArray:
    """Return the states `STATE_NAMES`, shape (n, 10), of a run with a sine of `force` [N] at 1 Hz."""
    loop = make_loop(model, bench)
    plant = AnalyticPlant(model, settings=Sensors.of_size(model.size))
    signal = ReferenceSignal(waveform=Waveform.SINE, amplitude=force, offset=0.0, frequency=1.0)
    law, integral_gain, config = Law.PAPER, 15.0, BoxConfig().of_bench(bench)
    if target.law is not None:
        law, integral_gain, config = Law.COMPENSATED, target.law.base_ki, replace(config, compensated=target.law)
    plan = Schedule(reference=signal, gains=(target.gains[-1], integral_gain), seconds=RUN_TIME, law=law)
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
def certify_region(model: Bench, bench: Bench, target: RegionTarget) -> dict[str, Any] | None:
    """Return the content of the file that states the region; None: it is not proved."""
    began = time.process_time()
    statement, samples = unproved_statement(model, bench, target)
    for part in _parts(statement["tolerances"], target.tolerance_parts):
        if (cell := _proved(statement, part, target.gains)) is None:
            return None
        statement["cells"].append(cell)
    inverse = [np.linalg.inv(one)[Q_LOAD, Q_LOAD] for cell in statement["cells"] for one in cell["matrices"]]
    tubes = [statement["scale"][Q_LOAD] * math.sqrt(one) for one in inverse]
    facts = {
        "force": target.force * model.size.force, "seconds": round(time.process_time() - began, 1), "tubes": tubes,
        "inside": containment_share(statement["states"], samples), "model": model.digest, "box": bench.digest,
    }  # fmt: skip
    return {**statement, "tube": max(tubes) * (1.0 + 1e-9), "facts": facts, "assumed": ASSUMPTIONS}


def unproved_statement(model: Bench, bench: Bench, target: RegionTarget) -> tuple[dict[str, Any], FloatArray]:
    """Return the content of a statement without its metric, and the states of the run that its box is of."""
    ours, law = bench_parameters(model, bench)
    sensors, band = Sensors.of_size(model.size), (1.0 - target.tolerance, 1.0 + target.tolerance)
    tolerances = {name: band if name in target.toleranced_parameters else (1.0, 1.0) for name in TOLERANCED_PARAMETERS}
    tolerances["dead_time"] = (ours["dead_time"], ours["dead_time"] + target.dead_time_tolerance)
    c_1, unit = 1.0 if target.law is None else target.law.velocity_compensation, make_loop(model, bench).scale
    on_their_way = math.ceil(tolerances["dead_time"][1] / SAMPLE_PERIOD - 1e-9)
    weights = (0.5, 0.25, 0.25 if c_1 > 0.0 else 0.0, 0.0)
    if ours["overlap"] > 0.0:
        weights = (0.35, 0.15, 0.15 if c_1 > 0.0 else 0.0, 0.35)
    samples = simulate_states(model, bench, target, target.force * model.size.force)
    return {
        "believed": law, "bench": ours, "tolerances": tolerances,
        "states": _box(samples, ours["dry_friction"], ours["moving_mass"]), "velocity_compensation": (c_1, c_1),
        "proportional_gain": (target.gains[0], target.gains[-1]), "gain_rate": target.gain_rate,
        "disturbances": {
            "friction": ours["dry_friction"], "overlap": ours["overlap"], "force_noise": 4.0 * sensors.force_noise,
            "pressure_noise": 4.0 * sensors.pressure_noise,
            "velocity_noise": (1.0 - ours["velocity_memory"]) * sensors.position_step / SAMPLE_PERIOD,
        },
        "weights": weights, "contraction_rate": target.rate, "tube_rate": target.rate, "tube": math.inf,
        "scale": [*unit[:LOOP_SIZE].tolist(), *[float(unit[1])] * on_their_way], "cells": [], "period": SAMPLE_PERIOD,
    }, samples  # fmt: skip


def _parts(tolerances: dict[str, Bounds], split: int) -> Iterator[dict[str, Bounds]]:
    names = [name for name, (low, high) in tolerances.items() if low < high]
    ends = {name: np.linspace(*tolerances[name], split + 1) for name in names}
    for places in product(range(split), repeat=len(names)):
        parts = {n: (float(ends[n][i]), float(ends[n][i + 1])) for n, i in zip(names, places, strict=True)}
        yield tolerances | parts


def _proved(
    statement: dict[str, Any], tolerances: dict[str, Bounds], gains: tuple[float, ...]
) -> dict[str, Any] | None:
    for margin in RATE_MARGINS if statement["velocity_compensation"][1] == 1.0 else FAST_RATE_MARGINS:
        reason = "no metric is found"
        try:
            if (matrices := solve_metric(statement, tolerances, np.array(gains), margin)) is not None:
                cell = {"tolerances": tolerances, "gains": list(gains), "matrices": matrices.tolist()}
                if not (reason := verify({**statement, "tolerances": tolerances, "cells": [cell]})):
                    return cell
        except (ValueError, ZeroDivisionError, np.linalg.LinAlgError) as error:
            reason = str(error)
        print(f"margin {margin:g} 1/s: {reason}", file=sys.stderr)
    return None
