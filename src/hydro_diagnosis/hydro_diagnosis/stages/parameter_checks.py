# SPDX-License-Identifier: Apache-2.0
"""Parameters and causes that are not claimed: estimated, confirmed, or undetectable because of missing rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hydro_diagnosis.effects.base import Effect, EffectHypothesis, FloatArray, display_unit
from hydro_diagnosis.estimation.fit import Fit, cause_key, eligible_effects, orthogonal
from hydro_diagnosis.report_json import BenchParameterEstimate
from hydro_diagnosis.significance import PRACTICAL_SHARE, QUANTILE, UNIDENTIFIED_HALF_WIDTH
from hydro_sim.model.bench import Bench

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.intervals import Interval
    from hydro_diagnosis.estimation.problem import Problem


def bench_parameter_estimates(
    problem: Problem, found: Fit, bounds: Sequence[Interval], library: Sequence[Effect],
    given: Mapping[str, float | None],
) -> list[BenchParameterEstimate]:  # fmt: skip
    """Report entries of the estimated bench parameters, in their order.

    `bounds`: intervals of the parameters of all claims; `given`: the bench file's values by name, None if absent.
    """
    weight = problem.weight(found.residual)
    columns = found.jacobian * weight[:, None]
    owners = [claim for claim in found.claims for _ in claim.effect.parameters]
    names = dict(zip((claim.effect.label for claim in problem.estimated), given, strict=True))
    entries = []
    for k, (claim, bound) in enumerate(zip(owners, bounds, strict=True)):
        if not claim.effect.estimated:
            continue
        name, parameter = names[claim.effect.label], claim.effect.parameters[0].name
        number = Bench.quantities()[name]
        value, low, high = (
            float(getattr(claim.effect.write_into_bench(problem.bench, {parameter: one}), name))
            for one in (bound.value, bound.low, bound.high)
        )
        mixed = _mixed(columns, k, [names.get(one.effect.label, one.effect.id) for one in owners])
        vague = number.low > 0.0 and high - low > 2.0 * UNIDENTIFIED_HALF_WIDTH * abs(value)
        sure = not mixed and bound.identifiable and not vague
        others = [one for one in mixed or _alike(problem, found, columns, k, weight, library) if one != name]
        alike = " and ".join(others)
        if sure:
            said = f"{name} is estimated at {value:.5g} {number.unit} (95 % {low:.5g} to {high:.5g})"
            said += f", provided that there is none of what would look the same: {alike}." if alike else "."
        elif alike:
            said = f"{name} cannot be told from {alike} by these recordings: it is left open."
        else:
            said = f"These recordings hold too little of {name} to tell it: it is left open."
        entries.append(BenchParameterEstimate(
            name=name, value=value, unit=number.unit, ci95=[low, high] if sure else None, given=given[name],
            alike=others, sentence=said,
        ))  # fmt: skip
    return entries


def _mixed(columns: FloatArray, k: int, names: Sequence[str]) -> list[str]:
    """Return the other terms of the fit that explain 99 % of a parameter's signature; itself if it has none."""
    column = columns[:, k]
    if not np.linalg.norm(column) > 1e-9 * np.sqrt(len(column)):
        return [names[k]]
    others = np.delete(columns, k, axis=1)
    lengths = np.linalg.norm(others, axis=0)
    if not len(lengths) or np.linalg.norm(orthogonal(others, column)) > 0.01 * np.linalg.norm(column):
        return []
    lengths = np.maximum(lengths, 1e-300)
    shares = np.linalg.lstsq(others / lengths, column, rcond=1e-12)[0]
    by_size = np.argsort(-np.abs(shares))
    rest = [name for j, name in enumerate(names) if j != k]
    return list(dict.fromkeys(rest[j] for j in by_size if abs(shares[j]) > 0.3 * np.max(np.abs(shares))))


def _alike(
    problem: Problem, found: Fit, columns: FloatArray, k: int, weight: FloatArray, library: Sequence[Effect]
) -> list[str]:
    """Unclaimed causes whose signature is collinear with the parameter's, given all other terms of the fit."""
    others = np.delete(columns, k, axis=1)
    own = orthogonal(others, columns[:, k])
    alike = []
    for effect in eligible_effects(library, found.claims, problem.blocks):
        if not effect.named or effect.needs or len(effect.parameters) > 1:
            continue
        probe = EffectHypothesis(effect, {one.name: one.neutral + 0.1 * one.span for one in effect.parameters})
        shown = orthogonal(others, (problem.residual((*found.claims, probe)) - found.residual) * weight)
        size = float(np.linalg.norm(shown) * np.linalg.norm(own))
        if size > 0.0 and abs(float(shown @ own)) > 0.999 * size:  # a correlation
            alike.append(effect.label)
    return alike


