# SPDX-License-Identifier: Apache-2.0
"""What the MicroLabBox runs each millisecond, written once for the sim node, the emulator and the offline loop.

::

    command ──receive──> arm, gains, correction, wanted reference            (checked and clamped here again)
    measurement ──tick──> watchdog, faults, arming, reference, force law, saturation ──> valve current, BenchState

                 arm, after a disarm was seen                    fault, or 200 ms without commands
    disarmed ────────────────────────────────> armed ──────────────────────────────────────────────> tripped
        ^  ^───────────── disarm ───────────────┘                                                      │
        └──────────────────────────────────────── disarm ──────────────────────────────────────────────┘

An arm that comes before any disarm (the box restarted under a running graph, or the link was gone for 200 ms) trips: a
person or the trainer must arm anew. Outcomes: the failure table of failures.md. Source: paper eq. fl_rl.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from hydro_bridge.serial.frames import INTEGRAL_FORMS, BoxInfo
from hydro_bridge.settings import SettingsError, check
from hydro_bridge.signals import STATE_DTYPE, Command, FloatArray, StateArray
from hydro_sim.box import kernel
from hydro_sim.model import hydraulics
from hydro_sim.model.bench import Bench

RATE_RANGE = 1e8
"""N/s, magnitude that a differentiated force can have: a load cell's full range within a tenth of a sample."""

VELOCITY_RANGE = 10.0
"""m/s, magnitude that a differentiated position can have."""

Integral = Literal["bumpless", "paper"]
"""Forms of the force law's integral (`hydro_sim.box.force_law`)."""

EMULATED_BOX = "hydro emulator"
"""What the emulator's box calls itself on the line: no person stands beside that one."""


@dataclass(frozen=True, kw_only=True)
class BoxConfig:
    """Settings of the box. The gain limits are the box's own, wider than what the guard lets a policy ask for."""

    base_kp: float = 15.0
    """K_p [1/s], [0, 500] (Table training_agent)."""
    base_ki: float = 5.0
    """K_i [1/s^2], [0, 500] (Table training_agent)."""
    delta_kp_min: float = -55.0
    """1/s, [-500, 0]."""
    delta_kp_max: float = 285.0
    """1/s, [0, 500]."""
    delta_ki_min: float = -25.0
    """1/s^2, [-500, 0]."""
    delta_ki_max: float = 95.0
    """1/s^2, [0, 500]."""
    delta_u_max: float = 0.1
    """A, magnitude of the correction, [0, 1]."""
    load_force_limit: float = 700.0
    """N, magnitude beyond which the box trips, [1, 1e5]; the nominal spring reaches the stroke's end at 800 N."""
    hold_timeout: float = 0.05
    """s without a command: base gains and no correction, [0.002, 1]."""
    trip_timeout: float = 0.2
    """s without a command: trip, [0.002, 5], not below `hold_timeout`."""
    gain_floor_share: float = 0.1
    """Smallest g that the force law believes, over g of the still bench, [0.01, 1]."""
    force_range: float = 5000.0
    """N, magnitude that a load cell can show, [1, 1e6]."""
    pressure_min: float = -0.5e6
    """Pa, lowest that a pressure sensor can show, [-1e7, 0]."""
    pressure_max: float = 25e6
    """Pa, highest that a pressure sensor can show, [1e6, 1e9]."""
    position_margin: float = 5e-3
    """m, how far outside the stroke the encoder can stand, [0, 1]."""
    feedback: Literal["load", "hydraulic"] = "load"
    """Force in the tracking error; the paper writes `hydraulic` once, its objective is `load`."""
    integral: Integral = "bumpless"
    """What the law's integrator carries: `bumpless` K_i e, so that new gains change its slope, `paper` e alone."""

    def __post_init__(self) -> None:
        check(self)
        if self.integral not in get_args(Integral):
            raise SettingsError(f"integral is {self.integral!r}, allowed are 'bumpless' and 'paper'")
        if self.feedback not in ("load", "hydraulic"):
            raise SettingsError(f"feedback is {self.feedback!r}, allowed are 'load' and 'hydraulic'")
        if self.hold_timeout > self.trip_timeout:
            raise SettingsError(f"hold_timeout {self.hold_timeout:g} s is above trip_timeout {self.trip_timeout:g} s")

    def constants(self, bench: Bench) -> npt.NDArray[np.void]:
        """What the compiled box reads: one record of `kernel.SETTINGS_DTYPE`, shape (1,)."""
        record = np.zeros(1, kernel.SETTINGS_DTYPE)
        for name in set(record.dtype.names or ()) & {entry.name for entry in fields(self)}:
            record[name] = getattr(self, name)
        record["integral_form"] = INTEGRAL_FORMS.index(self.integral)
        rest = hydraulics.rest_state(bench.constants()[0])
        still = hydraulics.input_gain(bench.constants()[0], rest[2], rest[0], rest[1], 1.0)
        record["gain_floor"] = self.gain_floor_share * still
        record["feedback_channel"] = 2 if self.feedback == "load" else 0
        force, rate = (-self.force_range, self.force_range), (-RATE_RANGE, RATE_RANGE)
        pressure = (self.pressure_min, self.pressure_max)
        position = (-self.position_margin, bench.stroke + self.position_margin)
        ranges = (force, rate, force, rate, pressure, pressure, position, (-VELOCITY_RANGE, VELOCITY_RANGE))
        record["low"], record["high"] = np.transpose(ranges)
        return record


