# SPDX-License-Identifier: Apache-2.0
"""Sensor effects: lags, gains and biases of the five sensors, before noise.

Low-passes come first, then gains and biases in the order of the bench file: a linear lag with unit gain commutes
with both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from hydro_sim.model.effects import lags
from hydro_sim.model.effects.base import Effect, FitParameter, fit, hidden, parameter
from hydro_sim.model.equations import Symbol

SENSORS = {
    "hydraulic_force": "the load cell at the piston rod",
    "load_force": "the load cell at the spring",
    "pressure_a": "the pressure sensor of chamber A",
    "pressure_b": "the pressure sensor of chamber B",
}
"""Sensors in words, by channel."""


class Sensor(Effect):
    """Error of one sensor."""

    equations = ("sensor",)

    def __init__(self, **chosen: str) -> None:
        super().__init__(**chosen)
        self.channel = chosen.get("sensor") or chosen.get("cell") or f"pressure_{chosen['chamber']}"
        self.words = SENSORS[self.channel]


class SensorLag(Sensor):
    """Second-order low-pass of a sensor's amplifier, exact for a signal that is linear within a step.

    For the load cell it replaces the amplifier of the bench file. For a pressure sensor bandwidth and damping trade
    off: only 2 D/w is well determined.
    """

    id = "sensor_lag"
    options = {"sensor": ("hydraulic_force", "load_force", "pressure_a", "pressure_b")}
    sentence_template = "The amplifier of {effect.words} is a low-pass near {bandwidth:.3g} Hz."
    bandwidth = parameter("Hz", 1.0, 2000.0, scale=100.0, neutral=2000.0,
                          fit=fit(15.0, 40.0, 120.0, low=2.0, high=400.0, neutral=400.0, systematic=0.01))  # fmt: skip
    damping = parameter("-", 0.1, 5.0, scale=0.5, neutral=0.7071, fit=fit(0.7071, low=0.3, high=1.5, reported=False))
    signal = hidden("N or Pa", scale=10.0)
    rate = hidden("N/s or Pa/s", scale=1e3)

    def fitted_parameters(self, bench: Any) -> tuple[FitParameter, ...]:
        bandwidth, damping = super().fitted_parameters(bench)
        return replace(bandwidth, systematic=0.03 if self.channel.startswith("pressure") else 0.01), damping

    def correct(self, n: Any) -> None:
        if self.sensor == "load_force":  # takes the place of the amplifier that the bench file states
            n.load_cell_bandwidth = None

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        return {"signal": signals[self.sensor]}

    def filter_signal(self, channel: str, early: Symbol, late: Symbol) -> tuple[Symbol, Symbol]:
        if channel != self.sensor:
            return early, late
        state = self.signal, self.rate
        self.next["signal"], self.next["rate"] = lags.step_first_order_hold(
            self.at, self.bandwidth, self.damping, state, early, late
        )
        return self.signal, self.next["signal"]

    def continuous_rates(self, signal: Symbol) -> tuple[Symbol, dict[str, Symbol]]:
        state = self.signal, self.rate
        return self.signal, {"signal": self.rate, **lags.lag_rates(self.bandwidth, self.damping, state, signal)}


class LoadCellGain(Sensor):
    """Gain error of a load cell."""

    id = "load_cell_gain"
    options = {"cell": ("hydraulic_force", "load_force")}
    sentence_template = "{effect.words} reads {ratio:.4g} times the true force."
    ratio = parameter(
        "-", 0.01, 100.0, scale=0.05, neutral=1.0, fit=fit(0.95, smallest_reported=0.002, low=0.2, high=5.0)
    )

    def read_sensor(self, channel: str, signal: Symbol) -> Symbol:
        return signal * self.ratio if channel == self.channel else signal


class _Bias(Sensor):
    def read_sensor(self, channel: str, signal: Symbol) -> Symbol:
        return signal + getattr(self, self.parameters[0].name) if channel == self.channel else signal


class LoadCellBias(_Bias):
    """Zero offset of a load cell."""

    id = "load_cell_bias"
    options = {"cell": ("hydraulic_force", "load_force")}
    sentence_template = "A reading of {effect.words} is off by {force:.3g} N."
    force = parameter("N", -1e8, 1e8, scale=5.0, fit=fit(5.0, smallest_reported=0.3, low=-5e3, high=5e3))


class PressureSensorBias(_Bias):
    """Zero offset of a chamber's pressure sensor."""

    id = "pressure_sensor_bias"
    options = {"chamber": ("a", "b")}
    sentence_template = "A reading of {effect.words} is off by {pressure:.4g} kPa."
    pressure = parameter("Pa", -1e7, 1e7, scale=5e4, fit=fit(5e4, smallest_reported=2.5e3, low=-3e6, high=3e6))


EFFECTS = (SensorLag, LoadCellGain, LoadCellBias, PressureSensorBias)
