# SPDX-License-Identifier: Apache-2.0
"""Which terms close what remains: a law of few terms if one does nearly as well as a smooth function, else that.

Terms are added one after the other by what they gain on blocks of time that they were not fitted to (`evidence`); after
each, all numbers, those of the names too, are estimated anew. Names that the judgement dropped stay dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydro_diagnosis.closure.evidence import HeldOutBlocks, column
from hydro_diagnosis.effects.base import Claim, FloatArray
from hydro_diagnosis.effects.closure import Closure, closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.free_form import variable_of
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.localisation import noticeable
from hydro_diagnosis.selection.outcome import SearchSettings, score
from hydro_diagnosis.selection.verdict import Assessment
from hydro_sim.model import grammar
from hydro_sim.model.effects.catalogue import CLOSURES
from hydro_sim.model.laws import Law

TERMS = 3
"""Of a law at most."""
THRESHOLD = 30.0
"""Held-out deviance that a term must gain, as a name must gain in evidence."""
LEAST = 0.02
"""Share of what there is to gain that a term must bring: less is mimicry of another's form."""
FORM_ERROR = SearchSettings().form_error
"""Share of the signature of terms that stand already that their form may be off by: another must explain more."""
CONDENSED = 0.05
"""Share of what a smooth function gains that a law may lack of it."""
INSIDE = 0.1
"""Percentiles that a table's variable leaves out at either end."""


@dataclass(frozen=True)
class Closed:
    """Names and closure estimated together."""

    fit: Fit
    form: str
    """law or smooth."""
    gain: float
    """Held-out deviance that it gains over the names alone."""


def closures(problem: Problem, assessment: Assessment) -> list[Closed]:
    """Models of what remains, the preferred first; none where no term holds on held-out blocks."""
    if not assessment.remainder:
        return []
    base = assessment.fit
    by_law, by_table = (_grown(problem, base, terms) for terms in (_laws(problem), _tables(problem)))
    found = [Closed(one, form, gain) for (one, gain), form in ((by_law, "law"), (by_table, "smooth")) if gain > 0.0]
    law_will_do = by_law[1] >= (1.0 - CONDENSED) * by_table[1] or not noticeable(problem, by_law[0].residual)
    return sorted(found, key=lambda one: (one.form == "law") != law_will_do)


def _laws(problem: Problem) -> list[Claim]:
    effects = [closure(law, problem.bench) for law in grammar.LAWS]
    return [one for effect in effects if _visible(effect, problem) for one in _nothing(effect)]


def _tables(problem: Problem) -> list[Claim]:
    tables = []
    for table in grammar.TABLES:
        if not _visible(closure(table, problem.bench), problem):
            continue
        values = np.concatenate([variable_of(model, table.variable)[model.settle :] for model in problem.models])
        low, high = np.percentile(values, [INSIDE, 100.0 - INSIDE])
        if high > low:
            tables += _nothing(closure(table, problem.bench, (float(low), float(high))))
    return tables


def _visible(effect: Closure, problem: Problem) -> bool:
    pressures = all({"pressure_a", "pressure_b"} <= set(model.channels) for model in problem.models)
    text = effect.law.text if isinstance(effect.law, Law) else f"{effect.law.variable} {effect.law.form}"
    needed = "p_" in text or "pressure" in text
    return bool(effect.touches & set(problem.blocks)) and (pressures or not needed)


def _nothing(effect: Closure) -> list[Claim]:
    return [Claim(effect, values) for values in effect.nothing()]


def _grown(problem: Problem, base: Fit, terms: Sequence[Claim]) -> tuple[Fit, float]:
    """The fit with the terms that pay, and the held-out deviance that they gain."""
    candidates = list(terms)
    columns: list[FloatArray] = [column(problem, base, one) for one in terms]
    current, gained, taken = base, 0.0, 0
    room = min(TERMS, CLOSURES - len(problem.bench.closures))
    while taken < room and candidates and noticeable(problem, current.residual):
        blocks = HeldOutBlocks(problem, current, columns)
        before = blocks.deviance(())
        after = [blocks.deviance((k,)) for k in range(len(candidates))]
        best = int(np.argmin(after))
        there_is = before - float(np.sum(problem.layout.count()))  # a residual that is noise alone leaves one each
        if before - after[best] < max(THRESHOLD, LEAST * there_is):
            break
        chosen = candidates[best]
        others = [k for k, one in enumerate(candidates) if one.effect.label != chosen.effect.label]
        candidates, columns = [candidates[k] for k in others], [columns[k] for k in others]
        better = fit(problem, (*current.claims, chosen))
        if score(problem, current) - score(problem, better) < THRESHOLD or _mimics(problem, current, better):
            continue
        gained += before - after[best]
        taken += 1
        current = better
    return current, gained


def _mimics(problem: Problem, before: Fit, after: Fit) -> bool:
    """Whether what comes after explains no more, in any channel, than the terms before may be off by in their form."""
    named = tuple(claim for claim in before.claims if not isinstance(claim.effect, Closure))
    if len(named) == len(before.claims):
        return False
    channel = problem.layout.channel
    signature = np.bincount(channel, np.square(problem.residual(named) - before.residual))
    added = np.bincount(channel, np.square(before.residual) - np.square(after.residual))
    return bool(np.all(added <= FORM_ERROR**2 * signature))
