# SPDX-License-Identifier: Apache-2.0
"""The box: what the MicroLabBox runs each millisecond, shared by sim node, emulator and offline simulation.

::

    command ──receive──> arm, gains, correction, wanted reference            (checked and clamped here again)
    measurement ──tick──> watchdog, faults, arming, reference, force law, saturation ──> valve current, BenchState

                 arm, after a disarm was seen                    fault, or 200 ms without commands
    disarmed ────────────────────────────────> armed ──────────────────────────────────────────────> tripped
        ^  ^───────────── disarm ───────────────┘                                                      │
        └──────────────────────────────────────── disarm ──────────────────────────────────────────────┘

An arm that comes before any disarm (the box restarted under a running graph, or the link was gone for 200 ms) trips: a
person or the trainer must arm again. Outcomes: the failure table of failures.md. Source: paper eq. fl_rl.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, field, fields, replace
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt

from hydro_bridge.serial.protocol import INTEGRAL_FORMS, PAPER_LAW, BoxDetails, BoxInfo, BoxLaw, LawState
from hydro_bridge.settings import SettingsError, check, quantity
from hydro_bridge.signals import STATE_DTYPE, Command, FloatArray, Law, StateArray
from hydro_bridge.size import resized
from hydro_sim.box import kernel
from hydro_sim.model import equations, hydraulics
from hydro_sim.model.bench import NOMINAL, Bench
from hydro_sim.model.sensors import Sensors

_LAW_TOLD = np.dtype([(name, np.float32, kernel.LAW_DTYPE[name].shape) for name in kernel.LAW_DTYPE.names or ()])
"""The compensated law as LAW tells it: a host that keeps to the limits that it was told never exceeds them."""

RATE_RANGE = 1e6 / 3.0
"""1/s, largest differentiated force over the bench's force: a load cell's full range within a tenth of a sample."""

VELOCITY_RANGE = 125.0
"""1/s, largest differentiated position over the stroke."""

Integral = Literal["bumpless", "paper"]
"""Forms of the force law's integral (`hydro_sim.box.force_law`)."""

LAWS = 1 << Law.PAPER | 1 << Law.COMPENSATED
"""Laws of this box, as DETAILS has them."""

EMULATED_BOX = "hydro emulator"
"""Name of the emulator's box on the line: no person stands beside that one."""


