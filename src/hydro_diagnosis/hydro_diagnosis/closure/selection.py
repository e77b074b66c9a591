# SPDX-License-Identifier: Apache-2.0
"""Selection of closure terms: a law of few terms if it does nearly as well as a smooth function, else that function.

Terms are added one after the other by what they gain on blocks of time that they were not fitted to (`evidence`); after
each, all numbers, those of the names too, are estimated anew. Where such laws leave something, names and laws are
searched together (`together`): names that the judgement dropped may come back, and names that it made may go.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from hydro_diagnosis.closure.evidence import HeldOutBlocks, column, definite
from hydro_diagnosis.closure.together import THRESHOLD, held_out_gain, mimics, paying, together
from hydro_diagnosis.effects.base import Claim, Effect, FloatArray
from hydro_diagnosis.effects.closure import Closure, closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.free_form import variable_of
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.localisation import noticeable
from hydro_diagnosis.selection.outcome import score
from hydro_diagnosis.selection.verdict import Assessment, coincidence
from hydro_sim.model import grammar
from hydro_sim.model.effects.catalogue import CLOSURES
from hydro_sim.model.laws import Law

TERMS = 3
"""Largest number of terms of a law."""
LEAST = 0.02
"""Share of the possible gain that a term must bring: less is mimicry of another form."""
CONDENSED = 0.05
"""Share of a smooth function's gain by which a law may fall short of it."""
PROMISING = 6
"""Laws that a joint search with names tries, beside names alone and beside the laws that were found first."""
PATIENCE = 24
"""Iterations of a fit at most: a law's further numbers begin on a coarse grid."""
INSIDE = 0.1
"""Percentiles of its variable that a table leaves out at either end."""
QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Of a threshold's signal: where thresholds are looked for."""
EDGE = 0.02
"""Share of a threshold's signal that is left on either side of it."""


@dataclass(frozen=True)
class Closed:
    """Names and closure estimated together."""

    fit: Fit
    form: str
    """law or smooth."""
    gain: float
    """Held-out deviance that it gains over the names alone."""
    problem: Problem
    """The problem with the weights of the fit."""


def closures(problem: Problem, assessment: Assessment, names: Sequence[Effect] = ()) -> list[Closed]:
    """Models of the remainder, the preferred first; none where no term holds on held-out blocks.

    `names`: causes that may stand beside a law though the judgement does not claim them.
    """
    if not assessment.remainder:
        return []
    by_law = _by_law(problem, assessment.fit, names)
    left = noticeable(by_law.problem, by_law.fit.residual)
    below = by_law if left else Closed(assessment.fit, "smooth", 0.0, problem)
    by_table = _by_table(below)
    law_will_do = not left or by_law.gain >= (1.0 - CONDENSED) * by_table.gain
    both = (by_law, by_table) if law_will_do else (by_table, by_law)
    return [one for one in both if one.gain > 0.0]


def _by_law(problem: Problem, base: Fit, names: Sequence[Effect]) -> Closed:
    """Laws beside the names that stand; if they leave something, names and laws that together leave nothing."""
    tried = _Tried(problem, base, [one for effect in _laws(problem) for one in _nothing(effect)])
    grown, gain = _grown(problem, base, tried)
    if gain > 0.0 and len((kept := paying(problem, grown)).claims) < len(grown.claims):
        grown, gain = kept, held_out_gain(problem, base, kept)  # names or terms that stood for another's numbers
    one_by_one = Closed(grown, "law", gain, problem)
    if not names or (gain > 0.0 and not noticeable(problem, grown.residual)):
        return one_by_one
    laws = list({law.label: law for fitted in (base, grown) for law in tried.promising(problem, fitted)}.values())
    weighed = copy(problem)  # its weights are its own, all else is shared
    found = together(weighed, names, laws)
    room = min(TERMS, CLOSURES - len(problem.bench.closures))
    if noticeable(weighed, found.residual) or coincidence(found.claims) or not 0 < _terms(found) <= room:
        return one_by_one  # where something remains, names may be there for want of what is missing: none is forced
    return Closed(found, "law", held_out_gain(weighed, fit(weighed, base.claims), found), weighed)


def _by_table(below: Closed) -> Closed:
    """Tables upon names, and upon laws that leave something; laws that do not pay beside them go.

    Names stay: a table takes the form of any of them.
    """
    problem, before = below.problem, below.fit
    fitted = paying(problem, _grown(problem, before, _Tried(problem, before, _tables(problem)))[0], names_stay=True)
    if {claim.effect.label for claim in fitted.claims} <= {claim.effect.label for claim in before.claims}:
        return Closed(before, "smooth", 0.0, problem)  # no table, or none that pays
    return Closed(fitted, "smooth", below.gain + held_out_gain(problem, before, fitted), problem)


