# SPDX-License-Identifier: Apache-2.0
"""The box: wrapper of the compiled C firmware (firmware/hydro), one step of the MicroLabBox each millisecond.

Sim node, emulator and offline simulation share it.

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

from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, Literal

import numpy as np

from hydro_bridge.serial.protocol import GAIN_FIELDS, INTEGRAL_FORMS, PAPER_LAW, BoxInfo, BoxLaw, LawState
from hydro_core.bench_scales import rescale
from hydro_core.settings import SettingsError, check, described, quantity
from hydro_core.signals import STATE_DTYPE, Command, FloatArray, Law, StateArray
from hydro_core.valve_overlap import valve_overlap
from hydro_sim.box import firmware
from hydro_sim.box.firmware import BENCH_FIELDS, Precision, RecordArray, signal_record
from hydro_sim.model import equations, hydraulics
from hydro_sim.model.bench import NOMINAL, Bench
from hydro_sim.model.sensors import Sensors

RATE_RANGE = 1e6 / 3.0
"""1/s, largest differentiated force over the bench's force: a load cell's full range within a tenth of a sample."""
VELOCITY_RANGE = 125.0
"""1/s, largest differentiated position over the stroke."""
Integral = Literal["bumpless", "paper"]
"""Forms of the force law's integral: int K_i e dt, or K_i int e dt."""
NAME = "hydro firmware"
"""Name of a box on the line."""
EMULATED_BOX = "hydro emulator"
"""Name of the emulator's box on the line, which `collect` may arm again without a person."""


