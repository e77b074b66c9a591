# SPDX-License-Identifier: Apache-2.0
"""Rules of protocol.md, one a test; `AtRest` never asks the box to arm. Forces are those of a box that trips at 700 N.

Each begins behind a greeting and ends with the safe command (`command.Run.host`).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, nan, pi
from random import Random
from typing import Any

import numpy as np
import pytest
from cobs import cobs

from hydro_bridge.conformance import reference
from hydro_bridge.conformance.host import Host
from hydro_bridge.conformance.reference import columns, expect
from hydro_bridge.serial.protocol import BoxLaw, encode_frame
from hydro_core.files import bench_digest
from hydro_core.signals import SAMPLE_PERIOD, Flag, Law, ReferenceSignal, Waveform

Words = dict[str, Any]
COMPENSATED: Words = {"law": Law.COMPENSATED, "coefficients": (1.05, 0.03, 1e-3, 4.0), "velocity_compensation": 0.2}
SINE: Words = {"waveform": Waveform.SINE, "amplitude": 50.0, "frequency": 2.0}


class AtRest:
    """Rules for a disarmed box."""

    def test_framing_stream(self, host: Host) -> None:
        """STATE comes without a gap and every frame is whole."""
        host.wait(500).has(lacks=Flag.ARMED | Flag.TRIPPED).is_whole()

    def test_framing_garbage(self, host: Host) -> None:
        """A command directly behind garbage of any length is taken."""
        random = Random(1)
        for _ in range(100):
            host.once(noise=random.randbytes(random.randint(1, 500)) + b"\0", samples=3).is_whole()

    def test_framing_damaged(self, host: Host) -> None:
        """Damaged and unknown frames, and those of a version that nobody speaks, are not taken."""
        host.stream(10)
        body = host.body()
        frame = encode_frame(body)
        damaged = bytearray(cobs.decode(frame[1:-1]))
        damaged[8] ^= 0x10
        version, kind, waveform = b"\x09" + body[1:], body[:1] + b"\xc8" + body[2:], body[:34] + b"\4" + body[35:]
        whole = map(encode_frame, (version, kind, waveform, body + b"\1", body[:-4]))
        for wrong in (b"\0" + cobs.encode(damaged) + b"\0", frame[:-9] + b"\0", *whole):
            host.send_wrong(wrong)

    def test_hello_answered(self, host: Host) -> None:
        """A HELLO is answered at once, by a sequence of 1 or more, whole DETAILS, and LAW where they offer one."""
        host.greet(within=25)
        assert host.hello and host.hello[0], "the answer has sequence 0, which says power-on"
        told, offered = host.details, bool(host.details.laws >> Law.COMPENSATED & 1)
        assert told.epoch, "no DETAILS came, or their epoch is 0"
        assert 0.0 < told.hold_timeout <= told.trip_timeout, "its time-outs are not in order"
        assert offered == (host.law is not None), "LAW comes where DETAILS offer the compensated law, and only there"
        ranges = told.pressure_min < told.pressure_max and told.position_min < told.position_max
        assert ranges and told.load_force_limit > 0.0 < told.force_range, "a limit is 0, or a range is empty"

    def test_hello_fields(self, host: Host) -> None:
        """HELLO tells a name, limits in order, 1 ms, and the form of the integral."""
        info = host.info
        assert info.name and info.integral, "it does not tell its name, or the form of its integral"
        assert abs(info.sample_period - SAMPLE_PERIOD) < 1e-9, f"its sample period is {info.sample_period:g} s"
        held = info.delta_kp_min <= 0.0 <= info.delta_kp_max and info.delta_ki_min <= 0.0 <= info.delta_ki_max
        assert held, "its limits of the gains do not hold 0"
        assert info.valve_current_max > 0.0 <= info.delta_u_max, "its limits of the current are not positive"

    def test_hello_bench(self, bench: Mapping[str, Any], host: Host) -> None:
        """HELLO and DETAILS agree with the bench file."""
        limit, right = host.info.valve_current_max, bench["valve_current_max"]
        assert abs(limit / right - 1.0) < 1e-6, f"valve_current_max {limit:g} A, the file has {right:g} A"
        told, right = host.details.bench_digest, bench_digest.digest(bench)
        if not told:
            host.notes.append("its digest is not told: only valve_current_max is compared")
        assert told in ("", right), f"its bench is {told}, the file is {right}"

    def test_hello_new_conversation(self, host: Host) -> None:
        """Behind a HELLO the first command may have any sequence."""
        host.once(ahead=1000)
        host.greet()
        host.once(ahead=-900)

    def test_hello_safe(self, host: Host) -> None:
        """A HELLO puts the safe command in force, and is one heard: WATCHDOG ends."""
        host.once(samples=5, delta_kp=4.0, filter_fresh=True)
        host.greet().has(Flag.FILTER_STALE, lacks=Flag.WATCHDOG).gains(0.0, 0.0)
        host.wait(50)
        host.greet().has(lacks=Flag.WATCHDOG)

    def test_clock_pace(self, host: Host) -> None:
        """The box's clock goes by 1 ms each sample and, unless it is an emulator's, with that of the host."""
        host.wait(2000)
        times, arrived = 1e-6 * np.array([state.time_us for state in host.states]), host.arrival_times
        expect(host.states[1:], "the step of its clock [s]", SAMPLE_PERIOD, 2e-4, np.diff(times))
        pace = (times[-1] - times[0]) / (arrived[-1] - arrived[0])
        assert host.emulated or abs(pace - 1.0) <= 0.01, f"{pace:.4f} s of the box are 1 s of the host"

    def test_idle_values(self, host: Host) -> None:
        """A disarmed box has no current, and its reference rests on the force."""
        host.stream(50, delta_u=0.01, **SINE).rests()

    def test_idle_gains(self, host: Host) -> None:
        """The gains shown are base gains and changes, also without filter_fresh, which FILTER_STALE shows."""
        host.stream(20, delta_kp=3.5, delta_ki=1.25).has(Flag.FILTER_STALE).gains(3.5, 1.25)
        host.stream(20, filter_fresh=True).has(lacks=Flag.FILTER_STALE)

    @pytest.mark.parametrize(("asked", "limit"), [(1e4, "max"), (-1e4, "min")], ids=["high", "low"])
    def test_clamp(self, host: Host, asked: float, limit: str) -> None:
        """Gains beyond the box's limits are clamped to them."""
        right = (getattr(host.info, f"delta_{gain}_{limit}") for gain in ("kp", "ki"))
        host.stream(20, delta_kp=asked, delta_ki=asked).gains(*right)

    def test_clamp_not_finite(self, host: Host) -> None:
        """A gain that is not finite counts as no change."""
        host.stream(10, delta_kp=4.0, delta_ki=2.0)
        host.stream(20, delta_kp=nan, delta_ki=inf).gains(0.0, 0.0)
        host.stream(20, delta_kp=-inf, delta_ki=nan).gains(0.0, 0.0)

    @pytest.mark.parametrize("ahead", [(0,), (-1, -(2**31))], ids=["repeated", "old"])
    def test_order(self, host: Host, ahead: tuple[int, ...]) -> None:
        """A command with the sequence of the last one, or with one below it, is not taken, and is no heartbeat."""
        for number in ahead:
            host.once(ahead=1000, samples=5)
            for _ in range(4):
                step = host.send_wrong(encode_frame(host.body(number)), 20)
            step.flag_comes(Flag.WATCHDOG, 50)

    def test_order_wraps(self, host: Host) -> None:
        """Half a circle of 2^32 ahead is newer, over its end too."""
        for ahead in (2**31 - 1, 2**31 - 48, 1000):
            host.once(ahead=ahead)

    def test_watchdog_hold(self, host: Host) -> None:
        """WATCHDOG comes 50 ms behind the last command, with base gains, and ends with the next one."""
        host.once(samples=80, delta_kp=5.0).is_late()
        host.stream(20, delta_kp=6.0, filter_fresh=True).has(lacks=Flag.WATCHDOG | Flag.FILTER_STALE).gains(6.0, 0.0)

    def test_refused_counted(self, host: Host) -> None:
        """What the box refuses is counted, references by themselves; one of exactly the range of forces is not."""
        host.once(delta_kp=1e4, delta_u=nan).has_refused(2, 0)
        host.once(delta_kp=0.0, delta_u=0.0, **SINE | {"frequency": 0.0}).has_refused(1, 1)
        for name, number in (("frequency", -1.0), ("amplitude", -1.0), ("amplitude", 1e7), ("phase", nan)):
            host.once(reference=ReferenceSignal(), **SINE | {name: number}).has_refused(1, 1)
        for signal in (ReferenceSignal(waveform=Waveform.SINE, amplitude=host.details.force_range),
                       ReferenceSignal(offset=host.details.force_range), ReferenceSignal()):  # fmt: skip
            host.once(reference=signal).has_refused(0, 0)

    @pytest.mark.parametrize(("every", "times"), [(30, 1), (1, 3)], ids=["loss", "load"])
    def test_line(self, host: Host, every: int, times: int) -> None:
        """One command in 30 ms is enough, and three a sample do no harm."""
        host.stream(300, every=every, times=times, delta_kp=1.0).has(lacks=Flag.WATCHDOG).gains(1.0, 0.0).is_whole()

    def test_measured_units(self, bench: Mapping[str, Any], host: Host) -> None:
        """Pressures are in Pa, the position in m, forces in N and positive as the pressures push out."""
        states = host.stream(200).states
        now, supply, area = columns(states), bench["supply_pressure"], bench["piston_area"]
        expect(states, "pressure_a", 0.7 * supply, 0.8 * supply)
        expect(states, "pressure_b", 0.7 * supply, 0.8 * supply)
        expect(states, "piston_position", 0.5 * bench["stroke"], 0.6 * bench["stroke"])
        right = area * (now["pressure_a"] - bench["area_ratio"] * now["pressure_b"])
        expect(states, "hydraulic_force", right, 0.05 * area * supply)

    def test_measured_rates(self, host: Host) -> None:
        """Rates are differences behind a low-pass of the ages in DETAILS."""
        states, told = host.stream(300).states, host.details
        now, ages = columns(states), {"hydraulic_force": told.force_rate_age, "load_force": told.force_rate_age,
                                      "piston_position": told.velocity_age}  # fmt: skip
        if not any(ages.values()):
            pytest.skip("DETAILS do not tell the ages of the rates")
        for reading, age in ages.items():
            rate, tolerance = ("piston_velocity", 3e-5) if "position" in reading else (f"{reading}_rate", 0.5)
            memory = (age - 0.5 * SAMPLE_PERIOD) / (age + 0.5 * SAMPLE_PERIOD)
            right = memory * now[rate][:-1] + (1.0 - memory) * np.diff(now[reading]) / SAMPLE_PERIOD
            if age:
                expect(states[1:], rate, right, tolerance + 1e-3 * np.abs(right))

    def test_compensated_told(self, law: BoxLaw, host: Host) -> None:
        """LAW tells a safe state within its limits, which acts while the box is disarmed."""
        low, safe, high, rate = np.array(law.shaping_limits)
        ordered = np.all((low <= safe) & (safe <= high) & (rate > 0.0))
        assert ordered, f"{safe} is safe within {low} and {high}, by {rate} a second"
        held = law.delta_kp_min <= 0.0 <= law.delta_kp_max and law.delta_ki_min <= 0.0 <= law.delta_ki_max
        assert held, "its limits of the gains do not hold 0"
        states = host.stream(30, **COMPENSATED).confirmed
        assert all(state.law_state.law is Law.COMPENSATED for state in states), "the paper's law acts"
        force = columns(states)[host.feedback]
        for name, right in zip(("f_c", "f_c'", *reference.SHAPING[:4]), (force, 0.0, *safe), strict=False):
            expect(states, name, right, 1e-9)