def _terms(found: Fit) -> int:
    return sum(isinstance(claim.effect, Closure) for claim in found.claims)


def _laws(problem: Problem) -> list[Closure]:
    """Laws that these recordings can show, their thresholds within what was recorded."""
    return [placed for law in grammar.LAWS if (placed := _placed(law, problem)) is not None]


def _placed(law: Law, problem: Problem) -> Closure | None:
    effect = closure(law, problem.bench)
    over = next((number.over for number in law.numbers if number.over), "")
    if not over or not _visible(effect, problem):
        return effect if not over and _visible(effect, problem) else None
    low, *probes, high = np.quantile(_recorded(problem, over), (EDGE, *QUANTILES, 1.0 - EDGE)).tolist()
    return closure(law, problem.bench, (low, high), tuple(probes)) if high > low else None


def _tables(problem: Problem) -> list[Claim]:
    tables = []
    for table in grammar.TABLES:
        if _visible(closure(table, problem.bench), problem):
            low, high = np.percentile(_recorded(problem, table.variable, table.where), [INSIDE, 100.0 - INSIDE])
            if high > low:
                tables += _nothing(closure(table, problem.bench, (float(low), float(high))))
    return tables


_SIZES = {"speed": "velocity", "opening": "current"}


def _recorded(problem: Problem, name: str, channel: str = "") -> FloatArray:
    """Recorded values of a signal that laws and tables run over; `channel`: of the sensor that it is."""
    variable = channel or _SIZES.get(name, name)
    values = np.concatenate([variable_of(model, variable)[model.settle :] for model in problem.models])
    return np.abs(values) if name in _SIZES else values


def _visible(effect: Closure, problem: Problem) -> bool:
    have = set.intersection(*(set(model.channels) for model in problem.models))
    law = effect.law
    text = law.text if isinstance(law, Law) else f"{law.variable} {law.form}"
    if law.where == "load_force" or ("p_" not in text and "pressure" not in text):
        needed = {law.where} - {"", "edges"}
    else:
        needed = {"pressure_a", "pressure_b"}
    return bool(effect.touches & set(problem.blocks)) and needed <= have


def _nothing(effect: Closure) -> list[Claim]:
    return [Claim(effect, values) for values in effect.nothing()]


class _Tried:
    """Terms that may join a fit, and what each does to the residual there."""

    def __init__(self, problem: Problem, base: Fit, terms: Sequence[Claim]) -> None:
        self.terms = list(terms)
        self.columns: list[FloatArray] = [column(problem, base, one) for one in terms]

    def without(self, label: str) -> _Tried:
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
        blocks, chosen, laws = HeldOutBlocks(problem, base, self.columns), [], dict[str, Effect]()
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
        effect, found = self.terms[best].effect, {}
        names = [one.name for one in effect.parameters if one.smallest == 0.0]
        for k in np.argsort(-gains):
            one = self.terms[k]
            if one.effect.label == effect.label and (len(names) > 1 or k == best):
                found.setdefault(one.values[names[0]] if len(names) > 1 else 0.0, one)
        return list(found.values())


def _grown(problem: Problem, base: Fit, tried: _Tried) -> tuple[Fit, float]:
    """The fit with the terms that pay, and the held-out deviance that they gain."""
    current, gained, taken, disguised = base, 0.0, 0, 0.0
    room = min(TERMS, CLOSURES - len(problem.bench.closures) - _terms(base))
    while taken < room and tried.terms and noticeable(problem, current.residual):
        gains, there_is = tried.gains(problem, current)
        best = int(np.argmax(gains))
        if gains[best] < max(THRESHOLD, LEAST * there_is, (1.0 - CONDENSED) * disguised):
            break
        starts = tried.starts(best, gains)
        tried = tried.without(starts[0].effect.label)
        better = _fitted(problem, current, starts)
        if score(problem, current) - score(problem, better) < THRESHOLD or mimics(problem, current, better):
            continue
        if not definite(problem, better, better.claims[-1]):
            disguised = float(gains[best])  # what gains less would stand in for the name or law that this one is
            continue
        gained += float(gains[best])
        taken += 1
        current, disguised = better, 0.0
    return current, gained


def _fitted(problem: Problem, current: Fit, starts: Sequence[Claim]) -> Fit:
    """The fit with a term from the first start at which its further numbers come to be known, else from the best."""
    fits = []
    for start in starts:
        fits.append(fit(problem, (*current.claims, start), iterations=PATIENCE))
        if definite(problem, fits[-1], fits[-1].claims[-1]):
            return fits[-1]
    return fits[0]
