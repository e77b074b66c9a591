# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hydro_diagnosis.effects import CANDIDATES, LIBRARY, Claim, Effect
from hydro_diagnosis.effects.bench_values import SupplyPressure, TankPressure
from hydro_diagnosis.effects.fluid import EntrainedAir
from hydro_diagnosis.estimation.problem import CHANNELS, Problem
from hydro_diagnosis.model.segment_model import BLOCKS
from hydro_sim.model.bench import Bench

ADAPTED = [effect.adapted(Bench.nominal()) for effect in CANDIDATES]


def values_at(effect: Effect, which: str) -> dict[str, float]:
    return {one.name: one.neutral if which == "neutral" else one.probes[0] for one in effect.parameters}


def test_effect_shows_in_the_channels_it_touches_and_nowhere_else(problem: Problem, each: Callable[..., None]) -> None:
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
    weak = SupplyPressure().bench(replace(light, supply_pressure=1e7, tank_pressure=2e5), {"ratio": 0.3})
    assert TankPressure().bench(weak, {"pressure": 5e6}).tank_pressure < weak.supply_pressure
