# SPDX-License-Identifier: Apache-2.0
"""Which causes together account for the recordings: forward, backward and swap steps by evidence.

Evidence is the Bayesian information criterion on the deviance of `fit`: a claim must gain more than ln(n) per
parameter plus a threshold. What chance alone reaches, `calibrate` finds by running this whole search on recordings in
which nothing is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydro_diagnosis.effects.base import Claim, Effect
from hydro_diagnosis.fit import Fit, fit
from hydro_diagnosis.problem import Problem
from hydro_diagnosis.screen import Prospect, cause, screen


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """How hard to look and when to claim."""

    threshold: float = 20.0
    """Evidence in units of BIC that a claim needs beyond its parameters' price, [0, 1000].

    A choice, held against recordings with nothing missing; `calibrate` measures what such recordings reach.
    """
    most: int = 6
    """Claims at most."""
    shortlist: int = 7
    """Prospects that are fitted in full at each step."""
    form_error: float = 0.035
    """Share of a claim's signature that its form may be off by: another of its family must explain more, [0, 1]."""


@dataclass(frozen=True)
class Step:
    """One step of the search, for the plot of how evidence converged."""

    action: str
    label: str
    score: float


@dataclass
class Outcome:
    """What the search found."""

    fit: Fit
    nothing: Fit
    steps: list[Step] = field(default_factory=list)
    rivals: dict[str, list[Fit]] = field(default_factory=dict)
    """By a claim's label: fits in which another cause stands in its place, best first."""


def score(problem: Problem, found: Fit) -> float:
    """Deviance plus price: lower is better."""
    return found.deviance + found.free * float(np.log(len(found.residual)))


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
        """What was accepted and dropped so far; those of the outcome."""

    def run(self) -> Outcome:
        """Forward until nothing more pays, then swaps and drops until nothing changes."""
        nothing = fit(self.problem, ())
        outcome = Outcome(nothing, nothing, self.steps)
        for _ in range(3):
            self._forward(outcome)
            if not (self._swap(outcome) | self._backward(outcome)):
                break
        return outcome

    def _forward(self, outcome: Outcome) -> None:
        while len(outcome.fit.claims) < self.settings.most:
            best = self._best(outcome.fit, screen(self.problem, outcome.fit, self.library))
            if best is None:
                return
            gain = score(self.problem, outcome.fit) - score(self.problem, best)
            if gain < self.settings.threshold or not self._worth(best) or self._form_error(outcome.fit, best):
                return
            self._accept(outcome, best, "add", best.claims[-1].effect.label)

    def _best(self, base: Fit, prospects: Sequence[Prospect]) -> Fit | None:
        fits = []
        for prospect in prospects[: self.settings.shortlist]:
            if prospect.gain <= 0.5 * self.settings.threshold:
                break
            fits.append(fit(self.problem, (*base.claims, prospect.claim)))
        return min(fits, key=lambda one: score(self.problem, one), default=None)

    def _swap(self, outcome: Outcome) -> bool:
        """Try another cause in each claim's place; remember the fits as rivals."""
        changed = False
        for claim in outcome.fit.claims:
            if claim not in outcome.fit.claims:
                continue
            others = tuple(one for one in outcome.fit.claims if one is not claim)
            if any(claim.effect.id in one.effect.needs for one in others):
                continue
            without = fit(self.problem, others)
            prospects = [
                p for p in screen(self.problem, without, self.library) if p.claim.effect.label != claim.effect.label
            ]
            fits = [fit(self.problem, (*without.claims, p.claim)) for p in prospects[:4] if p.gain > 0.0]
            fits.sort(key=lambda one: score(self.problem, one))
            outcome.rivals[claim.effect.label] = fits
            better = [one for one in fits if score(self.problem, one) < score(self.problem, outcome.fit) - 2.0]
            if better and self._worth(better[0]):
                self._accept(outcome, better[0], "swap", f"{claim.effect.label} -> {better[0].claims[-1].effect.label}")
                changed = True
        return changed

    def _backward(self, outcome: Outcome) -> bool:
        changed = False
        while outcome.fit.claims:
            smaller = [
                fit(self.problem, tuple(one for one in outcome.fit.claims if one is not claim))
                for claim in outcome.fit.claims
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
        self.problem.set_doubt(found.claims)
        outcome.nothing = fit(self.problem, ())
        outcome.fit = fit(self.problem, found.claims)
        outcome.steps.append(
            Step(action, label, score(self.problem, outcome.fit) - score(self.problem, outcome.nothing))
        )
        self.progress(f"{action} {label}")

    def _form_error(self, base: Fit, found: Fit) -> bool:
        """Whether the newest claim explains no more than a small error in the form of its kin would."""
        newest = found.claims[-1].effect
        kin = [claim for claim in base.claims if newest.family and claim.effect.family == newest.family]
        for claim in kin:
            if claim.effect.id in newest.needs:
                continue
            without = self.problem.residual(tuple(one for one in found.claims[:-1] if one.effect is not claim.effect))
            signature = float(np.sum(np.square(without - self.problem.residual(found.claims[:-1]))))
            added = float(np.sum(np.square(base.residual)) - np.sum(np.square(found.residual)))
            if added < self.settings.form_error**2 * signature:
                return True
        return False

    @staticmethod
    def _worth(found: Fit) -> bool:
        """Every claim is larger than the smallest size worth claiming."""
        return all(worth_claiming(claim) for claim in found.claims)


def worth_claiming(claim: Claim) -> bool:
    """Whether any of a claim's amplitudes is beyond its smallest size."""
    amplitudes = [one for one in claim.effect.parameters if one.smallest > 0.0]
    return not amplitudes or any(abs(claim.values[one.name] - one.neutral) >= one.smallest for one in amplitudes)


__all__ = ["Outcome", "Search", "SearchSettings", "Step", "cause", "score", "worth_claiming"]
