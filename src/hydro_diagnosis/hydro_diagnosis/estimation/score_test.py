# SPDX-License-Identifier: Apache-2.0
"""Score test: how much of the present fit's residual each candidate could explain, to first order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from hydro_diagnosis.effects.base import Claim, Effect, FloatArray
from hydro_diagnosis.estimation.fit import Fit, deviance, spreads
from hydro_diagnosis.estimation.problem import Problem


@dataclass(frozen=True)
class Prospect:
    """A candidate with starting values and the gain in deviance that they promise."""

    claim: Claim
    gain: float


def allowed(library: Sequence[Effect], claims: Sequence[Claim], blocks: Sequence[str]) -> Iterator[Effect]:
    """Candidates that may join the claims: another cause, its prerequisites claimed, visible in these channels."""
    taken = {cause(claim.effect) for claim in claims}
    ids = {claim.effect.id for claim in claims}
    for effect in library:
        if cause(effect) not in taken and set(effect.needs) <= ids and effect.touches & set(blocks):
            yield effect


def cause(effect: Effect) -> tuple[str, ...]:
    """Key that identifies a cause: id and options, but not the form unless it has no name."""
    telling = {key: value for key, value in effect.options.items() if key != "form" or not effect.named}
    return (effect.id, *(f"{key}={value}" for key, value in telling.items()))


def screen(problem: Problem, fit: Fit, library: Sequence[Effect]) -> list[Prospect]:
    """Prospects, the most promising first."""
    weight = np.sqrt(1.0 / spreads(problem, fit.residual))[problem.layout.channel]
    basis = _basis(fit.jacobian * weight[:, None])
    left = _without(basis, fit.residual * weight)
    prospects = []
    for effect in allowed(library, fit.claims, problem.blocks):
        looks = [_look(problem, fit, effect, start, weight, basis, left) for start in _starts(effect)]
        prospects.append(max(looks, key=lambda prospect: prospect.gain))
    return sorted(prospects, key=lambda prospect: -prospect.gain)


def _basis(columns: FloatArray) -> FloatArray:
    if not columns.shape[1]:
        return columns
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return np.linalg.qr(scaled)[0]


def _without(basis: FloatArray, vector: FloatArray) -> FloatArray:
    return vector - basis @ (basis.T @ vector)


def _starts(effect: Effect) -> Iterator[dict[str, float]]:
    names = [parameter.name for parameter in effect.parameters]
    for values in product(*(parameter.probes for parameter in effect.parameters)):
        yield dict(zip(names, values, strict=True))


def _look(
    problem: Problem,
    fit: Fit,
    effect: Effect,
    start: dict[str, float],
    weight: FloatArray,
    basis: FloatArray,
    left: FloatArray,
) -> Prospect:
    outcome = problem.residual((*fit.claims, Claim(effect, start)))
    direction = _without(basis, (outcome - fit.residual) * weight)
    power = float(direction @ direction)
    if power <= 1e-12:
        return Prospect(Claim(effect, start), 0.0)
    amount = -float(direction @ left) / power
    amount = min(amount, 3.0 if len(effect.parameters[0].probes) > 1 else 100.0)
    if amount <= 0.0 and _bounded(effect):
        return Prospect(Claim(effect, start), 0.0)
    reached = deviance(problem, (left + amount * direction) / weight)
    return Prospect(Claim(effect, _moved(effect, start, amount)), deviance(problem, left / weight) - reached)


def _bounded(effect: Effect) -> bool:
    main = effect.parameters[0]
    return main.neutral in (main.low, main.high)


def _moved(effect: Effect, start: dict[str, float], amount: float) -> dict[str, float]:
    """Starting values: amplitudes scaled by what the first-order look suggests, shapes as probed."""
    moved = dict(start)
    for parameter in effect.parameters:
        if parameter.smallest > 0.0:
            scaled = parameter.neutral + amount * (start[parameter.name] - parameter.neutral)
            inside = 0.02 * (parameter.high - parameter.low)
            if _bounded(effect):
                moved[parameter.name] = scaled
            else:
                moved[parameter.name] = float(np.clip(scaled, parameter.low + inside, parameter.high - inside))
    return moved
