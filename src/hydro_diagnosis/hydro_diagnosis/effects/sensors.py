# SPDX-License-Identifier: Apache-2.0
"""Sensor effects: gain, bias, lag."""

from __future__ import annotations

import numpy as np

from hydro_diagnosis.effects.base import (
    HYDRAULIC,
    LOAD,
    MOTION,
    PRESSURE,
    Effect,
    FitParameter,
    FloatArray,
    Values,
    changed,
)
from hydro_diagnosis.effects.memory import Memory
from hydro_sim.model.bench import Bench

TOUCHES = {
    "hydraulic_force": frozenset({MOTION, HYDRAULIC}),
    "load_force": frozenset({LOAD}),
    "pressure_a": frozenset({PRESSURE, HYDRAULIC}),
    "pressure_b": frozenset({PRESSURE, HYDRAULIC}),
    "piston_position": frozenset({PRESSURE, MOTION, LOAD}),
}
"""Blocks of residuals in which a sensor shows, by its channel."""
_WORDS = {
    "hydraulic_force": "the load cell at the piston rod",
    "load_force": "the load cell at the spring",
    "pressure_a": "the pressure sensor of chamber A",
    "pressure_b": "the pressure sensor of chamber B",
}


class _Sensor(Effect):
    equations = ("sensor",)

    @property
    def channel(self) -> str:
        """The BenchState field that this sensor fills."""
        chamber = self.options.get("chamber")
        return self.options.get("sensor", self.options.get("cell", f"pressure_{chamber}"))

    @property
    def blocks(self) -> frozenset[str]:  # type: ignore[override]
        return TOUCHES[self.channel]

    @property
    def words(self) -> str:
        """The sensor in words."""
        return _WORDS[self.channel]


class LoadCellGain(_Sensor):
    """Reading = ratio times force."""

    id = "load_cell_gain"
    says = "{effect.words} reads {ratio:.4g} times the true force."
    parameters = (FitParameter(name="ratio", unit="-", low=0.2, high=5.0, neutral=1.0, probes=(0.95,), smallest=0.002),)

    def measure(self, channel: str, signal: FloatArray, memory: Memory, values: Values) -> FloatArray:
        return signal * values["ratio"] if channel == self.channel else signal

    def unmeasure(self, channel: str, reading: FloatArray, memory: Memory, values: Values) -> FloatArray:
        return reading / values["ratio"] if channel == self.channel else reading


class _Bias(_Sensor):
    def measure(self, channel: str, signal: FloatArray, memory: Memory, values: Values) -> FloatArray:
        return signal + values[self.parameters[0].name] if channel == self.channel else signal

    def unmeasure(self, channel: str, reading: FloatArray, memory: Memory, values: Values) -> FloatArray:
        return reading - values[self.parameters[0].name] if channel == self.channel else reading


class LoadCellBias(_Bias):
    """Reading = force + bias."""

    id = "load_cell_bias"
    says = "A reading of {effect.words} is off by {force:.3g} N."
    parameters = (FitParameter(name="force", unit="N", low=-5e3, high=5e3, probes=(5.0,), smallest=0.3),)


class PressureSensorBias(_Bias):
    """Reading = pressure + bias."""

    id = "pressure_sensor_bias"
    says = "A reading of {effect.words} is off by {pressure:.4g} kPa."
    parameters = (FitParameter(name="pressure", unit="Pa", low=-3e6, high=3e6, probes=(5e4,), smallest=2.5e3),)


class SensorLag(_Sensor):
    """Second-order low-pass in a sensor's amplifier; at the load it replaces the one that the bench file states."""

    id = "sensor_lag"
    says = "The amplifier of {effect.words} is a low-pass near {bandwidth:.3g} Hz."

    @property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        """Parameters; for a pressure sensor, bandwidth and damping trade off: only 2 D/w is known better."""
        share = 0.03 if self.channel.startswith("pressure") else 0.01
        return (
            FitParameter(name="bandwidth", unit="Hz", low=2.0, high=400.0, neutral=400.0, probes=(15.0, 40.0, 120.0),
                      systematic=share),
            FitParameter(name="damping", unit="-", low=0.3, high=1.5, neutral=0.7071, probes=(0.7071,), reported=False),
        )  # fmt: skip

    @property
    def lagged(self) -> str:  # type: ignore[override]
        return self.channel

    def bench(self, bench: Bench, values: Values) -> Bench:
        return changed(bench, load_cell_bandwidth=None) if self.channel == "load_force" else bench

    def measure(self, channel: str, signal: FloatArray, memory: Memory, values: Values) -> FloatArray:
        if channel != self.channel:
            return signal
        return memory.low_pass(channel, signal, values["bandwidth"], values["damping"])

    def unmeasure(self, channel: str, reading: FloatArray, memory: Memory, values: Values) -> FloatArray:
        if channel != self.channel:
            return reading
        omega = 2.0 * np.pi * values["bandwidth"]
        return memory.lead(reading, 2.0 * values["damping"] / omega, 1.0 / omega**2)


_CELLS = ("hydraulic_force", "load_force")
EFFECTS: tuple[Effect, ...] = (
    *(LoadCellGain({"cell": cell}) for cell in _CELLS),
    *(LoadCellBias({"cell": cell}) for cell in _CELLS),
    *(PressureSensorBias({"chamber": chamber}) for chamber in "ab"),
    *(SensorLag({"sensor": sensor}) for sensor in (*_CELLS, "pressure_a", "pressure_b")),
)
