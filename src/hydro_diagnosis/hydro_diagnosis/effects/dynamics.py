# SPDX-License-Identifier: Apache-2.0
"""Effects with memory, over records and windows: dead time, lags, lines, bristles, play; inversion of sensor errors.

The model advances their hidden states step by step; here a whole record is filtered at once (`effects.memory`). A soft
overlap has no memory, but is computed only once for each value of a held current.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import expm
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from hydro_diagnosis.effects.base import EdgesOfLine, Effect, FloatArray, Kinematics, ParameterValues
from hydro_sim.jit import njit
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects import base as physics
from hydro_sim.model.effects import friction, motion, oil, sensing, valve

if TYPE_CHECKING:
    from hydro_diagnosis.effects.memory import Memory


class TransportDelay(Effect):
    """Dead time u(t - T) of the command, exact for a current that is held between samples."""

    stage = 0

    def command(self, spool: FloatArray, memory: Memory, values: ParameterValues) -> FloatArray:
        flat = spool.ravel()
        charge = np.concatenate([[0.0], np.cumsum(flat)])
        at = np.arange(len(charge)) - values["time"] / memory.step
        whole = np.floor(at).astype(np.int64)
        part = at - whole
        low, high = np.clip(whole, 0, len(flat)), np.clip(whole + 1, 0, len(flat))
        delayed = charge[low] * (1.0 - part) + charge[high] * part
        delayed = np.where(at < 0.0, flat[0] * at, delayed)
        return np.asarray(np.diff(delayed).reshape(spool.shape))


class ValveLag(Effect):
    """Second-order spool dynamics, discretised exactly for a held current."""

    def command(self, spool: FloatArray, memory: Memory, values: ParameterValues) -> FloatArray:
        numerator, denominator = _spool(round(values["bandwidth"], 9), round(values["damping"], 9), memory.step)
        flat, gain = spool.ravel(), numerator.sum() / denominator.sum()
        steady = np.cumsum((numerator - denominator * gain)[::-1])[::-1][1:]  # holds an input of 1 at its gain
        moved, _ = lfilter(numerator, denominator, flat, zi=steady * flat[0])
        return np.asarray(moved, dtype=np.float64).reshape(spool.shape)


@lru_cache(maxsize=256)
def _spool(bandwidth: float, damping: float, step: float) -> tuple[FloatArray, FloatArray]:
    """Discrete transfer function from the held current to the spool position averaged over the step."""
    omega = 2.0 * np.pi * bandwidth
    system = np.array([[0.0, 1.0], [-omega * omega, -2.0 * damping * omega]])
    # states: position, velocity, integral of position, input
    augmented = np.zeros((4, 4))
    augmented[:2, :2], augmented[1, 3], augmented[2, 0] = system, omega * omega, 1.0
    step_map = expm(augmented * step)
    transition, drive = step_map[:2, :2], step_map[:2, 3]
    output, feed = step_map[2, :2] / step, step_map[2, 3] / step
    trace, determinant = float(np.trace(transition)), float(np.linalg.det(transition))
    denominator = np.array([1.0, -trace, determinant])
    # output (zI - F)^-1 drive + feed, times the denominator
    adjugate = output @ (transition - trace * np.eye(2)) @ drive
    numerator = np.array([feed, output @ drive - trace * feed, adjugate + determinant * feed])
    return numerator, denominator


class SpoolLagFirstOrder(Effect):
    """First-order spool dynamics, discretised exactly for a held current."""

    def command(self, spool: FloatArray, memory: Memory, values: ParameterValues) -> FloatArray:
        decay = np.exp(-2.0 * np.pi * values["bandwidth"] * memory.step)
        mean = 1.0 - (1.0 - decay) / (2.0 * np.pi * values["bandwidth"] * memory.step)
        # mean over a substep: state before it * (1 - mean) + input * mean
        flat = spool.ravel()
        before, _ = lfilter([0.0, 1.0 - decay], [1.0, -decay], flat, zi=[flat[0]])
        return np.asarray((np.asarray(before) * (1.0 - mean) + flat * mean).reshape(spool.shape))


class Overlap(Effect):
    """Overlap (dead band) of the valve's edges, which follows the spool dynamics in the command path."""

    stage = 2


class SoftOverlap(Overlap):
    """Overlap with edges that open gradually."""

    def command(self, spool: FloatArray, memory: Memory, values: ParameterValues) -> FloatArray:
        return overlap_output(spool, values["half_width"], values["softness"])


def overlap_output(current: FloatArray, width: float, soft: float) -> FloatArray:
    """Effective current [A], of the same shape, behind an overlap of half-width `width` that opens over `soft` [A]."""
    found = np.empty(current.shape)
    _overlap_output(found.reshape(-1), np.ascontiguousarray(current).reshape(-1), width / soft, soft)
    return found


@njit
def _overlap_output(found, current, edge, soft):
    for k in range(len(found)):
        if k > 0 and current[k] == current[k - 1]:  # held over a sample's substeps
            found[k] = found[k - 1]
        else:
            ratio = current[k] / soft
            found[k] = soft * (_softplus(ratio - edge) - _softplus(-ratio - edge))


@njit
def _softplus(over):
    if over > 40.0:  # a softplus is its argument, to the last bit
        return over
    return over + math.log1p(math.exp(-over)) if over > 0.0 else math.log1p(math.exp(over))


