# SPDX-License-Identifier: Apache-2.0
"""Checks of commissioning recordings: functions that return a figure, or raise GateError with the reason."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_bridge.serial.protocol import LawState
from hydro_core.signals import NEUTRAL_COEFFICIENTS, SAMPLE_PERIOD, Flag, FloatArray, Law, StateArray
from hydro_filter.controller.loop_filter import LoopFilter
from hydro_filter.model.sample import Sample
from hydro_policy.commissioning.record import GateError
from hydro_policy.task.cases import Score
from hydro_sim.model.bench import Bench

LOST_SHARE_MAX = 0.01  # largest share of lost samples, and of samples with late commands, in a recording
CORRELATION_MIN = 0.8  # correlation that two signals of the same motion must exceed
AMPLITUDE_RATIO = (0.4, 1.5)  # bounds of the load force's standard deviation over its reference's
STANDSTILL_RATIO = 0.9  # RMSE on a sine over the sine's RMS, above which the load force did not follow
SIGN_CHECK_FREQUENCY = 0.5  # frequency [Hz] of the motion for the sign check
_INTERRUPTION_SAMPLES_MIN = 1000  # missing samples in a row from which a gap is an intended interruption, not a loss


def sample_loss(states: StateArray, seconds: float) -> tuple[float, float]:
    """Return sample rate [1/s] and share of lost samples of a recording of `seconds` s at rest; raises GateError."""
    steps = np.diff(states["sequence"].astype(np.int64))
    lost = float(np.mean(steps - 1)) if len(steps) else 1.0
    if lost > LOST_SHARE_MAX or len(steps) < 0.3 * seconds / SAMPLE_PERIOD:
        raise GateError(f"{len(states)} samples in {seconds:g} s, {100 * lost:.1f} % lost: see the line and its driver")
    return float(len(steps) / np.ptp(states["time"])), lost


def sensor_noise(states: StateArray, bench: Bench) -> tuple[dict[str, float], float]:
    """Return each signal's noise at rest (std, SI) by field, and the hydraulic force's offset from pressures [N]."""
    most = bench.piston_area * bench.supply_pressure  # N, of the piston at full supply
    ranges = {
        "pressure_a": (-0.02 * bench.supply_pressure, 1.05 * bench.supply_pressure),
        "pressure_b": (-0.02 * bench.supply_pressure, 1.05 * bench.supply_pressure / bench.area_ratio),
        "piston_position": (-0.02 * bench.stroke, 1.02 * bench.stroke),
        "load_force": (-most, most),
        "hydraulic_force": (-most, most),
    }
    noise = {}
    for name, (low, high) in ranges.items():
        values = states[name]
        if not np.isfinite(values).all() or values.min() < low or values.max() > high:
            raise GateError(f"{name} reads {np.nanmin(values):g} to {np.nanmax(values):g}, outside {low:g} to {high:g}")
        noise[name] = float(np.std(np.diff(values)) / np.sqrt(2.0))
        if name != "piston_position" and not np.ptp(values):
            raise GateError(f"{name} is {values[0]:g} in every sample: this reading is stuck")
    off = float(np.mean(states["hydraulic_force"] - _pressure_force(states, bench)))
    if abs(off) > 0.1 * most:
        raise GateError(f"the hydraulic force differs from the pressures by {off:.0f} N: units, zero or area are wrong")
    return noise, off


def drift_rate(states: StateArray) -> float:
    """Return the drift rate of the load force at rest with the valve closed [N/s]: slope of a linear fit."""
    return float(np.polyfit(states["time"] - states["time"][0], states["load_force"], 1)[0])


def drift_warning(states: StateArray, amplitude: float) -> str:
    """Return a warning if the load force at rest exceeds `amplitude` [N], or drifts by it in a minute; else empty."""
    force, rate = float(np.median(states["load_force"])), drift_rate(states)
    if abs(force) <= amplitude and 60.0 * abs(rate) <= amplitude:
        return ""
    return f"disarmed, the load force stood at {force:.3g} N and crept by {rate:.2g} N/s: null the valve"


def channel_correlations(states: StateArray, bench: Bench) -> dict[str, float]:
    """Return the correlations of pairs of signals that must agree in a slow motion, by the pair's name.

    The load force may lag its reference by up to a quarter of a period, through valve overlap and dry friction.
    """
    if not np.ptp(states["piston_position"]):
        most = 1e3 * np.abs(states["valve_current"]).max()
        raise GateError(f"the piston did not move under currents up to {most:.3g} mA: see supply, valve and base_kp")
    speeds = states["piston_velocity"], np.gradient(states["piston_position"], SAMPLE_PERIOD)
    read, derived = (np.convolve(values, np.full(50, 0.02), "valid") for values in speeds)
    pairs: dict[str, tuple[FloatArray, FloatArray]] = {
        "hydraulic force and pressures": (states["hydraulic_force"], _pressure_force(states, bench)),
        "position and load force": (states["piston_position"], states["load_force"]),
        "velocity and position": (read, derived),
    }
    found = {"load force and its reference": _lagged_correlation(states, SIGN_CHECK_FREQUENCY)}
    found |= {name: float(np.corrcoef(*pair)[0, 1]) for name, pair in pairs.items()}
    wrong = [f"{name} ({value:.2f})" for name, value in found.items() if not value > CORRELATION_MIN]
    if wrong:
        raise GateError(f"these do not follow each other, a sign or two channels are exchanged: {', '.join(wrong)}")
    return found


def require_tracking(states: StateArray, frequency: float) -> None:
    """Raise GateError unless the load force tracks a sine: `AMPLITUDE_RATIO`, lag of at most a quarter of a period.

    The bounds are wide, since valve overlap and dry friction are identified only later, by the diagnosis.
    """
    size = float(np.std(states["load_force"]) / np.std(states["reference_force"]))
    found = _lagged_correlation(states, frequency)
    if not (AMPLITUDE_RATIO[0] <= size <= AMPLITUDE_RATIO[1] and found > CORRELATION_MIN):
        raise GateError(f"the load force has {size:.2f} times the swing of its reference: see valve and supply")


def is_motion_blocked(states: StateArray) -> bool:
    """Return whether overlap and dry friction block the motion of the sign check: a larger one is needed."""
    return (
        not np.ptp(states["piston_position"])
        or 0.0 < _lagged_correlation(states, SIGN_CHECK_FREQUENCY) <= CORRELATION_MIN
    )


def unusable_share(armed: StateArray) -> float:
    """Return the share of lost samples, and of samples with late commands, in the armed samples of a recording."""
    lost = np.diff(armed["sequence"].astype(np.int64)) - 1
    late = armed["flags"] & (Flag.FILTER_STALE | Flag.WATCHDOG) != 0
    return float((lost[lost < _INTERRUPTION_SAMPLES_MIN].sum() + late.sum()) / len(armed))


def disturbed_share(scores: Sequence[Score]) -> float:
    """Return the share of an evaluation's samples that were lost, or under base gains in place of the controller's."""
    disturbed = sum(score.lost + score.held for score in scores)
    return float(disturbed / max(sum(score.samples for score in scores), 1))


def require_matching_filter(states: StateArray, loop_filter: LoopFilter) -> None:
    """Raise GateError if the filter reports MISMATCH in a recording: its model's prediction errors are too large.

    `states`: recorded samples, armed or disarmed. `loop_filter`: filter in its initial state.
    """
    # Any law: only the model is judged.
    compensated = LawState(Law.COMPENSATED, 0.0, 0.0, NEUTRAL_COEFFICIENTS, 0.0, 1.0)
    law = compensated if loop_filter.missing_certificate(compensated=False) else None
    follows = np.diff(states["sequence"].astype(np.int64), prepend=0) == 1
    for record, consecutive in zip(states, follows, strict=True):
        if not consecutive:
            loop_filter.reset_history()
        loop_filter.correct(Sample.from_record(record, law))
        if loop_filter.mismatch:
            raise GateError(f"{loop_filter.mismatch} in the held-out recording: see reports/diagnosis")


def _lagged_correlation(states: StateArray, frequency: float) -> float:
    """Return the largest correlation of load force and reference over lags of up to a quarter of a period."""
    force, reference = states["load_force"], states["reference_force"]
    delays = range(0, min(round(0.25 / (frequency * SAMPLE_PERIOD)), len(force) // 2), 25)
    return max(float(np.corrcoef(force[delay:], reference[: len(force) - delay])[0, 1]) for delay in delays)


def _pressure_force(states: StateArray, bench: Bench) -> FloatArray:
    force: FloatArray = bench.piston_area * (states["pressure_a"] - bench.area_ratio * states["pressure_b"])
    return force