@dataclass(frozen=True, kw_only=True)
class BoxConfig:
    """Settings of the box. Its gain limits are wider than those of the guard for a policy."""

    base_kp: Annotated[float, quantity("1/s", 0.0, 500.0, "K_p (Table training_agent)")] = 15.0
    base_ki: Annotated[float, quantity("1/s^2", 0.0, 500.0, "K_i (Table training_agent)")] = 5.0
    delta_kp_min: Annotated[float, quantity("1/s", -500.0, 0.0, "Smallest change of K_p")] = -55.0
    delta_kp_max: Annotated[float, quantity("1/s", 0.0, 500.0, "Largest change of K_p")] = 285.0
    delta_ki_min: Annotated[float, quantity("1/s^2", -500.0, 0.0, "Smallest change of K_i")] = -25.0
    delta_ki_max: Annotated[float, quantity("1/s^2", 0.0, 500.0, "Largest change of K_i")] = 95.0
    delta_u_max: Annotated[float, quantity("A", 0.0, 20.0, "Magnitude of the correction")] = 2.0 * NOMINAL.current
    load_force_limit: Annotated[
        float, quantity("N", 1e-3, 1e8, "Beyond it the box trips; the nominal spring is at its end at 800 N")
    ] = NOMINAL.force * 7.0 / 3.0
    recovery_margin: Annotated[
        float, quantity("N", 0.0, 1e8, "Rise allowed at arming to a force beyond its limit (noise, oil's swing)")
    ] = NOMINAL.force / 8.0
    hold_timeout: Annotated[
        float, quantity("s", 0.002, 1.0, "Without a command, after which base gains and no correction hold")
    ] = 0.05
    trip_timeout: Annotated[float, quantity("s", 0.002, 5.0, "Without a command, then the box trips")] = 0.2
    gain_floor_share: Annotated[float, quantity("-", 0.01, 1.0, "Smallest g of the force law, over g at rest")] = 0.1
    force_range: Annotated[float, quantity("N", 1e-3, 1e8, "Largest force reading")] = NOMINAL.force * 50.0 / 3.0
    pressure_min: Annotated[float, quantity("Pa", -1e7, 0.0, "Lowest pressure reading")] = -NOMINAL.pressure / 32.0
    pressure_max: Annotated[float, quantity("Pa", 1e5, 1e9, "Highest pressure reading")] = NOMINAL.pressure * 1.5625
    position_margin: Annotated[float, quantity("m", 0.0, 1.0, "Readings outside the stroke")] = NOMINAL.length / 16.0
    feedback: Annotated[
        Literal["load", "hydraulic"], described("Force in the tracking error; the paper's objective is `load`")
    ] = "load"
    integral: Annotated[
        Integral, described("`bumpless` integrates K_i e, so that new gains change its slope; `paper` e alone")
    ] = "bumpless"
    compensated: BoxLaw = field(default_factory=BoxLaw)
    """The compensated law. The gains above are the paper's."""

    def __post_init__(self) -> None:
        check(self)
        if self.hold_timeout > self.trip_timeout:
            raise SettingsError(f"hold_timeout {self.hold_timeout:g} s is above trip_timeout {self.trip_timeout:g} s")

    def of_bench(self, bench: Bench) -> BoxConfig:
        """Return these settings of the nominal bench's box, scaled to another bench.

        The compensated law's gains go with 1 + R, so that its loop closes at the same rate.
        """
        gain = (1.0 + stiffness_ratio(bench)) / (1.0 + _NOMINAL_RATIO)
        law = self.compensated.scaled(bench.size.force / NOMINAL.force, gain)
        return replace(rescale(self, NOMINAL, bench.size), compensated=law)

    def constants(
        self, bench: Bench, sensors: Sensors | None = None, name: str = NAME, precision: Precision = "double"
    ) -> RecordArray:
        """Return the firmware's configuration hydro_config: one record, shape (1,).

        `bench`: bench that the force law assumes. `sensors`: ages of its rates; absent: the defaults. `name`: name of
        the box on the line. `precision`: of the floating-point numbers.
        """
        kinds, believed, ages = firmware.STRUCTURES[precision], bench.constants()[0], sensors or Sensors()
        gains = {entry: getattr(self, entry) for entry in GAIN_FIELDS}
        # HELLO, DETAILS and LAW report limits as float32: rounded here, too, so that a host within them exceeds none
        compensated = np.array(_law(self.compensated), firmware.SINGLE_STRUCTURES.law)
        force = float(np.float32(self.force_range))
        pressure_a, pressure_b, middle, *_ = hydraulics.rest_state(believed)
        forces = ((-force, force), (-RATE_RANGE * bench.size.force, RATE_RANGE * bench.size.force))
        pressure = (self.pressure_min, self.pressure_max)
        position = (-self.position_margin, bench.stroke + self.position_margin)
        velocity = VELOCITY_RANGE * bench.stroke
        low, high = np.transpose((*forces, *forces, pressure, pressure, position, (-velocity, velocity)))
        numbers: dict[str, Any] = {
            "delta_u_max": self.delta_u_max, "load_force_limit": self.load_force_limit,
            "gain_floor": self.gain_floor_share * hydraulics.input_gain(believed, middle, pressure_a, pressure_b, 1.0),
            "force_range": force, "recovery_margin": self.recovery_margin, "low": low, "high": high,
            "force_rate_age": ages.force_rate_age, "velocity_age": ages.velocity_age,
            "hold_timeout": self.hold_timeout, "trip_timeout": self.trip_timeout,
            "feedback": 2 if self.feedback == "load" else 0, "integral_form": INTEGRAL_FORMS.index(self.integral),
            "name": np.frombuffer(name.encode()[:32].ljust(32, b"\0"), np.uint8),
            "digest": np.frombuffer(bench.digest.encode()[:12].ljust(12, b"\0"), np.uint8),
        }  # fmt: skip
        record = np.zeros(1, kinds.config)
        record["bench"] = believed_numbers(bench)
        record["laws"][0, Law.PAPER] = np.array(_law(replace(PAPER_LAW, **gains)), kinds.law)
        record["laws"][0, Law.COMPENSATED] = compensated
        for entry, number in numbers.items():
            record[entry] = number
        return record


def believed_numbers(bench: Bench) -> tuple[float, ...]:
    """Return the numbers of hydro_bench, those of `BENCH_FIELDS`, of the bench that a force law assumes."""
    numbers, overlap = bench.constants()[0], valve_overlap(bench.effects)
    leapt = overlap["closing"], overlap["back"], overlap["out"]
    return (*(float(numbers[name]) for name in BENCH_FIELDS[: -len(leapt)]), *leapt)


def _law(law: BoxLaw) -> tuple[Any, ...]:
    low, safe, high, rate = map(tuple, law.shaping_limits)
    return (*(getattr(law, name) for name in GAIN_FIELDS), law.reference_max, safe, low, high, rate)


def stiffness_ratio(bench: Bench) -> float:
    """Return R [-], the ratio of the oil's to the spring's stiffness at rest: h = -R f_l'."""
    numbers = bench.constants().view(np.recarray)[0]
    position = min(max(numbers.spring_rest_position, 0.0), numbers.stroke)
    stiff = equations.stiffnesses(numbers, (numbers.bulk_modulus, numbers.bulk_modulus), position)
    return float(-equations.force_rate(numbers, stiff, (0.0, 0.0), 1.0) / numbers.spring_stiffness)


