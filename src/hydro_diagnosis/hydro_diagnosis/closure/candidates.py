# SPDX-License-Identifier: Apache-2.0
"""Candidates of a closure: the grammar's laws and tables over what was recorded, and what each gains beside a fit."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from hydro_diagnosis.closure.evidence import HeldOutBlocks, column
from hydro_diagnosis.effects.base import Claim, Effect, FloatArray
from hydro_diagnosis.effects.closure import Closure, closure
from hydro_diagnosis.estimation.fit import Fit
from hydro_diagnosis.estimation.free_form import variable_of
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model import grammar
from hydro_sim.model.laws import Law

INSIDE = 0.1
"""Percentiles of its variable that a table leaves out at either end."""
QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Of a threshold's signal: where thresholds are looked for."""
EDGE = 0.02
"""Share of a threshold's signal that is left on either side of it."""
PROMISING = 4
"""Laws that a joint search with names tries, beside names alone and beside the laws that were found first."""


def laws(problem: Problem) -> list[Claim]:
    """Laws that these recordings can show, their thresholds within what was recorded."""
    found = [placed for law in (*grammar.LAWS, *grammar.COMPOSITIONS) if (placed := _placed(law, problem)) is not None]
    return [one for effect in found for one in _nothing(effect)]


def _placed(law: Law, problem: Problem) -> Closure | None:
    effect = closure(law, problem.bench)
    over = next((number.over for number in law.numbers if number.over), "")
    if not over or not _visible(effect, problem):
        return effect if not over and _visible(effect, problem) else None
    low, *probes, high = np.quantile(_recorded(problem, over), (EDGE, *QUANTILES, 1.0 - EDGE)).tolist()
    return closure(law, problem.bench, (low, high), tuple(probes)) if high > low else None


def tables(problem: Problem) -> list[Claim]:
    """Tables that these recordings can show, over what was recorded."""
    found = []
    for table in grammar.TABLES:
        if _visible(closure(table, problem.bench), problem):
            low, high = np.percentile(_recorded(problem, table.variable, table.where), [INSIDE, 100.0 - INSIDE])
            if high > low:
                found += _nothing(closure(table, problem.bench, (float(low), float(high))))
    return found


_SIZES = {"speed": "velocity", "opening": "current"}


def _recorded(problem: Problem, name: str, channel: str = "") -> FloatArray:
    """Recorded values of a signal that laws and tables run over; `channel`: of the sensor that it is."""
    variable = channel or _SIZES.get(name, name)
    values = np.concatenate([variable_of(model, variable)[model.settle :] for model in problem.models])
    return np.abs(values) if name in _SIZES else values


_CHANNELS = {"current": "valve_current", "position": "piston_position", "velocity": "piston_position",
             "pressure_a": "pressure_a", "pressure_b": "pressure_b"}  # fmt: skip
"""Channels that signals of a composition are recorded in."""


def _visible(effect: Closure, problem: Problem) -> bool:
    have = set.intersection(*(set(model.channels) for model in problem.models))
    law = effect.law
    if isinstance(law, Law) and law.uses:
        needed = {_CHANNELS[one] for one in law.uses if one in _CHANNELS} | ({law.where} - {"", "edges"})
        return bool(effect.touches & set(problem.blocks)) and needed <= have
    text = law.text if isinstance(law, Law) else f"{law.variable} {law.form}"
    if law.where == "load_force" or ("p_" not in text and "pressure" not in text):
        needed = {law.where} - {"", "edges"}
    else:
        needed = {"pressure_a", "pressure_b"}
    return bool(effect.touches & set(problem.blocks)) and needed <= have


def _nothing(effect: Closure) -> list[Claim]:
    return [Claim(effect, values) for values in effect.nothing()]


class Candidates:
    """Terms that may join a fit, and what each does to the residual there."""

    def __init__(self, problem: Problem, base: Fit, terms: Sequence[Claim]) -> None:
        self.terms = list(terms)
        self.columns: list[FloatArray] = [column(problem, base, one) for one in terms]

    def without(self, label: str) -> Candidates:
        """All but the terms of one law."""
        kept, left = copy(self), [k for k, one in enumerate(self.terms) if one.effect.label != label]
        kept.terms, kept.columns = [self.terms[k] for k in left], [self.columns[k] for k in left]
        return kept

    def gains(self, problem: Problem, base: Fit) -> tuple[FloatArray, float]:
        """Held-out deviance that each term gains, and that which there is to gain."""
        blocks = HeldOutBlocks(problem, base, self.columns)
        before = blocks.deviance(())
        there_is = before - float(np.sum(problem.layout.count()))  # a residual that is noise alone leaves one each
        return before - np.array([blocks.deviance((k,)) for k in range(len(self.terms))]), there_is

    def promising(self, problem: Problem, base: Fit) -> list[Effect]:
        """The laws of a forward selection beside a fit, to first order: each gains most beside those before it."""
        blocks = HeldOutBlocks(problem, base, self.columns)
        chosen: list[int] = []
        laws: dict[str, Effect] = {}
        while len(laws) < PROMISING:
            left = [k for k, one in enumerate(self.terms) if one.effect.label not in laws]
            if not left:
                break
            chosen.append(min(left, key=lambda k: blocks.deviance((*chosen, k))))
            effect = self.terms[chosen[-1]].effect
            laws[effect.label] = effect
        return list(laws.values())

    def starts(self, best: int, gains: FloatArray) -> list[Claim]:
        """The best term, and of a law with several further numbers the best with each other value of the first."""
        effect = self.terms[best].effect
        found: dict[float, Claim] = {}
        names = [one.name for one in effect.parameters if one.smallest == 0.0]
        for k in np.argsort(-gains):
            one = self.terms[k]
            if one.effect.label == effect.label and (len(names) > 1 or k == best):
                found.setdefault(one.values[names[0]] if len(names) > 1 else 0.0, one)
        return list(found.values())
