# SPDX-License-Identifier: Apache-2.0
"""Search for the causes that together explain the recordings: forward, backward and swap steps by evidence.

Evidence is the Bayesian information criterion on the deviance of `fit`: a claim must gain more than ln(n) per
parameter plus a threshold; so must each parameter that a cause has more than the one whose place it takes. What chance
alone reaches, `calibrate` finds by running this whole search on recordings in which nothing is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hydro_diagnosis.effects.base import Effect
from hydro_diagnosis.estimation.fit import Fit, fit, pack
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.score_test import screen
from hydro_diagnosis.selection.localisation import noticeable
from hydro_diagnosis.selection.outcome import Outcome, SearchSettings, Step, score
from hydro_diagnosis.selection.significance import all_significant, form_error

SCREEN_TOLERANCE = 1.0
"""Gain in deviance below which a candidate's fit is good enough to be ranked by."""
SWAPS = 3
"""Rounds of exchanging causes at most, after each claim."""
SWAP_BIC_MARGIN = 2.0
"""BIC by which another cause must do better, its further parameters paid: enough to never go back and forth."""
MAX_REWEIGHT_ITERATIONS = 6
"""Rounds of weighing and fitting at most."""


class Search:
    """One search over one problem."""

    def __init__(
        self,
        problem: Problem,
        library: Sequence[Effect],
        settings: SearchSettings | None = None,
        progress: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.problem = problem
        self.library = tuple(library)
        self.settings = settings or SearchSettings()
        self.progress = progress
        self.steps: list[Step] = []
        """Steps of acceptance and removal so far, passed to the outcome."""
        self._begun = problem.evaluations
        self._looked: dict[frozenset[str], tuple[tuple[float, ...], list[Fit]]] = {}
        """By the labels of a base: the doubt under which it was looked at, and the fits with one claim more."""

    def run(self) -> Outcome:
        """Search; where something remains, search again from other first claims, and keep the best outcome."""
        nothing = fit(self.problem, ())
        restarts = self._ranked(nothing)
        best = self._from(nothing, restarts[:1])
        for opening in restarts[1 : self.settings.restarts]:
            if not noticeable(self.problem, best.fit.residual) or self._spent > self.settings.effort / 3:
                break
            self.progress(f"again from {opening.claims[-1].effect.label}")
            best = self._better(best, self._from(nothing, [opening]))
        self.steps[:] = best.steps
        return best

    def _from(self, nothing: Fit, opening: Sequence[Fit]) -> Outcome:
        """Add what pays most, exchange what others do better, until nothing pays; then drop what is not needed."""
        self.problem.update_weights(())
        self.steps.clear()
        outcome = Outcome(nothing, nothing)
        ranked = list(opening)
        for _ in range(2 * self.settings.most):
            if not ranked:
                if not self._backward(outcome):
                    break
            else:
                self._accept(outcome, ranked[0], "add", ranked[0].claims[-1].effect.label)
            for _ in range(SWAPS):
                if self._spent > self.settings.effort or not self._swap(outcome):
                    break
            more = len(outcome.fit.judged) < self.settings.most and self._spent < self.settings.effort
            ranked = self._ranked(outcome.fit) if more else []
        return outcome

    @property
    def _spent(self) -> int:
        return self.problem.evaluations - self._begun

    def _better(self, one: Outcome, other: Outcome) -> Outcome:
        """The outcome with more evidence, both weighed with the doubt that either of them brings."""
        self.problem.update_weights((*one.fit.claims, *other.fit.claims))
        first, second = (score(self.problem, fit(self.problem, found.fit.claims)) for found in (one, other))
        winner = one if first <= second else other
        self.problem.update_weights(winner.fit.claims)
        return winner

    def _ranked(self, base: Fit) -> list[Fit]:
        """Fits with one claim more that pay, the best first.

        None at all where the best only mends the form of its kin: what others explain of that is mimicry.
        """
        enough = score(self.problem, base) - self.settings.threshold
        better = [one for one in self._extended(base) if score(self.problem, one) <= enough]
        worth = [one for one in better if all_significant(self.problem, one)]
        mends = bool(worth) and form_error(self.problem, base, worth[0], self.settings.form_error)
        return [] if mends else worth

    def _extended(self, base: Fit) -> list[Fit]:
        """Fits with one claim more, the best first; those of a base that was looked at before are only refined."""
        key, doubt = frozenset(claim.effect.label for claim in base.claims), self.problem.doubted
        seen, fits = self._looked.get(key, ((), []))
        if key not in self._looked:
            prospects = screen(self.problem, base, self.library)[: self.settings.shortlist]
            hopeful = [prospect for prospect in prospects if prospect.gain > 0.5 * self.settings.threshold]
            fits = [fit(self.problem, (*base.claims, one.claim), tolerance=SCREEN_TOLERANCE) for one in hopeful]
        elif seen != doubt:
            fits = [fit(self.problem, one.claims, tolerance=SCREEN_TOLERANCE) for one in fits]
        fits = sorted(fits, key=lambda one: score(self.problem, one))
        self._looked[key] = doubt, fits
        return fits

    def _swap(self, outcome: Outcome) -> bool:
        """Try other causes in each claim's place; remember the fits as rivals. Whether any was exchanged."""
        changed = False
        for claim in outcome.fit.judged:
            if claim not in outcome.fit.claims:
                continue
            others = tuple(one for one in outcome.fit.claims if one is not claim)
            if any(claim.effect.id in one.effect.needs for one in others):
                continue
            label = claim.effect.label
            fits = [one for one in self._extended(fit(self.problem, others)) if one.claims[-1].effect.label != label]
            outcome.rivals[label] = fits[:4]
            better = [one for one in fits if self._pays_in_place(one, claim.effect, outcome.fit)]
            if better and all_significant(self.problem, better[0]):
                self._accept(outcome, better[0], "swap", f"{label} -> {better[0].claims[-1].effect.label}")
                changed = True
        return changed

    def _pays_in_place(self, other: Fit, effect: Effect, current: Fit) -> bool:
        """Return whether the newest claim of `other` may take the place of `effect`.

        What it has more of parameters must each be worth the threshold.
        """
        newest = other.claims[-1].effect
        more = len(newest.parameters) - len(effect.parameters)
        toll = self.settings.threshold * max(more, 0)
        return score(self.problem, other) + toll < score(self.problem, current) - SWAP_BIC_MARGIN

    def _backward(self, outcome: Outcome) -> bool:
        changed = False
        while outcome.fit.judged:
            smaller = [
                fit(self.problem, tuple(one for one in outcome.fit.claims if one is not claim))
                for claim in outcome.fit.judged
                if not any(claim.effect.id in one.effect.needs for one in outcome.fit.claims)
            ]
            best = min(smaller, key=lambda one: score(self.problem, one))
            if score(self.problem, best) - score(self.problem, outcome.fit) > self.settings.threshold:
                return changed
            kept = {claim.effect.label for claim in best.claims}
            dropped = [claim.effect.label for claim in outcome.fit.claims if claim.effect.label not in kept]
            self._accept(outcome, best, "drop", dropped[0])
            changed = True
        return changed

    def _accept(self, outcome: Outcome, found: Fit, action: str, label: str) -> None:
        outcome.fit = self._weighed(found)
        outcome.nothing = fit(self.problem, ())
        gained = score(self.problem, outcome.fit) - score(self.problem, outcome.nothing)
        outcome.steps.append(Step(action, label, gained))
        self.steps[:] = outcome.steps
        self.progress(f"{action} {label}")

    def _weighed(self, found: Fit) -> Fit:
        """The fit under the doubt that its own claims bring, which moves with them, until both stand still."""
        for _ in range(MAX_REWEIGHT_ITERATIONS):
            before = pack(found.claims)[1]
            self.problem.update_weights(found.claims)
            found = fit(self.problem, found.claims)
            if np.allclose(pack(found.claims)[1], before, rtol=1e-3, atol=0.0) or not any(self.problem.doubted):
                break
        return found
