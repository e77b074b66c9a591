# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_diagnosis.effects import CANDIDATES, LIBRARY, Claim, Effect
from hydro_diagnosis.effects.bench_values import TankPressure
from hydro_diagnosis.effects.fluid import EntrainedAir
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.intervals import intervals
from hydro_diagnosis.estimation.problem import CHANNELS, Problem
from hydro_diagnosis.model.segment_model import BLOCKS, SegmentModel
from hydro_diagnosis.model.simulation import Plant
from hydro_diagnosis.preprocessing.smoothing import TOTAL_WIDTH, finish
from hydro_diagnosis.recording import Segment
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation import Segment as Drive
from hydro_sim.model.bench import Bench
from tests.checks import each
from tests.segments import problem_in

ADAPTED = [effect.adapted(Bench.nominal()) for effect in CANDIDATES]


def values_at(effect: Effect, which: str) -> dict[str, float]:
    return {one.name: one.neutral if which == "neutral" else one.probes[0] for one in effect.parameters}


def test_effect_shows_in_the_channels_it_touches_and_nowhere_else(problem: Problem) -> None:
    nothing = problem.residual([])

    def check(effect: Effect) -> None:
        change = problem.residual([Claim(effect, values_at(effect, "probe"))]) - nothing
        power = np.bincount(problem.layout.channel, np.square(change), len(CHANNELS))
        shown = {CHANNELS[k] for k in np.flatnonzero(power > 1e-9 * power.max())}
        may = {name for block in effect.blocks for name in BLOCKS[block]} | {"motion"}  # forces reach the motion
        assert shown
        assert shown <= may

    each([effect for effect in ADAPTED if not effect.needs], check, lambda effect: effect.label)


def test_effect_vanishes_at_its_neutral_value(problem: Problem) -> None:
    nothing = problem.residual([])
    for effect in ADAPTED:
        if effect.parameters[0].smallest > 0.0 and not effect.needs and "soft" not in effect.label:
            change = problem.residual([Claim(effect, values_at(effect, "neutral"))]) - nothing
            assert np.max(np.abs(change)) < 1e-6, effect.label


def test_air_in_rigid_oil_is_a_polytropic_gas() -> None:
    pressure = np.array([2e5, 1e6, 1e7])
    share, absolute = 0.01, pressure + 101325.0
    gas = share * (101325.0 / absolute) ** (1.0 / 1.4)
    soft = EntrainedAir().stiffness(np.full(3, 1e15), pressure, {"volume_fraction": share})
    assert np.allclose(soft, 1.4 * absolute * (1.0 - share + gas) / gas, rtol=1e-4)


def test_effects_stay_within_what_a_bench_allows() -> None:
    light = replace(Bench.nominal(), spring_stiffness=1.0, viscous_friction=0.0, moving_mass=0.01, area_ratio=1.0)
    for effect in (one.adapted(light) for one in LIBRARY):
        for bound in ("low", "high"):
            effect.bench(light, {one.name: getattr(one, bound) for one in effect.parameters})
    weak = claim("supply_pressure").effect.bench(replace(light, supply_pressure=1e7, tank_pressure=2e5), {"ratio": 0.3})
    assert TankPressure().bench(weak, {"pressure": 5e6}).tank_pressure < weak.supply_pressure


BENCH = Bench.nominal()
STEP = 1e-3
FORCE = 10.0


def claim(label: str, **values: float) -> Claim:
    return Claim(next(one for one in LIBRARY if one.label == label), values)


def pushed(force: float) -> SegmentModel:
    """A bench at the spring's rest with its valve shut, and more force on the piston than the spring takes."""
    p_b = 8e6
    p_a = BENCH.area_ratio * p_b + force / BENCH.piston_area
    values = {"valve_current": 0.0, "piston_position": BENCH.spring_rest_position, "pressure_a": p_a, "pressure_b": p_b}
    channels = {name: np.full(400, value) for name, value in values.items()}
    return SegmentModel(Segment("pushed", 0.0, STEP, channels), BENCH)


@pytest.mark.parametrize(
    ("label", "values", "moves"),
    [
        ("friction_coulomb", {"force": 11.0}, False),
        ("friction_coulomb", {"force": 9.0}, True),
        ("friction_coulomb:directional", {"force_positive": 11.0, "force_negative": 1.0}, False),
        ("friction_coulomb:directional", {"force_positive": 9.0, "force_negative": 99.0}, True),
        ("friction_stribeck", {"breakaway_force": 11.0, "velocity": 0.01}, False),
    ],
)
def test_piston_sticks_exactly_as_far_as_friction_reaches(label: str, values: dict[str, float], moves: bool) -> None:
    plant = Plant.of(pushed(FORCE), [claim(label, **values)])
    begins = np.array([50])
    travel = np.abs(plant.run(plant.start(begins), begins, 100)[:, 0, 0] - BENCH.spring_rest_position).max()
    assert (travel > 1e-7) == moves
    if not moves:
        assert travel < 1e-12


def test_sliding_piston_is_stopped_and_stays() -> None:
    plant = Plant.of(pushed(0.0), [claim("friction_coulomb", force=40.0)])
    begins = np.array([50])
    state = plant.start(begins)
    state[1] = 0.02
    states = plant.run(state, begins, 100)
    assert states[-1, 1, 0] == 0.0
    assert states[-1, 0, 0] == states[-40, 0, 0] > BENCH.spring_rest_position


def test_friction_is_averaged_over_the_velocities_within_the_test_function() -> None:
    """Breaking loose at 5 m/s^2, a Stribeck rise is passed in some milliseconds."""
    acceleration, strength, width = 5.0, 6.0, 0.012
    time = (np.arange(400) - 200.0) * STEP
    channels = {"piston_position": 0.04 + 0.5 * acceleration * time**2}
    model = SegmentModel(Segment("loose", 0.0, STEP, channels), BENCH)
    got = finish(model.dry_friction([claim("friction_stribeck", breakaway_force=strength, velocity=width)]))

    fine = np.linspace(-8.0, 8.0, 4001)
    bell = np.exp(-0.5 * (fine / TOTAL_WIDTH) ** 2)
    velocity = acceleration * (time[:, None] + fine * STEP)
    true = (strength * np.sign(velocity) * np.exp(-((velocity / width) ** 2))) @ bell / bell.sum()
    np.testing.assert_allclose(got[50:350], true[50:350], atol=0.06 * strength)
    assert np.abs(got - true)[204:212].max() < 0.03 * strength  # where it is told from Coulomb friction


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_intervals_of_a_stribeck_rise_hold_whatever_its_exponent(exponent: float) -> None:
    """The form that is claimed is 2, and what fits as well may be 1 (Tustin 1947)."""
    sizes = {"breakaway_force": 10.0, "velocity": 0.03}
    effects = {"friction_coulomb": {"force": 10.0}, "friction_stribeck": {**sizes, "exponent": exponent}}
    drive = Drive(seconds=20, waveform="multisine", amplitude=260, frequency=0.7, kp=60, ki=10)
    states = record_offline(truth_from_mapping({"profile": "nominal", "effects": effects}), [drive], seed=3).states
    problem, claims = problem_in(states), (claim("friction_coulomb", force=10.0), claim("friction_stribeck", **sizes))
    for _ in range(3):
        problem = problem.weighed(claims)
        found = fit(problem, claims)
        claims = found.claims
    for bound, true in zip(intervals(problem, found), (10.0, *sizes.values()), strict=True):
        assert bound.low <= true <= bound.high