@dataclass(frozen=True, kw_only=True)
class BoxConfig:
    """Settings of the box. Its gain limits are wider than what the guard allows a policy."""

    base_kp: Annotated[float, quantity("1/s", 0.0, 500.0)] = 15.0
    """K_p (Table training_agent)."""
    base_ki: Annotated[float, quantity("1/s^2", 0.0, 500.0)] = 5.0
    """K_i (Table training_agent)."""
    delta_kp_min: Annotated[float, quantity("1/s", -500.0, 0.0)] = -55.0
    """Smallest change of K_p."""
    delta_kp_max: Annotated[float, quantity("1/s", 0.0, 500.0)] = 285.0
    """Largest change of K_p."""
    delta_ki_min: Annotated[float, quantity("1/s^2", -500.0, 0.0)] = -25.0
    """Smallest change of K_i."""
    delta_ki_max: Annotated[float, quantity("1/s^2", 0.0, 500.0)] = 95.0
    """Largest change of K_i."""
    delta_u_max: Annotated[float, quantity("A", 0.0, 20.0)] = 2.0 * NOMINAL.current
    """Magnitude of the correction."""
    load_force_limit: Annotated[float, quantity("N", 1e-3, 1e8)] = NOMINAL.force * 7.0 / 3.0
    """Magnitude beyond which the box trips; the nominal spring reaches the stroke's end at 800 N."""
    recovery_margin: Annotated[float, quantity("N", 0.0, 1e8)] = NOMINAL.force / 15.0
    """Initial rise allowed to a force that is beyond its limit at arming: the cell's noise, the oil's last swing."""
    hold_timeout: Annotated[float, quantity("s", 0.002, 1.0)] = 0.05
    """Without a command, after which base gains and no correction hold."""
    trip_timeout: Annotated[float, quantity("s", 0.002, 5.0)] = 0.2
    """Without a command, after which the box trips; not below `hold_timeout`."""
    gain_floor_share: Annotated[float, quantity("-", 0.01, 1.0)] = 0.1
    """Smallest g that the force law believes, over g of the still bench."""
    force_range: Annotated[float, quantity("N", 1e-3, 1e8)] = NOMINAL.force * 50.0 / 3.0
    """Magnitude that a load cell can show."""
    pressure_min: Annotated[float, quantity("Pa", -1e7, 0.0)] = -NOMINAL.pressure / 32.0
    """Lowest that a pressure sensor can show."""
    pressure_max: Annotated[float, quantity("Pa", 1e5, 1e9)] = NOMINAL.pressure * 1.5625
    """Highest that a pressure sensor can show."""
    position_margin: Annotated[float, quantity("m", 0.0, 1.0)] = NOMINAL.length / 16.0
    """How far outside the stroke the encoder can stand."""
    feedback: Literal["load", "hydraulic"] = "load"
    """Force in the tracking error; the paper writes `hydraulic` once, its objective is `load`."""
    integral: Integral = "bumpless"
    """What the law's integrator carries: `bumpless` K_i e, so that new gains change its slope, `paper` e alone."""
    compensated: BoxLaw = field(default_factory=BoxLaw)
    """The compensated law. The gains above are the paper's."""

    def __post_init__(self) -> None:
        check(self)
        if self.hold_timeout > self.trip_timeout:
            raise SettingsError(f"hold_timeout {self.hold_timeout:g} s is above trip_timeout {self.trip_timeout:g} s")

    def of_bench(self, bench: Bench) -> BoxConfig:
        """Return these settings, which are for the nominal bench, for the box of another.

        The compensated law's gains go with 1 + R, so that its loop closes at the same rate.
        """
        gain = (1.0 + stiffness_ratio(bench)) / (1.0 + _NOMINAL_RATIO)
        law = self.compensated.enlarged(bench.size.force / NOMINAL.force, gain)
        return replace(resized(self, NOMINAL, bench.size), compensated=law)

    def constants(self, bench: Bench) -> npt.NDArray[np.void]:
        """Return the settings for the compiled box: one record of `kernel.SETTINGS_DTYPE`, shape (1,)."""
        record = np.zeros(1, kernel.SETTINGS_DTYPE)
        for name in (set(record.dtype.names or ()) & {entry.name for entry in fields(self)}) - {"compensated"}:
            record[name] = getattr(self, name)
        record["compensated"] = np.array(astuple(self.compensated), _LAW_TOLD)
        own = {entry.name: getattr(self, entry.name) for entry in fields(BoxLaw) if hasattr(self, entry.name)}
        record["paper"] = astuple(replace(PAPER_LAW, **own))
        record["integral_form"] = INTEGRAL_FORMS.index(self.integral)
        rest = hydraulics.rest_state(bench.constants()[0])
        still = hydraulics.input_gain(bench.constants()[0], rest[2], rest[0], rest[1], 1.0)
        record["gain_floor"] = self.gain_floor_share * still
        record["feedback_channel"] = 2 if self.feedback == "load" else 0
        force = float(np.float32(self.force_range))  # as DETAILS tells it: no reference within that is refused
        rate, velocity = RATE_RANGE * bench.size.force, VELOCITY_RANGE * bench.stroke
        pressure = (self.pressure_min, self.pressure_max)
        position = (-self.position_margin, bench.stroke + self.position_margin)
        loads = ((-force, force), (-rate, rate))
        ranges = (*loads, *loads, pressure, pressure, position, (-velocity, velocity))
        record["low"], record["high"] = np.transpose(ranges)
        return record


def stiffness_ratio(bench: Bench) -> float:
    """Return R [-], the oil's stiffness with the spring relaxed over the spring's: h = -R f_l'."""
    numbers = bench.constants().view(np.recarray)[0]
    position = min(max(numbers.spring_rest_position, 0.0), numbers.stroke)
    stiff = equations.stiffnesses(numbers, (numbers.bulk_modulus, numbers.bulk_modulus), position)
    return float(-equations.force_rate(numbers, stiff, (0.0, 0.0), 1.0) / numbers.spring_stiffness)