class Box:
    """One box. Times are seconds of the box's clock, which starts anywhere and never goes back."""

    def __init__(self, bench: Bench, config: BoxConfig | None = None) -> None:
        self.config = config or BoxConfig()
        self.bench = bench.constants()
        self.settings = self.config.constants(bench)
        self.state = np.zeros(1, kernel.STATE_DTYPE)
        self._command = np.zeros(1, kernel.COMMAND_DTYPE)
        self.reset()

    def reset(self) -> None:
        """As after power-up: disarmed, no command seen, sequence 0."""
        kernel.reset(self.state)

    def receive(self, command: Command, time: float) -> None:
        """Take a command that arrived at box time [s]."""
        fill_command(self._command, command)
        kernel.receive(self.settings, self.state, self._command, time)

    def tick(self, measurement: FloatArray, time: float) -> np.void:
        """One sample at box time [s] of a measurement x, shape (8,); returns a record of `STATE_DTYPE`.

        Its `valve_current` is what to hold until the next sample; always finite and within the valve's limit.
        """
        output: StateArray = np.zeros(1, STATE_DTYPE)
        kernel.tick(self.bench, self.settings, self.state, measurement, time, output)
        sample: np.void = output[0]
        return sample

    @property
    def refused(self) -> int:
        """Values in commands that were not finite or out of range, since the reset."""
        return int(self.state["refused"][0])


def with_base_gains(kp: float, ki: float) -> BoxConfig:
    """A box with these base gains [1/s], [1/s^2] and the default's limits of the gains in all.

    Raises
    ------
    SettingsError
        They are outside of these limits.
    """
    usual = BoxConfig()
    kp_shift, ki_shift = usual.base_kp - kp, usual.base_ki - ki
    return BoxConfig(
        base_kp=kp, base_ki=ki, delta_kp_min=usual.delta_kp_min + kp_shift, delta_kp_max=usual.delta_kp_max + kp_shift,
        delta_ki_min=usual.delta_ki_min + ki_shift, delta_ki_max=usual.delta_ki_max + ki_shift,
    )  # fmt: skip


def box_info(bench: Bench, config: BoxConfig, name: str) -> BoxInfo:
    """What a box of these settings says of itself, under this name."""
    settings = {entry.name: getattr(config, entry.name) for entry in fields(BoxInfo) if hasattr(config, entry.name)}
    return BoxInfo(name=name, valve_current_max=bench.valve_current_max, **settings)


def fill_command(record: npt.NDArray[np.void], command: Command) -> None:
    """Write a command into one record of `kernel.COMMAND_DTYPE`, shape (1,)."""
    signal = command.reference
    reference = (signal.waveform, signal.amplitude, signal.offset, signal.frequency, signal.phase, 0.0)
    record[0] = (command.arm, command.filter_fresh, command.delta_kp, command.delta_ki, command.delta_u, reference)
