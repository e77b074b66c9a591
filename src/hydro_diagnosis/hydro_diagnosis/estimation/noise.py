# SPDX-License-Identifier: Apache-2.0
"""Standard deviations of the residuals under a complete model.

They follow from the sensors' noise, estimated from the white part of the recordings themselves; noise and timing of
the flows; and the unknown sign of dry friction near standstill.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from math import hypot
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt
from scipy.signal import lfilter
from scipy.special import ndtr

from hydro_core.bench_scales import unit_ratio
from hydro_diagnosis.bench_parameters import load_cell_at_rod
from hydro_diagnosis.effects.base import EffectHypothesis, FloatArray, Pair
from hydro_diagnosis.model import chambers
from hydro_diagnosis.model.chambers import AVERAGING_TIME, observer_gain
from hydro_diagnosis.preprocessing.smoothing import (
    ACCELERATION_NOISE_GAIN,
    KINEMATIC_WIDTH,
    TOTAL_NOISE_GAIN,
    VELOCITY_NOISE_GAIN,
    white_noise,
)
from hydro_diagnosis.recording import MEASURED_CHANNELS
from hydro_diagnosis.significance import OUTLIER_FACTOR
from hydro_sim.model import equations as eq
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects.base import DECLARED_SIZE

if TYPE_CHECKING:
    from hydro_diagnosis.model.segment_model import SegmentModel

VELOCITY_UNCERTAINTY = 1e-3
"""Uncertainty [m/s] of the velocity near standstill, of a machine of `DECLARED_SIZE`."""


def sensor_noise(models: Sequence[SegmentModel]) -> dict[str, float]:
    """Standard deviation of each sensor's noise in one sample, by BenchState field name, SI units.

    It does not depend on the logging rate: of recordings at several rates, those at the highest are used.
    """
    found: dict[str, list[tuple[int, float]]] = {}
    densest = min(model.spacing for model in models)
    for model in (model for model in models if model.spacing == densest):
        measured = model.segment.measured
        recorded = slice(model.segment.phase, None, model.spacing)
        signals = {name: model.channels[name] for name in MEASURED_CHANNELS if name in model.channels}
        if model.has_position and model.has_pressures and "valve_current" in model.channels:
            run = model.chamber_run(())  # without the kinks of pressures and f_h by steps of the current
            signals["pressure_a"], signals["pressure_b"] = run.innovations
            if "hydraulic_force" in signals:
                signals["hydraulic_force"] = (
                    signals["hydraulic_force"] - np.cumsum(run.force_increments) + run.force_increments
                )
        for channel, signal in signals.items():
            noise = white_noise(signal[recorded], None if measured is None else measured[recorded])
            found.setdefault(channel, []).append((len(signal), noise))
    parts = {channel: np.array(one).T for channel, one in found.items()}
    return {
        channel: float(np.sqrt(np.average(np.square(deviations), weights=counts)))
        for channel, (counts, deviations) in parts.items()
    }


NOISE_FLOOR = {"pressure_a": 300.0, "pressure_b": 300.0, "motion": 0.05, "load": 0.03, "hydraulic": 0.02}
"""Lower bound [Pa, N] of the residuals' standard deviations, by discretisation (diagnosis.md, "Noise floor"), of a
machine of `DECLARED_SIZE`."""


def residual_noise(sensors: Mapping[str, float], bench: Bench, step: float) -> dict[str, float]:
    """Return the standard deviation of each residual by sensor noise, physical units; `step` [s] between rows."""
    position = sensors.get("piston_position", 0.0)
    inertia = bench.moving_mass * position * ACCELERATION_NOISE_GAIN / step**2
    damping = bench.viscous_friction * position * VELOCITY_NOISE_GAIN / step
    spring = bench.spring_stiffness * position * TOTAL_NOISE_GAIN
    area = bench.piston_area
    by_pressure = hypot(area * sensors.get("pressure_a", 0.0), bench.area_ratio * area * sensors.get("pressure_b", 0.0))
    cell = sensors.get("hydraulic_force", by_pressure)
    load = sensors.get("load_force", 0.0) if load_cell_at_rod(sensors, bench) else 0.0
    noise = {
        "motion": hypot(cell * TOTAL_NOISE_GAIN, load * TOTAL_NOISE_GAIN, inertia, damping, spring),
        "load": hypot(sensors.get("load_force", 0.0) * TOTAL_NOISE_GAIN, spring),
        "hydraulic": hypot(cell, by_pressure) / (AVERAGING_TIME / step) ** 0.5,
    }
    for chamber in "ab":
        noise["pressure_" + chamber] = sensors.get("pressure_" + chamber, 0.0) * TOTAL_NOISE_GAIN
    return {
        channel: hypot(deviation, NOISE_FLOOR[channel] * unit_ratio(unit, DECLARED_SIZE, bench.size))
        for channel, deviation in noise.items()
        for unit in ("Pa" if channel.startswith("pressure") else "N",)
    }


def mass_attenuation(models: Sequence[SegmentModel], sensors: Mapping[str, float], mass: float) -> float:
    """Attenuation bias [kg] of a moving mass by encoder noise: `mass` times the acceleration's noise-to-signal power.

    The largest bias of least squares with a noisy regressor (errors in variables: Fuller 1987); through the controller
    the noise is also in the motion itself, so that the exact bias is not known.
    """
    step = min(model.step * model.spacing for model in models)
    noise = sensors.get("piston_position", 0.0) * ACCELERATION_NOISE_GAIN / step**2
    power = float(np.mean(np.square(np.concatenate([model.smooth_kinematic(model.a) for model in models]))))
    return mass * noise**2 / max(power - noise**2, noise**2, 1e-12)


class SegmentNoise:
    """Standard deviations of a segment's residuals under a complete model, physical units.

    `model`: the segment. `sensors`: noise of each sensor by its channel, SI units. `flows`: whether the pressures have
    residuals.
    """

    def __init__(self, model: SegmentModel, sensors: Mapping[str, float], *, flows: bool) -> None:
        self._model = model
        self._speeds = unit_ratio("m/s", DECLARED_SIZE, model.base.size)
        self._doubt = VELOCITY_UNCERTAINTY * self._speeds
        self.residuals = residual_noise(sensors, model.base, model.step * model.spacing)
        """Standard deviations by sensor noise, by channel."""
        self.flows = self._of_flows(sensors) if flows else None
        """Standard deviations [Pa] of the pressures by noise and timing of the flows; None without their residuals."""

    def friction(self, claims: Sequence[EffectHypothesis], reversals: int) -> FloatArray:
        """Standard deviation [N] of dry friction by the uncertain velocity near standstill, decimated.

        `reversals`: number in all recordings; the smoothing kernel's error of the velocity is the same at each, so that
        it does not average out: it counts by the root of their number.
        """
        model = self._model
        level = model.dry_friction_magnitude(claims)
        doubt = self._swing(
            claims,
            self._doubt + 0.5 * np.abs(model.a) * model.spacing * model.step,
            np.zeros_like(level),
        )
        beyond = model.dry_friction_magnitude(claims, np.full_like(model.v, self._speeds))  # at 1 m/s it slides
        if not any(claim.effect.models_presliding for claim in claims):  # bristles: no jump of the force
            doubt = np.hypot(doubt, np.sqrt(reversals) * self._swing(claims, self._kink(claims), beyond))
        late = [claim for claim in claims if claim.effect.lagged_channel == "hydraulic_force"]
        return model.at_evaluated(model.smooth(np.abs(model.reading("hydraulic_force", doubt, late))))

    def _kink(self, claims: Sequence[EffectHypothesis]) -> FloatArray:
        """Error [m/s] of the velocity by the first Gaussian around reversals, where the acceleration jumps.

        Dry friction F reverses there, so x_p'' jumps by 2 F / m. The error of a kink of slope J behind a Gaussian of
        width s is J s (phi(u) - |u| Phi(-|u|)), at |u| widths from it.
        """
        model = self._model
        at_rest = model.dry_friction_magnitude(claims, np.zeros_like(model.v))
        width = KINEMATIC_WIDTH * model.spacing * model.step
        jump = 2.0 * at_rest / model.bench(claims).moving_mass
        u = self._since_rest / (KINEMATIC_WIDTH * model.spacing)
        return jump * width * (np.exp(-0.5 * u * u) / np.sqrt(2.0 * np.pi) - u * ndtr(-u))

    @cached_property
    def reversals(self) -> int:
        """Number of stops and reversals of the piston; encoder noise at rest does not count."""
        slides = ~self._resting & (np.abs(self._model.v) > OUTLIER_FACTOR * self._doubt)
        marks = self._resting.astype(int) - slides.astype(int)
        return int(np.count_nonzero(np.diff(marks[marks != 0], prepend=-1) == 2))

    @cached_property
    def _resting(self) -> npt.NDArray[np.bool_]:
        model = self._model
        resting = np.abs(model.v) < self._doubt
        turns = model.v[:-1] * model.v[1:] <= 0.0
        resting[:-1] |= turns
        resting[1:] |= turns
        return resting

    @cached_property
    def _since_rest(self) -> FloatArray:
        """Number of samples to the nearest one at which the piston is at rest or reverses."""
        model = self._model
        if not self._resting.any():
            return np.full_like(model.v, len(model.v))
        return np.asarray(distance_transform_edt(~self._resting))

    def _swing(self, claims: Sequence[EffectHypothesis], velocity: FloatArray, but: FloatArray) -> FloatArray:
        """Half the change [N] of dry friction, less `but` [N], from -`velocity` to +`velocity` about the recorded."""
        model = self._model
        low, high = (
            (model.dry_friction_magnitude(claims, one) - but) * np.tanh(one / self._doubt)
            for one in (model.v - velocity, model.v + velocity)
        )
        return np.asarray(np.abs(high - low) / 2.0)

    def _of_flows(self, noise: Mapping[str, float]) -> Pair:
        """Standard deviations [Pa] of the pressures from both chamber equations, reading noise excluded, decimated.

        By the timing of displacement and flow, and by the `noise` [Pa] of the pressures in the flows.
        """
        model = self._model
        bench = model.base
        uncertainty = 3e-6  # s, between the equations, integrated sample by sample, and the sensors
        timing = self._stiffest(0) * bench.piston_area * uncertainty * model.smooth(np.abs(model.v))
        a, b = (
            model.at_evaluated(np.hypot(timing, self._flow_uncertainty(chamber, noise["pressure_" + chamber])))
            for chamber in "ab"
        )
        return a, b

    def _stiffest(self, chamber: int) -> float:
        """Largest beta/V [Pa/m3] of a chamber: with the piston at its end."""
        model = self._model
        bench, moduli = model.base, (model.base.bulk_modulus, model.base.bulk_modulus)
        return float(eq.stiffnesses(bench, moduli, 0.0 if chamber == 0 else bench.stroke)[chamber])

    def _flow_uncertainty(self, chamber: str, noise: float) -> FloatArray:
        """Standard deviation [Pa] of a pressure by the noise of its own reading in the flow."""
        model = self._model
        bench, current = model.base, model.channels["valve_current"]
        pressure = chambers.interval_means(model.channels["pressure_" + chamber])
        fed = current > 0.0 if chamber == "a" else current < 0.0
        drop = np.abs(np.where(fed, bench.supply_pressure - pressure, pressure - bench.tank_pressure))
        gain = bench.valve_gain * np.abs(current) / (2.0 * np.sqrt(np.maximum(drop, noise)))
        stiff = self._stiffest("ab".index(chamber))
        built = np.square(stiff * gain * noise * model.step)  # neighbours share a reading
        if model.spacing > 1:
            # Dither of the box between the rows: of n samples per row n - 1 are not recorded, and the recorded one
            # stands for all, together n (n - 1) times the variance of a single one. Leaving out half of the rows does
            # not reveal this error: neither half has these samples.
            measured = model.segment.measured
            seen = np.ones(len(model.time), dtype=np.bool_) if measured is None else measured
            dither = white_noise(current[model.segment.phase :: model.spacing])
            per_ampere = stiff * bench.valve_gain * np.sqrt(np.maximum(drop, noise)) * model.step
            built = built + np.square(per_ampere) * np.where(seen, 0.0, model.spacing * dither**2)
        kept = (1.0 - observer_gain(model.step)) ** 2
        return np.sqrt(np.maximum(lfilter([1.0], [1.0, -kept], built), 0.0))
