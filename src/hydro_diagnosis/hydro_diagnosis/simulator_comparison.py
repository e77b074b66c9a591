# SPDX-License-Identifier: Apache-2.0
"""Comparison of a bench with its simulator: two diagnoses against the same bench file, by effect and parameter.

An effect of both differs if the 95 % interval of a parameter's difference, with the two half-widths added in
quadrature, excludes 0. An effect of one side only is a difference as well, unless it and an effect of the other side
only are rivals that explain the recordings equally well.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydro_diagnosis.effects.base import display_unit
from hydro_diagnosis.report_json import (
    BenchParameterEstimate,
    Difference,
    EffectReport,
    ParameterDifference,
    ParameterEstimate,
    Report,
)


def compare_reports(bench: Report, simulator: Report) -> Report:
    """Return the bench's report, with differences from the simulator's and a note on the simulator's verdict."""
    note = f"the simulator's recordings against the same bench file: {simulator.verdict}"
    open_ = {"bench": bench, "simulator": simulator}
    doubtful = [name for name, one in open_.items() if one.verdict in ("unknown", "partly_explained")]
    if doubtful:
        note += f"; not all is explained on the {' and in the '.join(doubtful)}"
    alike = [
        f"{cause.id} on the bench and {two.id} in the simulator are not compared: either explains these recordings"
        for cause, two in indistinct(bench.effects, simulator.effects)
    ]
    if unnamed := [name for name, one in open_.items() if one.closures]:
        alike.append(f"terms without a name were found on the {' and in the '.join(unnamed)}: they are not compared")
    estimates = {one.name: one for one in simulator.estimated}
    for one in bench.estimated:
        if (number := _number(one, estimates.get(one.name))).is_significant and number.simulated is not None:
            unit, factor = display_unit(one.unit)
            alike.append(
                f"{one.name} is estimated as {factor * one.value:.5g} {unit} from the bench's recordings and "
                f"{factor * number.simulated:.5g} {unit} from the simulator's"
            )
    return replace(
        bench,
        simulated=differences(bench.effects, simulator.effects),
        data_quality=[*bench.data_quality, note, *alike, *(f"simulator: {one}" for one in simulator.data_quality)],
        seconds=bench.seconds + simulator.seconds,
    )


def differences(real: Sequence[EffectReport], simulated: Sequence[EffectReport]) -> list[Difference]:
    """Effects that differ: of the bench only, of both, of the simulator only; `indistinct` ones are omitted."""
    own, other = _by_place(real, simulated), _by_place(simulated, real)
    same = [effect for pair in indistinct(real, simulated) for effect in pair]
    found = []
    for place, effect in (other | own).items():
        if any(effect is one for one in same):
            continue
        one, two = (side[place].parameters if place in side else {} for side in (own, other))
        numbers = {name: _number(one.get(name), two.get(name)) for name in one | two}
        only_in = "real" if not two else "simulated" if not one else None
        if any(number.is_significant for number in numbers.values()):
            place_of = {"id": effect.id, "equation": effect.equation, "options": effect.options}
            found.append(Difference(**place_of, parameters=numbers, only_in=only_in))  # type: ignore[arg-type]
    return sorted(found, key=lambda difference: difference.only_in or "s")  # real, both, simulated


def indistinct(
    real: Sequence[EffectReport], simulated: Sequence[EffectReport]
) -> list[tuple[EffectReport, EffectReport]]:
    """Pairs of a bench-only and a simulator-only effect, one of which is a rival of the other that fits as well."""

    def rivals(effect: EffectReport) -> set[str]:
        return {rival.id for rival in effect.rivals if not rival.distinguishable}

    own, other = _by_place(real, simulated), _by_place(simulated, real)
    alone = [effect for place, effect in own.items() if place not in other]
    beside = [effect for place, effect in other.items() if place not in own]
    return [(one, two) for one in alone for two in beside if two.id in rivals(one) or one.id in rivals(two)]


def _by_place(effects: Sequence[EffectReport], others: Sequence[EffectReport]) -> dict[tuple[str, ...], EffectReport]:
    """Effects by id and chamber, cell or sensor. Two forms are one cause, unless one of the two sides has both."""

    def place(effect: EffectReport) -> tuple[str, ...]:
        return (effect.id, *(value for key, value in effect.options.items() if key != "form"))

    several = {one for side in (effects, others) for one, count in Counter(map(place, side)).items() if count > 1}
    return {
        (*place(effect), effect.options.get("form", "")) if place(effect) in several else place(effect): effect
        for effect in effects
    }


def _number(
    one: ParameterEstimate | BenchParameterEstimate | None, two: ParameterEstimate | BenchParameterEstimate | None
) -> ParameterDifference:
    if one is None or two is None:
        there = one or two
        assert there is not None
        values = {"real": one and there.value, "simulated": two and there.value}
        return ParameterDifference(**values, difference=None, ci95=there.ci95, unit=there.unit)  # type: ignore[arg-type]
    apart, bounds = one.value - two.value, None
    if one.ci95 is not None and two.ci95 is not None:
        below = np.hypot(one.value - one.ci95[0], two.ci95[1] - two.value)
        above = np.hypot(one.ci95[1] - one.value, two.value - two.ci95[0])
        bounds = [float(apart - below), float(apart + above)]
    return ParameterDifference(real=one.value, simulated=two.value, difference=apart, ci95=bounds, unit=one.unit)


def sentences(found: Sequence[Difference]) -> list[str]:
    """Return a sentence for each difference."""
    who = {"real": "the bench has, the simulator has not: ", "simulated": "the simulator has, the bench has not: "}
    said = []
    for one in found:
        words = []
        for name, number in one.parameters.items():
            unit, factor = display_unit(number.unit)
            if number.difference is None:
                value = number.real if number.simulated is None else number.simulated
                where = "" if one.only_in else f" {'on the bench' if number.simulated is None else 'in the simulator'}"
                words.append(f"{name} = {(value or 0.0) * factor:.5g} {unit}".rstrip() + where)
            elif number.is_significant and number.ci95 is not None:
                numbers = (number.real, number.simulated, number.difference, *number.ci95)
                real, simulated, apart, low, high = (factor * (each or 0.0) for each in numbers)
                words.append(
                    f"{name} is {real:.5g} {unit} on the bench and {simulated:.5g} {unit} in the simulator, "
                    f"{apart:+.5g} {unit} (95 % {low:+.5g} to {high:+.5g})"
                )
        label = " ".join([one.id, *one.options.values()])
        said.append(f"{who.get(one.only_in or '', 'both have ')}{label}: {', '.join(words)}")
    return said
