# SPDX-License-Identifier: Apache-2.0
"""Estimation of numbers that a bench file does not hold, or only roughly: where they begin.

The effect that stands for a wrong number (`effects`) stands for an unknown one too. Its range is that of an error, so
the recordings are fitted first from a few sizes of the number, beside the causes that every bench may have, and the
bench is written again until it moves no more. Then the search has that effect in each of its fits.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from hydro_diagnosis.bench_numbers import lacks, numbers, told
from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.effects.base import Claim, Effect, changed
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.recording import InputError, Segment
from hydro_diagnosis.significance import ITERATIONS
from hydro_sim.model.bench import Bench

SIZES = (1.0, 0.1, 10.0)
"""Multiples of the stand-in at which a number that was not given begins."""
SETTLED = 0.01
"""Share of a number by which it may still move."""
SECONDS = 12.0
"""Length of the recordings that are looked at."""
BESIDE = ("friction_coulomb", "friction_viscous", "force_offset", "leakage_internal", "valve_offset")
"""Causes that may be there too: without them an unknown number takes their place."""
ABOVE = 1.1
"""Supply pressure over the highest pressure recorded, where it begins at least."""


@cache
def estimable() -> dict[str, Effect]:
    """Numbers of a bench file that can be estimated, and the effect that stands for each."""
    bench = Bench.nominal()
    found: dict[str, Effect] = {}
    for effect in LIBRARY:
        adapted = effect.adapted(bench)
        settled = adapted.settled(bench, {one.name: one.probes[0] for one in adapted.parameters})
        moved = [name for name in numbers() if getattr(settled, name) != getattr(bench, name)]
        if len(moved) == 1:
            found.setdefault(moved[0], effect)
    return {name: found[name] for name in numbers() if name in found}


def refuse_inestimable(names: Collection[str]) -> None:
    """Raise `InputError` if one of these is no number that can be estimated."""
    for name in names:
        if name not in estimable():
            why = (
                "is not a number of a bench file"
                if name not in numbers()
                else "cannot be estimated: nothing stands for it"
            )
            raise InputError(f"estimate: {name!r} {why}; those that can be are {', '.join(estimable())}")


def estimated_claims(bench: Bench, names: Collection[str]) -> tuple[Claim, ...]:
    """The effects of these numbers relative to the bench, absent."""
    claims = []
    for name in names:
        effect = replace(estimable()[name].adapted(bench), estimated=True)
        claims.append(Claim(effect, {one.name: one.neutral for one in effect.parameters}))
    return tuple(claims)


def starting_bench(segments: Sequence[Segment], bench: Bench, baseline: Sequence[Claim], names: Sequence[str]) -> Bench:
    """The bench with numbers near which the recordings put them, known from now on.

    `baseline`: effects that the bench file holds already.
    """
    if not any(lacks(bench, name) for name in names):
        return bench  # beside causes that are not known yet a fit would leave what was given
    short = list(_short(segments))
    tried = []
    for size in SIZES:
        start = _start(bench, names, size, short)
        tried.append(_settled(short, start, baseline, names))
        if not tried[-1][1].noticeable(tried[-1][2].residual):
            break
    return min(tried, key=lambda one: _left(one[1], one[2]))[0]


def _settled(
    segments: Sequence[Segment], bench: Bench, baseline: Sequence[Claim], names: Sequence[str]
) -> tuple[Bench, Problem, Fit]:
    """The bench, problem and fit once the numbers stand still."""
    for _ in range(ITERATIONS):
        problem = Problem(segments, bench, baseline, estimated=estimated_claims(bench, names))
        found = fit(problem, tuple(_beside(problem, names)))
        before = np.array([getattr(bench, name) for name in names])
        for claim in found.claims:
            if claim.effect.estimated:
                bench = claim.effect.settled(bench, claim.values)
        after = np.array([getattr(bench, name) for name in names])
        if np.all(np.abs(after - before) <= SETTLED * np.maximum(np.abs(before), 1e-12)):
            break
    return bench, problem, found


def _beside(problem: Problem, names: Collection[str]) -> Iterator[Claim]:
    taken = {estimable()[name].id for name in names}
    for effect in LIBRARY:
        if effect.label in BESIDE and effect.id not in taken and effect.blocks & set(problem.blocks):
            adapted = effect.adapted(problem.bench)
            yield Claim(adapted, {one.name: one.neutral for one in adapted.parameters})


def _start(bench: Bench, names: Collection[str], size: float, segments: Sequence[Segment]) -> Bench:
    values = {name: getattr(bench, name) * (1.0 if not lacks(bench, name) else size) for name in names}
    if "supply_pressure" in values and lacks(bench, "supply_pressure"):
        values["supply_pressure"] = ABOVE * max(
            float(segment.channels[name].max())
            for segment in segments
            for name in ("pressure_a", "pressure_b")
            if name in segment.channels
        )
    if "area_ratio" in values and lacks(bench, "area_ratio"):
        values["area_ratio"] = bench.area_ratio
    if "spring_rest_position" in values and lacks(bench, "spring_rest_position"):
        values["spring_rest_position"] = float(np.mean([np.mean(one.channels["piston_position"]) for one in segments]))
    inside = changed(bench, **values)
    return told(inside, **{name: getattr(inside, name) for name in names})


def _left(problem: Problem, found: Fit) -> float:
    """-2 log likelihood of what remains in physical units: comparable between benches, whose noise floors differ."""
    parts: dict[str, list[float]] = {}
    for (channel, _), part in problem.parts(found.claims).items():
        sums = parts.setdefault(channel, [0.0, 0.0])
        sums[0] += float(np.sum(np.square(part)))
        sums[1] += len(part)
    return float(sum(count * np.log(max(squares, 1e-300) / count) for squares, count in parts.values()))


def _short(segments: Sequence[Segment]) -> Iterator[Segment]:
    """The first `SECONDS` in all, the same share of each segment."""
    share = min(SECONDS / sum(len(one) * one.step for one in segments), 1.0)
    for one in segments:
        yield one.cut(0, max(round(share * len(one)), min(len(one), round(2.0 / one.step))))