class Moving:
    """Rules for an armed box: the piston moves."""

    def test_arm_arms(self, host: Host) -> None:
        """The arm bit arms a box that saw a disarm, without filter_fresh too; its reference begins at the force."""
        host.stream(50, arm=True, delta_kp=10.0).has(Flag.ARMED | Flag.FILTER_STALE).gains(10.0, 0.0)
        step = host.stream(400, delta_kp=0.0, filter_fresh=True)
        step.has(Flag.ARMED, lacks=Flag.TRIPPED | Flag.WATCHDOG | Flag.FILTER_STALE)
        reference.check_reference(host)

    def test_arm_off(self, host: Host) -> None:
        """When the arm bit falls the current is 0 at once, and so it is behind a HELLO."""
        host.stream(200, arm=True, **SINE).has(Flag.ARMED)
        host.stream(50, arm=False).rests()
        host.stream(100, arm=True).has(Flag.ARMED)
        host.wait(5)
        host.greet().rests()

    def test_arm_needs_a_disarm(self, host: Host) -> None:
        """An arm bit that comes first after 200 ms of silence trips."""
        host.wait(260)
        host.stream(30, arm=True).has(Flag.TRIPPED).rests()
        host.stream(10, arm=False).has(lacks=Flag.TRIPPED)
        host.stream(10, arm=True).has(Flag.ARMED, lacks=Flag.TRIPPED)

    def test_watchdog_trip(self, host: Host) -> None:
        """50 ms behind the last command come base gains, 200 ms behind it the box trips until it sees a disarm."""
        host.stream(400, arm=True, delta_kp=20.0, delta_u=1e-4).has(Flag.ARMED)
        step = host.wait(300)
        step.is_late()
        step.flag_comes(Flag.TRIPPED, 200)
        host.stream(20).has(Flag.TRIPPED).rests()
        host.stream(5, arm=False)
        host.stream(20, arm=True).has(Flag.ARMED, lacks=Flag.TRIPPED)

    @pytest.mark.parametrize("words", [
        [(1200, SINE | {"offset": 10.0, "phase": 0.7})],
        [(1500, SINE | {"waveform": Waveform.MULTISINE, "frequency": 0.9, "phase": 0.4})],
        [(1500, SINE | {"waveform": Waveform.SMOOTH_STEP, "frequency": 0.8, "phase": 0.3})],
        [(500, SINE), (100, {"waveform": Waveform.HOLD, "offset": 20.0}), (100, {"offset": -20.0}),
         (600, {"waveform": Waveform.SMOOTH_STEP, "offset": 5.0})],
        [(400, SINE), (50, {"amplitude": 1e7}), (50, {"amplitude": 30.0, "frequency": 2000.0}),
         (50, {"frequency": -1.0}), (400, {"frequency": 3.0, "phase": inf})],
    ], ids=["sine", "multisine", "smooth_step", "fade", "refused"])  # fmt: skip
    def test_reference(self, host: Host, words: list[tuple[int, Words]]) -> None:
        """A playable signal of the last command fades in from the force, or behind a fade; others change nothing."""
        for samples, changes in words:
            host.stream(samples, arm=True, **changes).has(Flag.ARMED)
        reference.check_reference(host)

    def test_law_current(self, host: Host) -> None:
        """The current is u_nom and for 3.5 ms the correction, clamped, and SATURATED says where."""
        host.stream(500, arm=True, delta_u=2e-4, **SINE)
        host.stream(300, delta_u=-2e-4)
        host.wait(20)
        host.stream(300, delta_u=nan).has(Flag.ARMED)
        reference.check_current(host)

    @pytest.mark.parametrize("words", [
        [(500, SINE | {"delta_kp": 30.0, "delta_ki": 10.0, "delta_u": 1e-4})],
        [(1, SINE | {"waveform": Waveform.SMOOTH_STEP, "frequency": 1.0}), (400, {"delta_ki": 30.0}),
         (200, {"delta_ki": -4.0}), (300, {"delta_ki": 60.0, "delta_kp": 40.0})],
    ], ids=["nominal", "gains"])  # fmt: skip
    def test_law(self, bench: Mapping[str, Any], host: Host, words: list[tuple[int, Words]]) -> None:
        """u_nom is that of the force law, its integral bumpless where HELLO says so, over changes of both gains."""
        for samples, changes in words:
            host.stream(samples, arm=True, **changes)
        reference.check_law(host, bench)

    def test_law_sign(self, host: Host) -> None:
        """A higher reference moves the force up, a lower one down; not judged where an overlap holds the piston."""
        host.stream(1500, arm=True, offset=60.0, delta_kp=30.0)
        now, wanted = columns(host.stream(1500, offset=-60.0).confirmed), 60.0 * host.force_scale
        fell, current = now[host.feedback][0] - now[host.feedback][-1], np.abs(now["valve_current"]).max()
        if abs(fell) < wanted and current < 0.05 * host.info.valve_current_max:
            why = "an overlap of the valve holds the piston, or the valve is not connected"
            pytest.xfail(f"the force fell by {fell:.0f} N with up to {1e3 * current:.2g} mA: {why}")
        assert fell >= wanted, f"asked for {-2.0 * wanted:g} N, the force went by {-fell:g} N"

    @pytest.mark.parametrize("words", [
        [(700, COMPENSATED | SINE | {"waveform": Waveform.MULTISINE, "offset": 40.0, "frequency": 0.9}),
         (200, {"coefficients": (1e3, 0.02, -1e3, 2.0), "velocity_compensation": -9.0}),
         (200, {"coefficients": (nan, inf, 1e-3, nan), "velocity_compensation": nan, "valve_gain_scale": nan})],
        [(600, COMPENSATED | SINE | {"valve_gain_scale": 1.1}), (100, {"law": Law.PAPER}),
         (100, {"law": Law.COMPENSATED}), (0, {}), (50, {})],
    ], ids=["shaping", "safe"])  # fmt: skip
    def test_compensated(self, law: BoxLaw, host: Host, words: list[tuple[int, Words]]) -> None:
        """Shaping goes by bounded steps to the command's within limits; late, or for another law, to the safe one."""
        for samples, changes in words:
            host.stream(samples, arm=True, delta_kp=-200.0, **changes) if samples else host.wait(150)
        reference.check_compensated(host, law)

    def test_compensated_limit(self, law: BoxLaw, host: Host) -> None:
        """Where |f_c| would be beyond its limit it is cut off there, and f_c' is 0."""
        a_1 = 0.9 * law.coefficient_max[1]
        frequency = 1.4 * law.reference_max / (2.0 * pi * a_1 * SINE["amplitude"] * host.force_scale)
        words = SINE | {"coefficients": (1.0, a_1, 0.0, 0.0), "delta_kp": law.delta_kp_min, "frequency": frequency}
        host.stream(1800, arm=True, law=Law.COMPENSATED, **words)
        reference.check_compensated(host, law)

    def test_compensated_nominal(self, bench: Mapping[str, Any], law: BoxLaw, host: Host) -> None:
        """u_nom is that of the force law with f_c, C_1 and C_2."""
        host.stream(600, arm=True, delta_kp=-200.0, valve_gain_scale=1.2, **COMPENSATED, **SINE).has(Flag.ARMED)
        reference.check_law(host, bench)