class SupplyDroop(Effect):
    """Droop of the supply pressure with the flow drawn, after a first-order lag."""

    def supply(self, supply: FloatArray, edges: EdgesOfLine, bench: Bench, memory: Memory,
               values: ParameterValues) -> FloatArray:  # fmt: skip
        return memory.line_pressure(supply, edges, values["resistance"], values["time_constant"])


class ReturnLine(Effect):
    """Pressure of the return line with the flow, after a first-order lag: a droop of negative pressures."""

    def tank(self, tank: FloatArray, edges: EdgesOfLine, bench: Bench, memory: Memory,
             values: ParameterValues) -> FloatArray:  # fmt: skip
        out, behind_out, back, behind_back = edges
        drawn = out, -behind_out, back, -behind_back
        return -memory.line_pressure(-tank, drawn, values["resistance"], values["time_constant"])


class ReturnLineOrifice(Effect):
    """Pressure of the return line, a volume behind an orifice."""

    def tank(self, tank: FloatArray, edges: EdgesOfLine, bench: Bench, memory: Memory,
             values: ParameterValues) -> FloatArray:  # fmt: skip
        return memory.volume_pressure(edges, self._bound(values).capacity, outlet=(values["orifice"], float(tank[0])))


class SupplyPump(Effect):
    """Supply of a pump of limited flow, with its relief valve, on a volume."""

    def supply(self, supply: FloatArray, edges: EdgesOfLine, bench: Bench, memory: Memory,
               values: ParameterValues) -> FloatArray:  # fmt: skip
        capacity = self._bound(values, bench=bench).capacity
        return memory.volume_pressure(
            edges, capacity, flow=values["flow_limit"], leakage=values["leakage"], most=values["relief_pressure"]
        )


class Stribeck(Effect):
    """Stribeck friction: a rise near standstill, of which another form may fit as well."""


class StribeckExponential(Stribeck):
    """Stribeck friction of exponential form, F_s exp(-|v|/v_s) (Tustin 1947), which is never claimed."""

    def dry_level(self, level: FloatArray, motion: Kinematics, values: ParameterValues) -> FloatArray:
        return level + values["breakaway_force"] * np.exp(-np.abs(motion.velocity) / values["velocity"])


class FrictionPresliding(Effect):
    """Presliding friction: a bristle that deflects elastically before it slides (Dahl 1968)."""

    models_presliding = True

    def opposing_force(self, force: FloatArray, level: FloatArray, motion: Kinematics, memory: Memory,
                       values: ParameterValues) -> FloatArray:  # fmt: skip
        return force + memory.bristle(motion.position, values["stiffness"], level)


class Backlash(Effect):
    """Backlash (play operator) between the piston and the load's spring."""

    def load(
        self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: ParameterValues
    ) -> FloatArray:
        dragged = memory.play(motion.position, values["width"])
        return force - bench.spring_stiffness * (motion.position - dragged)


class CalibrationError(Effect):
    """Gain or bias error of a sensor, inverted exactly."""

    def invert_reading(self, channel: str, reading: FloatArray, memory: Memory, values: ParameterValues) -> FloatArray:
        zero, one = (float(self.read_sensor(channel, np.asarray(x), memory, values)) for x in (0.0, 1.0))
        return reading if (zero, one) == (0.0, 1.0) else (reading - zero) / (one - zero)


class SensorLag(Effect):
    """Second-order low-pass of a sensor's amplifier, inverted by derivatives of the smoothed reading."""

    def read_sensor(self, channel: str, signal: FloatArray, memory: Memory, values: ParameterValues) -> FloatArray:
        if channel != self.lagged_channel:
            return signal
        return memory.low_pass(signal, values["bandwidth"], values["damping"])

    def invert_reading(self, channel: str, reading: FloatArray, memory: Memory, values: ParameterValues) -> FloatArray:
        if channel != self.lagged_channel:
            return reading
        omega = 2.0 * np.pi * values["bandwidth"]
        smoothed = gaussian_filter1d(reading, 4.0, mode="nearest")  # over some 10 samples: adds less noise than it has
        slope = np.gradient(smoothed, memory.step)
        bend = np.gradient(slope, memory.step)
        return np.asarray(reading + 2.0 * values["damping"] / omega * slope + 1.0 / omega**2 * bend)


EFFECT_CLASSES: dict[type[physics.Effect], type[Effect]] = {
    valve.TransportDelay: TransportDelay,
    valve.ValveLag: ValveLag,
    valve.ValveLagFirstOrder: SpoolLagFirstOrder,
    valve.ValveDeadband: Overlap,
    valve.ValveDeadbandAsymmetric: Overlap,
    valve.ValveDeadbandSoft: SoftOverlap,
    oil.SupplyDroop: SupplyDroop,
    oil.ReturnLine: ReturnLine,
    oil.ReturnLineOrifice: ReturnLineOrifice,
    oil.SupplyPump: SupplyPump,
    friction.FrictionStribeck: Stribeck,
    friction.FrictionPresliding: FrictionPresliding,
    motion.BacklashPlay: Backlash,
    sensing.LoadCellGain: CalibrationError,
    sensing.LoadCellBias: CalibrationError,
    sensing.PressureSensorBias: CalibrationError,
    sensing.SensorLag: SensorLag,
}
"""Subclasses of `Effect`, by the effect of the model; all other effects are plain `Effect`s."""
