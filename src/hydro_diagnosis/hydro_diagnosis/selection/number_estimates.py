# SPDX-License-Identifier: Apache-2.0
"""Report of estimated numbers: value, interval, and what the recordings cannot tell them from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields

import numpy as np

from hydro_diagnosis.effects.base import Claim, Effect, FloatArray
from hydro_diagnosis.estimation.fit import Fit, spreads
from hydro_diagnosis.estimation.intervals import Interval
from hydro_diagnosis.estimation.parameters import pack
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.score_test import allowed
from hydro_diagnosis.findings import NumberEstimate
from hydro_sim.model.bench import Bench

ALIKE = 0.999
"""Correlation of what a number and a cause change in the residuals, beside all that is fitted, from which they are one.
"""
OWN = 0.01
"""Share of a number's signature that nothing else in the fit makes, below which it cannot be told from the others."""
VAGUE = 0.5
"""Half width of the interval over the value from which a number is not told."""


def number_estimates(
    problem: Problem,
    found: Fit,
    bounds: Sequence[Interval],
    library: Sequence[Effect],
    numbers: Mapping[str, float | None],
) -> list[NumberEstimate]:
    """One entry per estimated number, in their order.

    `bounds`: of the parameters of all claims; `numbers`: by name, the bench file's value if it holds one.
    """
    weight = np.sqrt(1.0 / spreads(problem, found.residual))[problem.layout.channel]
    columns = found.jacobian * weight[:, None]
    owners = [claim for claim in found.claims for _ in claim.effect.parameters]
    names = dict(zip((claim.effect.label for claim in problem.estimated), numbers, strict=True))
    entries = []
    for k, (claim, bound) in enumerate(zip(owners, bounds, strict=True)):
        if claim.effect.estimated:
            mixed = _mixed(columns, k, [names.get(one.effect.label, one.effect.id) for one in owners])
            others = mixed or _alike(problem, found, columns, k, weight, library)
            name = names[claim.effect.label]
            entries.append(_entry(problem.bench, name, claim, bound, numbers[name], others, told=not mixed))
    return entries


def _mixed(columns: FloatArray, k: int, names: Sequence[str]) -> list[str]:
    """What else in the fit makes nearly all of a number's signature; the number itself if it has none."""
    column = columns[:, k]
    if not np.linalg.norm(column) > 1e-9 * np.sqrt(len(column)):
        return [names[k]]
    others = np.delete(columns, k, axis=1)
    lengths = np.linalg.norm(others, axis=0)
    if not len(lengths) or np.linalg.norm(column - _part(others, column)) > OWN * np.linalg.norm(column):
        return []
    lengths = np.maximum(lengths, 1e-300)
    shares = np.linalg.lstsq(others / lengths, column, rcond=1e-12)[0]
    by_size = np.argsort(-np.abs(shares))
    rest = [name for j, name in enumerate(names) if j != k]
    return list(dict.fromkeys(rest[j] for j in by_size if abs(shares[j]) > 0.3 * np.max(np.abs(shares))))


def _part(others: FloatArray, column: FloatArray) -> FloatArray:
    """What a set of columns makes of another one."""
    if not others.shape[1]:
        return np.zeros_like(column)
    scaled = others / np.maximum(np.linalg.norm(others, axis=0), 1e-300)
    return np.asarray(scaled @ np.linalg.lstsq(scaled, column, rcond=1e-12)[0])


def _alike(
    problem: Problem, found: Fit, columns: FloatArray, k: int, weight: FloatArray, library: Sequence[Effect]
) -> list[str]:
    """Causes that are not claimed and would change the residuals as the number does."""
    others = np.delete(columns, k, axis=1)
    own = columns[:, k] - _part(others, columns[:, k])
    alike = []
    for effect in allowed(library, found.claims, problem.blocks):
        if not effect.named or effect.needs or len(effect.parameters) > 1:
            continue
        probe = Claim(effect, {one.name: one.neutral + 0.1 * one.span for one in effect.parameters})
        shown = (problem.residual((*found.claims, probe)) - found.residual) * weight
        shown = shown - _part(others, shown)
        size = float(np.linalg.norm(shown) * np.linalg.norm(own))
        if size > 0.0 and abs(float(shown @ own)) > ALIKE * size:
            alike.append(effect.label)
    return alike


def _entry(
    bench: Bench, name: str, claim: Claim, bound: Interval, given: float | None, others: list[str], *, told: bool
) -> NumberEstimate:
    unit = next(entry.metadata["unit"] for entry in fields(Bench) if entry.name == name)
    parameter = pack([claim])[0][0].name
    value, low, high = (
        float(getattr(claim.effect.settled(bench, {parameter: one}), name))
        for one in (bound.value, bound.low, bound.high)
    )
    positive = next(entry.metadata["low"] for entry in fields(Bench) if entry.name == name) > 0.0
    sure = told and bound.identifiable and not (positive and high - low > 2.0 * VAGUE * abs(value))
    return NumberEstimate(
        name=name,
        value=value,
        unit=unit,
        ci95=[low, high] if sure else None,
        given=given,
        alike=[one for one in others if one != name],
        sentence=_sentence(name, f"{value:.5g} {unit}", f"{low:.5g} to {high:.5g}" if sure else "", others),
    )


def _sentence(name: str, value: str, interval: str, others: Sequence[str]) -> str:
    alike = " and ".join(one for one in others if one != name)
    if interval:
        said = f"{name} is estimated at {value} (95 % {interval})"
        return f"{said}, provided that there is none of what would look the same: {alike}." if alike else f"{said}."
    if alike:
        return f"{name} cannot be told from {alike} by these recordings: it is left open."
    return f"These recordings hold too little of {name} to tell it: it is left open."