_NOMINAL_RATIO = stiffness_ratio(Bench.nominal())


class Box:
    """One box: the C firmware with its memory. Times are seconds of the box's clock, which is monotonic.

    `bench`, `config`, `sensors`: bench that its force law assumes, its settings, and the filters of its rates. `name`,
    `epoch`: name in HELLO, and number of the power-on. `precision`: of the floating-point numbers.

    Raises SettingsError: the firmware is not built.
    """

    def __init__(
        self, bench: Bench, config: BoxConfig | None = None, sensors: Sensors | None = None, *, name: str = NAME,
        epoch: int = 1, precision: Precision = "double",
    ) -> None:  # fmt: skip
        self.config, self.precision, self.epoch = config or BoxConfig(), precision, epoch
        kinds = firmware.STRUCTURES[precision]
        self.settings = self.config.constants(bench, sensors, name, precision)
        """hydro_config, shape (1,)."""
        self.state = np.zeros(1, kinds.box)
        """hydro_box, shape (1,)."""
        self._command = np.zeros(1, kinds.command)
        self.reset(epoch)

    def reset(self, epoch: int | None = None) -> None:
        """Restart the box, as the next epoch unless one is given: disarmed, without command, sequence 0."""
        self.epoch = self.epoch % 0xFFFFFFFF + 1 if epoch is None else epoch
        self._call("power_on", self.state, self.settings, self.epoch)

    def receive(self, command: Command, time: float) -> None:
        """Receive a command at box time [s] without the serial line and its rounding to float32."""
        fill_command(self._command, command)
        self._call("receive", self.state, self.settings, self._command, time)

    def feed(self, data: bytes) -> None:
        """Feed bytes received over the line; the next `tick` uses the newest command."""
        self._call("bytes", self.state, data, len(data))

    def tick(self, measurement: FloatArray, time: float) -> np.void:
        """Run one sample at box time [s] on a measurement x, shape (8,); return a record of `STATE_DTYPE`.

        Its `valve_current` is to be held until the next sample; it is always finite and within the valve's limit.
        """
        output: StateArray = np.zeros(1, STATE_DTYPE)
        self._call("tick", self.state, self.settings, np.ascontiguousarray(measurement, np.float64), time, output)
        sample: np.void = output[0]
        return sample

    def frames(self) -> bytes:
        """Return the frames to send after a `tick`, as bytes."""
        out = np.empty(firmware.BURST_MAX, np.uint8)
        return out[: self._call("frames", self.state, self.settings, out)].tobytes()

    @property
    def refused(self) -> tuple[int, int]:
        """Numbers of values and of references in commands that were refused since the reset."""
        values, references = self.state["guard"]["refused"][0].tolist()
        return values, references

    def _call(self, name: str, *arguments: Any) -> Any:
        given = (firmware.address_of(one) if isinstance(one, np.ndarray) else one for one in arguments)
        return getattr(firmware.library(self.precision), f"hydro_c_{name}")(*given)


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
    """Return the HELLO of a box with these settings."""
    settings = {entry.name: getattr(config, entry.name) for entry in fields(BoxInfo) if hasattr(config, entry.name)}
    return BoxInfo(name=name, valve_current_max=bench.valve_current_max, **settings)


def law_state(state: np.void) -> LawState:
    """Return the force law's state in the last sample from a record of hydro_box."""
    acting = state["acting"]
    a_0, a_1, a_2, a_3, a_4, c_1, c_2 = acting["shaping"].tolist()
    followed = float(acting["reference"]), float(acting["reference_rate"])
    return LawState(Law(int(acting["law"])), *followed, (a_0, a_1, a_2, a_3, a_4), c_1, c_2)


def fill_command(record: RecordArray, command: Command) -> None:
    """Write a command into one record of hydro_command, shape (1,)."""
    reference = signal_record(command.reference)
    gains = (command.delta_kp, command.delta_ki, command.delta_u)
    shaping = (*command.coefficients, command.velocity_compensation, command.valve_gain_scale)
    flags = command.arm, command.filter_fresh, 0
    record[0] = (0, command.corrected_sequence, *flags, *gains, reference, command.law, shaping)
