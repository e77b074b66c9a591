# SPDX-License-Identifier: Apache-2.0
"""Score test: how much of the present fit's residual each candidate could explain, to first order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from hydro_diagnosis.effects.base import Claim, Effect, FloatArray, Values
from hydro_diagnosis.estimation.fit import Fit, deviance, residual_variances
from hydro_diagnosis.estimation.problem import Problem

NEARLY = 0.02
"""Share of the way from a bound to the neutral value, and no less, at which a search begins."""


@dataclass(frozen=True)
class Prospect:
    """A candidate with starting values and the gain in deviance that they promise."""

    claim: Claim
    gain: float


class Signatures:
    """Changes of the residual by the candidates at their starts, kept for claims that differ by a few.

    What a candidate does depends little on the other claims: to rank candidates, not to fit them, it may be old.
    """

    def __init__(self) -> None:
        self._seen: dict[tuple[object, ...], npt.NDArray[np.float32]] = {}

    def of(self, problem: Problem, fit: Fit, claim: Claim, deviations: FloatArray) -> FloatArray:
        """A candidate's signature beside a fit, over the residuals' present `deviations`."""
        key = (claim.effect.label, *claim.values.values())
        if key not in self._seen:
            signature = problem.residual((*fit.claims, claim)) - fit.residual
            self._seen[key] = (signature * deviations).astype(np.float32)
            return signature
        return self._seen[key] / deviations


def allowed(library: Sequence[Effect], claims: Sequence[Claim], blocks: Sequence[str]) -> Iterator[Effect]:
    """Candidates that may join the claims: another cause, its prerequisites claimed, visible in these channels."""
    taken = {cause(claim.effect) for claim in claims}
    ids = {claim.effect.id for claim in claims}
    for effect in library:
        if cause(effect) not in taken and set(effect.needs) <= ids and effect.blocks & set(blocks):
            yield effect


def cause(effect: Effect) -> tuple[str, ...]:
    """Key that identifies a cause: id and options, but not the form unless it has no name."""
    telling = {key: value for key, value in effect.options.items() if key != "form" or not effect.named}
    return (effect.id, *(f"{key}={value}" for key, value in telling.items()))


def screen(
    problem: Problem, fit: Fit, library: Sequence[Effect], signatures: Signatures | None = None
) -> list[Prospect]:
    """Prospects, the most promising first; `signatures` that are known already are not computed again."""
    weight = np.sqrt(1.0 / residual_variances(problem, fit.residual))[problem.layout.channel]
    basis = _basis(fit.jacobian * weight[:, None])
    left = _without(basis, fit.residual * weight)
    known, deviations = signatures or Signatures(), problem.deviations()
    prospects = []
    for effect in allowed(library, fit.claims, problem.blocks):
        looks = []
        for start in _starts(effect):
            claim = Claim(effect, start)
            direction = _without(basis, known.of(problem, fit, claim, deviations) * weight)
            looks.append(_look(problem, claim, direction, weight, left))
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


def _look(problem: Problem, claim: Claim, direction: FloatArray, weight: FloatArray, left: FloatArray) -> Prospect:
    effect, power = claim.effect, float(direction @ direction)
    if power <= 1e-12:
        return Prospect(claim, 0.0)
    amount = -float(direction @ left) / power
    if len(effect.parameters[0].probes) > 1:
        amount = min(amount, 3.0)
    if amount <= 0.0 and _bounded(effect):
        return Prospect(claim, 0.0)
    reached = deviance(problem, (left + amount * direction) / weight)
    moved = Claim(effect, _moved(effect, claim.values, amount))
    return Prospect(moved, deviance(problem, left / weight) - reached)


def _bounded(effect: Effect) -> bool:
    main = effect.parameters[0]
    return main.neutral in (main.low, main.high)


def _moved(effect: Effect, start: Values, amount: float) -> dict[str, float]:
    """Starting values: amplitudes scaled by what the first-order look suggests, shapes as probed."""
    moved = dict(start)
    for parameter in effect.parameters:
        if parameter.smallest > 0.0:
            scaled = parameter.neutral + amount * (start[parameter.name] - parameter.neutral)
            low, high = (end + NEARLY * (parameter.neutral - end) for end in (parameter.low, parameter.high))
            moved[parameter.name] = float(np.clip(scaled, low, high))
    return moved
