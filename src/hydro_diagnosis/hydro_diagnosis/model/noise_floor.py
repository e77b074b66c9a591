# SPDX-License-Identifier: Apache-2.0
"""Measured noise floor: of the sensors, by the white part of the recordings, and of each residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import hypot

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.model.segment_record import BLOCK
from hydro_diagnosis.preprocessing.smoothing import ACCELERATION_NOISE_GAIN, TOTAL_NOISE_GAIN, VELOCITY_NOISE_GAIN
from hydro_diagnosis.preprocessing.white_noise import white_noise
from hydro_sim.model.bench import Bench


def sensor_noise(models: Sequence[SegmentModel]) -> dict[str, float]:
    """Standard deviation of each sensor's noise in one sample, by BenchState field name, SI units.

    It does not depend on the logger: of recordings at several rates, those of the highest estimate it best.
    """
    found: dict[str, list[tuple[int, float]]] = {}
    densest = min(model.spacing for model in models)
    for model in (model for model in models if model.spacing == densest):
        measured = model.segment.measured
        recorded = slice(model.segment.phase, None, model.spacing)
        for channel, signal in _nearly_white(model).items():
            noise = white_noise(signal[recorded], None if measured is None else measured[recorded])
            found.setdefault(channel, []).append((len(signal), noise))
    return {channel: _pooled(parts) for channel, parts in found.items()}


def _pooled(parts: list[tuple[int, float]]) -> float:
    counts, deviations = np.array(parts).T
    return float(np.sqrt(np.average(np.square(deviations), weights=counts)))


def _nearly_white(model: SegmentModel) -> dict[str, FloatArray]:
    """Channels without the kinks that the nominal model knows of: the current's steps bend pressures and f_h."""
    signals = {name: model.channels[name] for name in _SENSED if name in model.channels}
    if model.has_position and model.has_pressures and "valve_current" in model.channels:
        run = model.chamber_run(())
        signals["pressure_a"], signals["pressure_b"] = run.innovations
        if "hydraulic_force" in signals:
            signals["hydraulic_force"] = signals["hydraulic_force"] - np.cumsum(run.built_force) + run.built_force
    return signals


_SENSED = ("hydraulic_force", "load_force", "pressure_a", "pressure_b", "piston_position")


FLOOR = {"pressure_a": 300.0, "pressure_b": 300.0, "motion": 0.05, "load": 0.03, "hydraulic": 0.02}
"""Lower bound [Pa, N] by the residuals' own discretization (diagnosis.md, "Noise floor")."""


def residual_noise(sensors: Mapping[str, float], bench: Bench, step: float) -> dict[str, float]:
    """Standard deviation of each residual if nothing is missing, in its physical unit; `step` between recorded rows."""
    position = sensors.get("piston_position", 0.0)
    inertia = bench.moving_mass * position * ACCELERATION_NOISE_GAIN / step**2
    damping = bench.viscous_friction * position * VELOCITY_NOISE_GAIN / step
    spring = bench.spring_stiffness * position * TOTAL_NOISE_GAIN
    area = bench.piston_area
    by_pressure = hypot(area * sensors.get("pressure_a", 0.0), bench.area_ratio * area * sensors.get("pressure_b", 0.0))
    cell = sensors.get("hydraulic_force", by_pressure)
    noise = {
        "motion": hypot(cell * TOTAL_NOISE_GAIN, inertia, damping, spring),
        "load": hypot(sensors.get("load_force", 0.0) * TOTAL_NOISE_GAIN, spring),
        "hydraulic": hypot(cell, by_pressure) / (BLOCK / step) ** 0.5,
    }
    for chamber in "ab":
        noise["pressure_" + chamber] = sensors.get("pressure_" + chamber, 0.0) * TOTAL_NOISE_GAIN
    return {channel: hypot(deviation, FLOOR[channel]) for channel, deviation in noise.items()}
