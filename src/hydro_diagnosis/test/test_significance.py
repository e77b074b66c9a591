# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from hydro_diagnosis.effects import LIBRARY, Claim, Effect
from hydro_diagnosis.effects.base import FitParameter
from hydro_diagnosis.selection.search import is_significant
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()
ADAPTED = [effect.adapted(BENCH) for effect in LIBRARY]


def amplitudes(effect: Effect) -> list[FitParameter]:
    return [one for one in effect.parameters if one.smallest > 0.0]


def claim(effect: Effect, **values: float) -> Claim:
    return Claim(effect, {**{one.name: one.probes[0] for one in effect.parameters}, **values})


def library(label: str) -> Effect:
    return next(effect for effect in ADAPTED if effect.label == label)


SIZED = [effect for effect in ADAPTED if amplitudes(effect)]


def test_amplitude_at_a_bound_of_physics_is_not_claimed() -> None:
    for effect in SIZED:
        for one in amplitudes(effect):
            for bound in {one.low, one.high} - {one.neutral}:
                assert not is_significant(claim(effect, **{one.name: bound})), effect.label


def test_difference_that_matters_to_nobody_is_not_claimed() -> None:
    for effect in SIZED:
        small = {one.name: one.neutral + 0.9 * one.smallest for one in amplitudes(effect)}
        assert not is_significant(claim(effect, **small)), effect.label
        assert is_significant(claim(effect)), effect.label


@pytest.mark.parametrize("label, name, present", [
    ("moving_mass", "mass", BENCH.moving_mass),
    ("friction_viscous", "coefficient", BENCH.viscous_friction),
])  # fmt: skip
def test_no_mass_and_no_friction_below_nothing_is_claimed(label: str, name: str, present: float) -> None:
    (parameter,) = library(label).parameters
    assert -present <= parameter.low < 0.0
    assert not is_significant(claim(library(label), **{name: parameter.low}))
    assert is_significant(claim(library(label), **{name: -0.5 * present}))


@pytest.mark.parametrize("effect", [e for e in ADAPTED if not amplitudes(e)], ids=lambda effect: effect.label)
def test_effect_of_shapes_alone_is_not_claimed_where_it_is_none(effect: Effect) -> None:
    """The stiffest bristles are dry friction, the quickest lag is none; seen claimed, with evidence of 1000 BIC."""
    absent = {one.name: one.neutral for one in effect.parameters}
    first = effect.parameters[0]
    assert not is_significant(claim(effect, **absent))
    assert not is_significant(claim(effect, **{**absent, first.name: 0.97 * first.neutral}))
    assert is_significant(claim(effect, **{**absent, first.name: 0.5 * first.neutral}))
