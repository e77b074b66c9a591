# SPDX-License-Identifier: Apache-2.0
"""Bench and simulator: two diagnoses against the same bench file, compared by cause and number.

A cause that both have differs where the 95 % interval of a number's difference, the two intervals' half-widths added in
quadrature, leaves 0 out. What is left is what the bench has that the simulator has not, or the other way round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydro_diagnosis.effects.base import display_unit
from hydro_diagnosis.report_json import Difference, EffectReport, NumberDifference, ParameterEstimate, Report


def compared(bench: Report, simulator: Report) -> Report:
    """The bench's report with what the simulator has differently, and a note on what was found in its recordings."""
    note = f"the simulator's recordings against the same bench file: {simulator.verdict}"
    open_ = {"bench": bench, "simulator": simulator}
    doubtful = [name for name, one in open_.items() if one.verdict in ("unknown", "partly_explained")]
    if doubtful:
        note += (
            f"; not all is explained on the {' and in the '.join(doubtful)}: a cause may be there that was not found"
        )
    return replace(
        bench,
        simulated=differences(bench.effects, simulator.effects),
        data_quality=[*bench.data_quality, note, *(f"simulator: {one}" for one in simulator.data_quality)],
        seconds=bench.seconds + simulator.seconds,
    )


def differences(real: Sequence[EffectReport], simulated: Sequence[EffectReport]) -> list[Difference]:
    """Causes that one of the two lacks, then those whose numbers differ; none that cannot be told apart."""
    own, other = ({_place(effect): effect for effect in effects} for effects in (real, simulated))
    found = []
    for place in {**own, **other}:
        one, two = own.get(place), other.get(place)
        effect = one or two
        assert effect is not None
        own_numbers, other_numbers = (each.parameters if each else {} for each in (one, two))
        names = dict.fromkeys((*own_numbers, *other_numbers))
        numbers = {name: _number(own_numbers.get(name), other_numbers.get(name)) for name in names}
        only_in = "simulated" if one is None else "real" if two is None else None
        if only_in or any(number.tells for number in numbers.values()):
            found.append(
                Difference(
                    id=effect.id, equation=effect.equation, options=effect.options, parameters=numbers, only_in=only_in
                )
            )
    return sorted(found, key=lambda difference: difference.only_in is None)


def _place(effect: EffectReport) -> tuple[str, ...]:
    """Its id and its chamber, cell or sensor: two forms are one cause."""
    return (effect.id, *(value for key, value in effect.options.items() if key != "form"))


def _number(one: ParameterEstimate | None, two: ParameterEstimate | None) -> NumberDifference:
    there = one or two
    assert there is not None
    if one is None or two is None:
        return NumberDifference(
            real=one.value if one else None,
            simulated=two.value if two else None,
            difference=None,
            ci95=there.ci95,
            unit=there.unit,
        )
    apart = one.value - two.value
    bounds = None
    if one.ci95 is not None and two.ci95 is not None:
        below = np.hypot(one.value - one.ci95[0], two.ci95[1] - two.value)
        above = np.hypot(one.ci95[1] - one.value, two.value - two.ci95[0])
        bounds = [float(apart - below), float(apart + above)]
    return NumberDifference(real=one.value, simulated=two.value, difference=apart, ci95=bounds, unit=one.unit)


def sentences(found: Sequence[Difference]) -> list[str]:
    """What differs, a sentence a cause."""
    said = []
    for one in found:
        words = " ".join([one.id, *one.options.values()])
        numbers = []
        for name, number in one.parameters.items():
            unit, factor = display_unit(number.unit)
            real, simulated = (
                "none" if value is None else f"{value * factor:.5g} {unit}".strip()
                for value in (number.real, number.simulated)
            )
            if one.only_in:
                numbers.append(f"{name} = {real if one.only_in == 'real' else simulated}")
            elif number.tells:
                low, high = np.array(number.ci95) * factor if number.ci95 else (np.nan, np.nan)
                apart = "" if number.difference is None else f", {number.difference * factor:+.5g} {unit}".rstrip()
                within = f" (95 % {low:+.5g} to {high:+.5g})" if number.difference is not None else ""
                numbers.append(f"{name} is {real} on the bench and {simulated} in the simulator{apart}{within}")
        where = {
            "real": "the bench has, the simulator has not: ",
            "simulated": "the simulator has, the bench has not: ",
        }
        said.append(f"{where.get(one.only_in or '', 'both have ')}{words}: {', '.join(numbers)}")
    return said
