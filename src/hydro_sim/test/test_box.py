# SPDX-License-Identifier: Apache-2.0
"""The box on its bench: arming, faults, limits; both in one compiled loop. The rest the C box shows (test_firmware)."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hydro_bridge.safety.guard import CommandGuard, GuardSettings
from hydro_bridge.serial.protocol import CommandFrame, decode, encode_command
from hydro_core.signals import SAMPLES_PER_STEP, Command, Flag, Law, ReferenceSignal, Waveform, to_matrix
from hydro_sim.box.box import Box, BoxConfig
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)
RUN = Command(arm=True, delta_kp=75.0, delta_ki=10.0, delta_u=1e-4, reference=SINE, filter_fresh=True)
BOX = Box(Bench.nominal())
FAULTS = Flag.TRIPPED | Flag.SENSOR_FAULT | Flag.FORCE_LIMIT


class Rig:
    """A box on an analytic plant, on one clock, which a disarm was sent."""

    def __init__(self, bench: Bench, config: BoxConfig | None = None, seed: int = 1) -> None:
        self.box, self.plant = Box(bench, config), AnalyticPlant(bench)
        self.x, self.k = self.plant.reset(seed), 0

    def go(self, samples: int, command: Command, **readings: float) -> np.ndarray:
        """Run with a command every sample; `readings` overwrite x[int(name[1:])]."""
        out = []
        for _ in range(samples):
            self.box.receive(command, self.k * 1e-3)
            x = self.x.copy()
            for name, value in readings.items():
                x[int(name[1:])] = value
            out.append(self.box.tick(x, self.k * 1e-3))
            self.x = self.plant.step(float(out[-1]["valve_current"]))
            self.k += 1
        return np.array(out)

    def armed(self, seconds: float) -> Rig:
        self.go(1, Command())
        assert self.go(round(1e3 * seconds), RUN)["flags"][-1] == Flag.ARMED
        return self


def test_arming_does_not_jump(bench: Bench) -> None:
    """From a bench that stands loaded: current, reference and its rate begin where the bench is."""
    rig = Rig(bench).armed(1.25)
    rig.go(200, replace(RUN, arm=False))
    held = rig.x[2]
    assert abs(held) > 100.0
    run = rig.go(400, RUN)
    assert run["reference_force"][0] == run["load_force"][0] == held
    assert run["reference_force_rate"][0] == 0.0 and abs(run["nominal_valve_current"][0]) < 2e-4
    assert np.abs(np.diff(run["reference_force"])).max() < 8.0
    assert run["proportional_gain"][0] == 90.0


@pytest.mark.parametrize("channel", range(8))
@pytest.mark.parametrize("value", [nan, -inf, 1e12])
def test_an_impossible_measurement_trips_with_zero_current(channel: int, value: float, bench: Bench) -> None:
    rig = Rig(bench).armed(0.1)
    faulty = rig.go(1, RUN, **{f"x{channel}": value})[0]
    assert int(faulty["flags"]) & ~Flag.FORCE_LIMIT == Flag.TRIPPED | Flag.SENSOR_FAULT
    assert faulty["valve_current"] == 0.0
    later = rig.go(20, RUN)
    assert (later["flags"] & FAULTS == faulty["flags"] & FAULTS).all() and not later["valve_current"].any()
    rig.go(1, Command())
    assert rig.go(1, RUN)["flags"] == Flag.ARMED


def test_a_force_beyond_the_limit_can_be_taken_back_by_arming_anew(bench: Bench) -> None:
    """The closed valve holds the force that tripped the box: without an allowance every re-arming would trip."""
    rig = Rig(bench, BoxConfig(load_force_limit=250.0)).armed(0.1)
    tripped = rig.go(400, RUN)[-1]
    assert tripped["flags"] == Flag.TRIPPED | Flag.FORCE_LIMIT and abs(tripped["load_force"]) > 250.0
    rig.go(10, Command())
    back = rig.go(2000, replace(RUN, delta_kp=30.0, reference=replace(SINE, amplitude=100.0)))
    assert (back["flags"] & Flag.ARMED).all()
    assert np.abs(back["load_force"] - back["reference_force"])[1000:].max() < 30.0


def test_an_unstable_loop_ends_in_a_trip_and_not_in_the_end_stop(bench: Bench) -> None:
    run = Rig(bench).armed(0.1).go(4000, replace(RUN, delta_kp=235.0))
    assert run["flags"][-1] == Flag.TRIPPED | Flag.FORCE_LIMIT
    assert run["piston_position"].min() > 0.0 and run["piston_position"].max() < bench.stroke


SIZES = st.floats(0.0, 5500.0) | st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=300)
@example(Waveform.HOLD, 0.0, 0.0, 0.0, 0.0)
@example(Waveform.SINE, 1.0, 0.0, 1e-60, 0.0)
@example(Waveform.SINE, 1.0, 0.0, 1.0, 1e60)
@example(Waveform.SINE, 0.1, 4999.9, 1.0, 0.0)
@given(st.sampled_from(Waveform), SIZES, SIZES | SIZES.map(lambda size: -size), SIZES, SIZES)
def test_a_box_takes_every_reference_that_the_guard_lets_through(
    waveform: Waveform, amplitude: float, offset: float, frequency: float, phase: float
) -> None:
    """By the sim node, as it is, and by the serial line, as float32."""
    guard = CommandGuard(settings=GuardSettings(reference_force_max=5000.0, reference_frequency_max=100.0))
    taken = guard.set_reference(
        ReferenceSignal(waveform=waveform, amplitude=amplitude, offset=offset, frequency=frequency, phase=phase)
    )
    command = guard.command(0.0)
    sent = decode(encode_command(1, 0, command)[1:-1])
    assert isinstance(sent, CommandFrame)
    for each in (command, sent.command):
        BOX.reset()
        BOX.receive(each, 0.0)
        assert BOX.refused == (0, 0)
        wanted = BOX.state["reference"]["wanted"][0]
        assert (wanted["waveform"], wanted["offset"]) == (each.reference.waveform, each.reference.offset)
    assert taken or command.reference == ReferenceSignal()


@pytest.mark.parametrize(
    "numbers", [{}, {"spring_stiffness": 4e3}, {"spring_stiffness": 8e4}, {"bulk_modulus": 2e8}, {"piston_area": 1e-3}]
)
def test_the_compensated_law_closes_its_loop_alike_on_every_bench(bench: Bench, numbers: dict[str, float]) -> None:
    """Of C_1 = 0: f_l = (s + Z) / (s (m s^2 + b s) / k_s + s (1 + R) + Z) f_c with Z = K_p + K_i / s, at 1 Hz."""
    s, one = 2j * np.pi, replace(bench, **numbers)
    config, middle = BoxConfig().of_bench(one), one.spring_rest_position
    gains = config.compensated.base_kp, config.compensated.base_ki
    signal = replace(SINE, amplitude=0.05 * one.size.force)
    plan = Schedule(reference=signal, gains=gains, seconds=6.0, law=Law.COMPENSATED)
    states = simulate(AnalyticPlant(one, noise=0.0), one, plan, config=config)[2000:]
    turning = np.exp(s * states["time"])
    terms = np.column_stack((turning.real, turning.imag, np.ones(len(states)), states["time"]))
    forces = to_matrix(states, ("load_force", "reference_force"))
    followed, wanted = np.linalg.lstsq(terms, forces)[0][:2].T @ (1.0, -1j)
    volume_a = one.dead_volume_a + one.piston_area * middle
    volume_b = one.dead_volume_b + one.area_ratio * one.piston_area * (one.stroke - middle)
    oil = one.bulk_modulus * one.piston_area**2 * (1.0 / volume_a + one.area_ratio**2 / volume_b)
    inertia = s * (one.moving_mass * s**2 + one.viscous_friction * s) / one.spring_stiffness
    slope, law = 1.0 + oil / one.spring_stiffness, gains[0] + gains[1] / s
    assert followed / wanted == pytest.approx((s + law) / (inertia + s * slope + law), rel=0.02)
    assert (gains[0] / slope, gains[1] / gains[0]) == pytest.approx((21.35, 15.0 / 400.0), rel=1e-3)


def test_the_compiled_loop_gives_the_nodes_numbers_to_the_bit(bench: Bench) -> None:
    """The same run as the sim node makes it: box and plant called one after the other at each sample."""
    generator, signal = np.random.default_rng(5), ReferenceSignal(waveform=Waveform.MULTISINE, amplitude=250.0)
    gains, correction = generator.uniform((15.0, 5.0), (90.0, 15.0), (150, 2)), generator.normal(0.0, 1e-4, 2000)
    schedule = Schedule(reference=signal, gains=gains, seconds=2.0, correction=correction)
    compiled = simulate(AnalyticPlant(bench), bench, schedule, seed=3)
    assert (compiled["flags"] == Flag.ARMED).all()
    rig = Rig(bench, seed=3)
    rig.box.receive(Command(), 0.0)
    for k, record in enumerate(compiled):
        kp, ki = gains[min(k // SAMPLES_PER_STEP, 149)] - (15.0, 5.0)
        asked = Command(arm=True, delta_kp=kp, delta_ki=ki, delta_u=correction[k], reference=signal, filter_fresh=True)
        assert rig.go(1, asked)[0].item() == record.item(), k


@pytest.mark.parametrize(("law", "gains"), [(Law.PAPER, (60.0, 10.0)), (Law.COMPENSATED, (300.0, 10.0))])
def test_recorded_reference_is_played_as_it_was(bench: Bench, law: Law, gains: tuple[float, float]) -> None:
    signal = ReferenceSignal(waveform=Waveform.MULTISINE, amplitude=250.0, frequency=0.7)
    schedule = Schedule(reference=signal, gains=gains, seconds=2.0, law=law)
    run = simulate(AnalyticPlant(bench), bench, schedule, seed=3)
    recorded = np.stack([run["reference_force"], run["reference_force_rate"]], axis=1)
    again = simulate(AnalyticPlant(bench), bench, replace(schedule, reference=recorded), seed=3)
    for name in ("reference_force", "load_force", "valve_current"):
        np.testing.assert_allclose(again[name], run[name], atol=1e-9)
