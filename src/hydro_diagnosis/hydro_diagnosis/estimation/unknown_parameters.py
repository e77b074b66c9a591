# SPDX-License-Identifier: Apache-2.0
"""Start values of bench parameters that are unknown, or only roughly known, and that every fit then estimates.

The effect that represents an error of a parameter (`effects`) represents an unknown one too. Its range is that of an
error, so the recordings are first fitted from a few sizes of the parameter, jointly with the causes that every bench
may have, and the estimate is written into the bench until it converges. The search then has that effect in each fit.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from hydro_diagnosis.bench_parameters import bench_parameter_names, is_missing, with_known_values
from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.effects.base import Effect, EffectHypothesis, with_values
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.recording import InputError, Segment
from hydro_diagnosis.significance import ITERATIONS
from hydro_sim.model.bench import Bench


@cache
def estimable() -> dict[str, Effect]:
    """Return the bench parameters that can be estimated, each with the effect that represents its error."""
    bench = Bench.nominal()
    found: dict[str, Effect] = {}
    for effect in LIBRARY:
        adapted = effect.adapted(bench)
        settled = adapted.write_into_bench(bench, {one.name: one.start_values[0] for one in adapted.parameters})
        moved = [name for name in bench_parameter_names() if getattr(settled, name) != getattr(bench, name)]
        if len(moved) == 1:
            found.setdefault(moved[0], effect)
    return {name: found[name] for name in bench_parameter_names() if name in found}


def require_estimable(names: Collection[str]) -> None:
    """Raise `InputError` if a name is not that of a bench parameter that can be estimated."""
    for name in names:
        if name not in estimable():
            why = "cannot be estimated: nothing stands for it"
            why = why if name in bench_parameter_names() else "is not a number of a bench file"
            raise InputError(f"estimate: {name!r} {why}; those that can be are {', '.join(estimable())}")


def estimated_claims(bench: Bench, names: Collection[str]) -> tuple[EffectHypothesis, ...]:
    """Return claims that represent errors of these bench parameters, at their neutral values."""
    claims = []
    for name in names:
        effect = replace(estimable()[name].adapted(bench), estimated=True)
        claims.append(EffectHypothesis(effect, {one.name: one.neutral for one in effect.parameters}))
    return tuple(claims)


def starting_bench(
    segments: Sequence[Segment], bench: Bench, baseline: Sequence[EffectHypothesis], names: Sequence[str]
) -> Bench:
    """Return the bench with start values of these parameters, estimated from the recordings and marked as known.

    `baseline`: effects that the bench file contains already.
    """
    if not any(is_missing(bench, name) for name in names):
        return bench  # a fit without the causes, not known yet, would leave the given values
    share = min(12.0 / sum(len(one) * one.step for one in segments), 1.0)  # of each segment, 12 s in all
    short = [one.cut(0, max(round(share * len(one)), min(len(one), round(4.0 / one.step)))) for one in segments]
    tried = []
    for size in (1.0, 0.1, 10.0):  # start sizes of parameters not given, as multiples of the stand-in
        tried.append(_iterate_bench(short, _start(bench, names, size, short), baseline, names))
        if not tried[-1][1].has_excess(tried[-1][2].residual):
            break
    return min(tried, key=lambda one: _physical_deviance(one[1], one[2]))[0]


def _iterate_bench(
    segments: Sequence[Segment], bench: Bench, baseline: Sequence[EffectHypothesis], names: Sequence[str]
) -> tuple[Bench, Problem, Fit]:
    """Return bench, problem and fit once the parameters have converged within 1 %."""
    taken = {estimable()[name].id for name in names}
    joint = ("friction_coulomb", "friction_viscous", "force_offset", "leakage_internal", "valve_offset")
    for _ in range(ITERATIONS):
        problem = Problem(segments, bench, baseline, estimated=estimated_claims(bench, names))
        others = [one.adapted(bench) for one in LIBRARY if one.label in joint and one.id not in taken]
        others = [one for one in others if one.blocks & set(problem.blocks)]
        found = fit(
            problem, [EffectHypothesis(one, {each.name: each.neutral for each in one.parameters}) for one in others]
        )
        before = np.array([getattr(bench, name) for name in names])
        for claim in found.claims:
            if claim.effect.estimated:
                bench = claim.effect.write_into_bench(bench, claim.values)
        after = np.array([getattr(bench, name) for name in names])
        if np.all(np.abs(after - before) <= 0.01 * np.maximum(np.abs(before), 1e-12)):
            break
    return bench, problem, found


def _start(bench: Bench, names: Collection[str], size: float, segments: Sequence[Segment]) -> Bench:
    values = {name: getattr(bench, name) * (1.0 if not is_missing(bench, name) else size) for name in names}
    if "supply_pressure" in values and is_missing(bench, "supply_pressure"):
        values["supply_pressure"] = 1.1 * max(
            float(segment.channels[name].max())
            for segment in segments
            for name in ("pressure_a", "pressure_b")
            if name in segment.channels
        )
    if "area_ratio" in values and is_missing(bench, "area_ratio"):
        values["area_ratio"] = bench.area_ratio
    if "spring_rest_position" in values and is_missing(bench, "spring_rest_position"):
        values["spring_rest_position"] = float(np.mean([np.mean(one.channels["piston_position"]) for one in segments]))
    inside = with_values(bench, **values)
    return with_known_values(inside, **{name: getattr(inside, name) for name in names})


def _physical_deviance(problem: Problem, found: Fit) -> float:
    """-2 log likelihood of the residuals in physical units: comparable between benches, whose noise floors differ."""
    parts: dict[str, list[float]] = {}
    for (channel, _), part in problem.parts(found.claims).items():
        sums = parts.setdefault(channel, [0.0, 0.0])
        sums[0] += float(np.sum(np.square(part)))
        sums[1] += len(part)
    return float(sum(count * np.log(max(squares, 1e-300) / count) for squares, count in parts.values()))
