# SPDX-License-Identifier: Apache-2.0
"""Joint search of names and laws: names that only mimicked a missing law are dropped, causes that it hid are found.

Where names alone leave a remainder, the first of them may only stand in for a missing law, and a true cause may have
been dropped with them. So the search of the names (`selection.search`) is repeated with laws among its candidates.
Every claim that is kept must pay beside all others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_diagnosis.closure.disguise import in_disguise
from hydro_diagnosis.closure.evidence import HeldOutBlocks, definite
from hydro_diagnosis.effects.base import Claim, Effect
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.layout import CHANNELS
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.localisation import noticeable
from hydro_diagnosis.selection.outcome import SearchSettings, score
from hydro_diagnosis.selection.search import Search

THRESHOLD = 30.0
"""Deviance that a term must gain on held-out blocks, and any claim in evidence."""
FORM_ERROR = SearchSettings().form_error
"""Share of the present terms' signature that an error of their form may explain: another term must explain more."""
SETTINGS = SearchSettings(restarts=1, effort=1500)
"""Less effort than for names alone: a missing law is found first."""


def together(problem: Problem, names: Sequence[Effect], laws: Sequence[Effect]) -> Fit:
    """Names and laws that account for the recordings together; `problem` is weighed for them afterwards."""
    found = Search(problem, (*names, *laws), SETTINGS).run().fit
    while True:  # the search has weighed for all that it found
        kept = paying(problem, found)
        if len(kept.claims) == len(found.claims):
            return kept
        problem.update_weights(kept.claims)
        found = fit(problem, kept.claims)


def paying(problem: Problem, found: Fit, names_stay: bool = False) -> Fit:
    """The fit without claims that do not pay beside the others, the idlest dropped first; names, unless they stay."""
    while True:
        open_ = [one for one in found.removable if not (names_stay and one.effect.named)]
        fewer = [(claim, fit(problem, _others(found, claim))) for claim in open_]
        idle = [one for claim, one in fewer if not _pays(problem, one, found, claim)]
        if not idle:
            return found
        found = min(idle, key=lambda one: score(problem, one))


def _others(found: Fit, claim: Claim) -> tuple[Claim, ...]:
    return tuple(one for one in found.claims if one is not claim)


def _pays(problem: Problem, without: Fit, found: Fit, claim: Claim) -> bool:
    if score(problem, without) - score(problem, found) < THRESHOLD or mimics(problem, without, found):
        return False
    if not isinstance(claim.effect, Closure):
        return True
    if not definite(problem, found, claim) or in_disguise(problem, found, claim):
        return False
    return held_out_gain(problem, without, found) >= THRESHOLD


def held_out_gain(problem: Problem, before: Fit, after: Fit) -> float:
    """Deviance of held-out blocks that goes from one fit to another."""
    return HeldOutBlocks(problem, before, ()).deviance(()) - HeldOutBlocks(problem, after, ()).deviance(())


def mimics(problem: Problem, before: Fit, after: Fit) -> bool:
    """Return whether the later fit explains no more, in any channel, than a form error of the earlier terms may.

    Never so where something remains before and nothing after: a wrong form leaves a remainder under any name.
    """
    if noticeable(problem, before.residual) and not noticeable(problem, after.residual):
        return False
    named = tuple(claim for claim in before.claims if not isinstance(claim.effect, Closure))
    if len(named) == len(before.claims):
        return False
    channel = problem.layout.channel
    signature = np.bincount(channel, np.square(problem.residual(named) - before.residual), len(CHANNELS))
    added = np.bincount(channel, np.square(before.residual) - np.square(after.residual), len(CHANNELS))
    return bool(np.all(added <= FORM_ERROR**2 * signature + THRESHOLD))