def confirmation_note(
    problem: Problem, found: Fit, bounds: Sequence[Interval], library: Sequence[Effect], hidden: str = ""
) -> str:
    """Note on the bench file's parameters that are confirmed to within 5 %, to first order; empty for none.

    Each is tested jointly with the claims, as if the others were exact, and to no closer than the smallest claimable
    change. `hidden`: result of `undetectable_note`, of which none is confirmed.
    """
    weight = problem.weight(found.residual)
    columns, left = found.jacobian * weight[:, None], found.residual * weight
    inflation, said = max((one.inflation for one in bounds), default=1.0), []
    scaled = {"piston_area", "area_ratio", "spring_stiffness", "bulk_modulus", "dead_volume", "supply_pressure",
              "valve_gain"}  # fmt: skip
    for effect in eligible_effects(library, found.claims, problem.blocks):
        name = _plain(effect)
        if effect.id not in scaled or f"{name} within" in hidden:
            continue
        (ratio,) = effect.parameters
        signature = (
            problem.residual((*found.claims, EffectHypothesis(effect, {ratio.name: 1.01}))) - found.residual
        ) * weight
        own = orthogonal(columns, signature)
        power = max(float(own @ own), 1e-300)
        off = 0.01 * (abs(float(own @ left)) / power + QUANTILE * inflation / power**0.5)
        if off < PRACTICAL_SHARE:
            said.append(f"{name} within {100.0 * max(off, ratio.smallest_reported):.2g} %")
    return f"confirmed of the bench file, each if the others hold: {', '.join(said)}" if said else ""


def undetectable_note(problem: Problem, found: Fit, library: Sequence[Effect], threshold: float) -> str:
    """Note on causes undetectable because of missing rows, with their detection limits; empty if no row is missing.

    `threshold`: evidence in units of BIC that a claim needs beyond the penalty of its parameters.
    """
    if problem.half_rows is None:
        return ""
    weight = problem.weight(found.residual)
    change = problem.half_rows_change(found.claims) * weight
    limits: dict[str, tuple[float, str]] = {}
    for effect in eligible_effects(library, found.claims, problem.blocks):
        if not effect.named or effect.needs:
            continue
        name = _plain(effect)
        price = threshold + len(effect.parameters) * float(np.log(len(weight)))
        tried = (_least(problem, found, effect, k, weight, change, price) for k in range(3))
        limit = min(tried, key=lambda one: one[0])
        limits[name] = min(limit, limits.get(name, limit), key=lambda one: one[0])
    hidden = ", ".join(f"{name}{words}" for name, (_, words) in limits.items() if words)
    said = "the recording has too few rows a second to show these causes, so they are not reported: "
    return f"{said}{hidden}" if hidden else ""


def _plain(effect: Effect) -> str:
    return " ".join(cause_key(effect)).replace("=", " ").replace("_", " ")


def _least(
    problem: Problem, found: Fit, effect: Effect, probe: int, weight: FloatArray, change: FloatArray, price: float
) -> tuple[float, str]:
    """Detection limit as a multiple of a probe, and in words if it is large: ` under 0.4 kg`, ` at any size`."""
    start = {one.name: one.start_values[min(probe, len(one.start_values) - 1)] for one in effect.parameters}
    signature = (problem.residual((*found.claims, EffectHypothesis(effect, start))) - found.residual) * weight
    power = float(signature @ signature)
    if power <= 0.0:
        return np.inf, " at any size"
    share = max(2.0 * abs(float(signature @ change)), (price * power) ** 0.5) / power
    main = next(iter(effect.amplitudes), None)
    if main is None:
        return share, " at any size" if share > 1.0 else ""
    size = share * abs(start[main.name] - main.neutral)
    if size <= 10.0 * main.smallest_reported:  # smaller limits are not listed
        return share, ""
    unit, factor = ("%", 100.0) if main.unit == "-" else display_unit(main.unit)
    return share, f" {'under' if main.neutral == 0.0 else 'within'} {size * factor:.2g} {unit}"
