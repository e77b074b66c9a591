# SPDX-License-Identifier: Apache-2.0
"""Sensor effects: lags, gains and biases of the five sensors, before noise.

Low-passes come first, then gains and biases in the order of the bench file: a linear lag with a gain of one may change
places with both.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hydro_sim.model.effects import lags
from hydro_sim.model.effects.base import Effect, hidden, parameter
from hydro_sim.model.equations import Symbol


class SensorLag(Effect):
    """A low-pass of second order, exact for a signal that is straight within a step."""

    id = "sensor_lag"
    options = {"sensor": ("hydraulic_force", "load_force", "pressure_a", "pressure_b")}
    bandwidth = parameter("Hz", 1.0, 2000.0, scale=100.0, neutral=2000.0)
    damping = parameter("-", 0.1, 5.0, scale=0.5, neutral=0.7071)
    signal = hidden("N or Pa", scale=10.0)
    rate = hidden("N/s or Pa/s", scale=1e3)

    def correct(self, n: Any) -> None:
        if self.sensor == "load_force":  # takes the place of the amplifier that the bench file states
            n.load_cell_bandwidth = None

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        return {"signal": signals[self.sensor]}

    def filter_signal(self, channel: str, early: Symbol, late: Symbol) -> tuple[Symbol, Symbol]:
        if channel != self.sensor:
            return early, late
        state = self.signal, self.rate
        self.next["signal"], self.next["rate"] = lags.step_linear_input(
            self.at, self.bandwidth, self.damping, state, early, late
        )
        return self.signal, self.next["signal"]

    def flow(self, signal: Symbol) -> tuple[Symbol, dict[str, Symbol]]:
        state = self.signal, self.rate
        return self.signal, {"signal": self.rate, **lags.lag_rates(self.bandwidth, self.damping, state, signal)}


class LoadCellGain(Effect):
    """A load cell's scale is wrong."""

    id = "load_cell_gain"
    options = {"cell": ("hydraulic_force", "load_force")}
    ratio = parameter("-", 0.01, 100.0, scale=0.05, neutral=1.0)

    def read_sensor(self, channel: str, signal: Symbol) -> Symbol:
        return signal * self.ratio if channel == self.cell else signal


class LoadCellBias(Effect):
    """A load cell's zero is wrong."""

    id = "load_cell_bias"
    options = {"cell": ("hydraulic_force", "load_force")}
    force = parameter("N", -1e8, 1e8, scale=5.0)

    def read_sensor(self, channel: str, signal: Symbol) -> Symbol:
        return signal + self.force if channel == self.cell else signal


class PressureSensorBias(Effect):
    """A pressure sensor's zero is wrong."""

    id = "pressure_sensor_bias"
    options = {"chamber": ("a", "b")}
    pressure = parameter("Pa", -1e7, 1e7, scale=5e4)

    def read_sensor(self, channel: str, signal: Symbol) -> Symbol:
        return signal + self.pressure if channel == f"pressure_{self.chamber}" else signal


EFFECTS = (SensorLag, LoadCellGain, LoadCellBias, PressureSensorBias)
