# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from hydro_diagnosis.effects import LIBRARY, Claim, Effect
from hydro_diagnosis.effects.base import Parameter
from hydro_diagnosis.worth import worth_claiming
from hydro_sim.bench import Bench

BENCH = Bench.nominal()
ADAPTED = [effect.adapted(BENCH) for effect in LIBRARY]


def amplitudes(effect: Effect) -> list[Parameter]:
    return [one for one in effect.parameters if one.smallest > 0.0]


def claim(effect: Effect, **values: float) -> Claim:
    return Claim(effect, {**{one.name: one.probes[0] for one in effect.parameters}, **values})


def library(label: str) -> Effect:
    return next(effect for effect in ADAPTED if effect.label == label)


@pytest.mark.parametrize("effect", [e for e in ADAPTED if amplitudes(e)], ids=lambda effect: effect.label)
def test_amplitude_at_a_bound_of_physics_is_not_claimed(effect: Effect) -> None:
    for one in amplitudes(effect):
        for bound in {one.low, one.high} - {one.neutral}:
            assert not worth_claiming(claim(effect, **{one.name: bound}))


@pytest.mark.parametrize("effect", [e for e in ADAPTED if amplitudes(e)], ids=lambda effect: effect.label)
def test_difference_that_matters_to_nobody_is_not_claimed(effect: Effect) -> None:
    small = {one.name: one.neutral + 0.9 * one.smallest for one in amplitudes(effect)}
    assert not worth_claiming(claim(effect, **small))
    assert worth_claiming(claim(effect))


@pytest.mark.parametrize("label, name, present", [
    ("moving_mass", "mass", BENCH.moving_mass),
    ("friction_viscous", "coefficient", BENCH.viscous_friction),
])  # fmt: skip
def test_no_mass_and_no_friction_below_nothing_is_claimed(label: str, name: str, present: float) -> None:
    (parameter,) = library(label).parameters
    assert -present <= parameter.low < 0.0
    assert not worth_claiming(claim(library(label), **{name: parameter.low}))
    assert worth_claiming(claim(library(label), **{name: -0.5 * present}))
