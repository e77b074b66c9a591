# SPDX-License-Identifier: Apache-2.0
"""The simulation's effects (`model.effects`) and the diagnosis' forward simulation, written apart, say the same."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hydro_diagnosis.effects import LIBRARY, Claim, Effect
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects.catalogue import CATALOGUE, label
from tests.segments import apart, driven

BENCH = Bench.nominal()
EFFECTS = [effect.adapted(BENCH) for effect in LIBRARY]
TOLERANCE = 2e-4
"""RMS of the difference after up to 40 ms, over the signal's range."""


def claims_with(effect: Effect) -> list[Claim]:
    """The effect at its first guess, after what it needs."""
    needed = [next(one for one in EFFECTS if one.id == name) for name in effect.needs]
    return [Claim(one, {entry.name: entry.probes[0] for entry in one.parameters}) for one in (*needed, effect)]


def test_every_value_that_a_diagnosis_may_report_is_simulated() -> None:
    for effect in EFFECTS:
        entry = Claim(effect, {one.name: one.probes[0] for one in effect.parameters}).to_mapping()
        simulated = {quantity.name: quantity for quantity in CATALOGUE[label(entry)].parameters}
        for one in effect.parameters:
            assert simulated[one.name].low <= one.low and one.high <= simulated[one.name].high, effect.label


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.label)
def test_simulation_and_diagnosis_mean_the_same_effect(effect: Effect) -> None:
    claims = claims_with(effect)
    segment, states = driven(replace(BENCH, effects=tuple(claim.to_mapping() for claim in claims)))
    with_it, without = apart(segment, states, claims), apart(segment, states, claims[:-1])
    if effect.label == "backlash:play":  # the diagnosis takes its readings from the middle of the gap in each window
        assert with_it.pop("load_force") < 0.5 * without.pop("load_force")
    assert max(with_it.values()) < TOLERANCE
    assert max(without[name] / with_it[name] for name in with_it) > 20.0