_NOMINAL_RATIO = stiffness_ratio(Bench.nominal())


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
        """Reset to power-up: disarmed, no command seen, sequence 0."""
        kernel.reset(self.state)

    def receive(self, command: Command, time: float) -> None:
        """Process a command that arrived at box time [s]."""
        fill_command(self._command, command)
        kernel.receive(self.settings, self.state, self._command, time)

    def tick(self, measurement: FloatArray, time: float) -> np.void:
        """Run one sample at box time [s] on a measurement x, shape (8,); return a record of `STATE_DTYPE`.

        Its `valve_current` is what to hold until the next sample; always finite and within the valve's limit.
        """
        output: StateArray = np.zeros(1, STATE_DTYPE)
        kernel.tick(self.bench, self.settings, self.state, measurement, time, output)
        sample: np.void = output[0]
        return sample

    @property
    def refused(self) -> tuple[int, int]:
        """Numbers of values in commands that were not finite or out of range, and of references, since the reset."""
        return int(self.state["refused"][0]), int(self.state["refused_references"][0])


def with_base_gains(kp: float, ki: float) -> BoxConfig:
    """Return a configuration with these base gains [1/s], [1/s^2] and the default limits of the total gains.

    Raises SettingsError: they are outside of these limits.
    """
    usual = BoxConfig()
    kp_shift, ki_shift = usual.base_kp - kp, usual.base_ki - ki
    return BoxConfig(
        base_kp=kp, base_ki=ki, delta_kp_min=usual.delta_kp_min + kp_shift, delta_kp_max=usual.delta_kp_max + kp_shift,
        delta_ki_min=usual.delta_ki_min + ki_shift, delta_ki_max=usual.delta_ki_max + ki_shift,
    )  # fmt: skip


def box_info(bench: Bench, config: BoxConfig, name: str) -> BoxInfo:
    """The HELLO of a box with these settings, under this name."""
    settings = {entry.name: getattr(config, entry.name) for entry in fields(BoxInfo) if hasattr(config, entry.name)}
    return BoxInfo(name=name, valve_current_max=bench.valve_current_max, **settings)


def box_details(bench: Bench, config: BoxConfig, ages: Sensors, epoch: int) -> BoxDetails:
    """The DETAILS of a box with these settings; `ages` of its rates, `epoch` of its power-on."""
    names = ("feedback", "load_force_limit", "force_range", "pressure_min", "pressure_max", "hold_timeout")
    return BoxDetails(
        epoch=epoch, bench_digest=bench.digest, laws=LAWS, trip_timeout=config.trip_timeout,
        position_min=-config.position_margin, position_max=bench.stroke + config.position_margin,
        force_rate_age=ages.force_rate_age, velocity_age=ages.velocity_age,
        **{name: getattr(config, name) for name in names},
    )  # fmt: skip


def law_state(state: np.void) -> LawState:
    """Force law as it acted in the last sample, of a record of `kernel.STATE_DTYPE`."""
    a_0, a_1, a_2, a_3 = state["acting"]["coefficients"].tolist()
    scales = float(state["acting"]["velocity_compensation"]), float(state["acting"]["valve_gain_scale"])
    reference = float(state["compensated_reference"]), float(state["compensated_reference_rate"])
    return LawState(Law(int(state["law"])), *reference, (a_0, a_1, a_2, a_3), *scales)


def fill_command(record: npt.NDArray[np.void], command: Command) -> None:
    """Write a command into one record of `kernel.COMMAND_DTYPE`, shape (1,)."""
    signal = command.reference
    reference = (signal.waveform, signal.amplitude, signal.offset, signal.frequency, signal.phase, 0.0)
    gains = (command.delta_kp, command.delta_ki, command.delta_u)
    shaping = (command.coefficients, command.velocity_compensation, command.valve_gain_scale)
    record[0] = (command.arm, command.filter_fresh, *gains, reference, command.law, shaping)
