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

from hydro_diagnosis.effects.base import Claim, Effect, Parameter
from hydro_diagnosis.fit import Fit, fit, pack
from hydro_diagnosis.locate import noticeable
from hydro_diagnosis.problem import Problem
from hydro_diagnosis.screen import cause, screen

SKETCHED = 1.0
"""Gain in deviance below which a candidate's fit is good enough to be ranked by."""
SWAPS = 3
"""Rounds of exchanging causes at most, after each claim."""
RIPENING = 6
"""Rounds of weighing and fitting at most."""


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
    openings: int = 3
    """First claims that are tried, one search each, as long as something remains unexplained, [1, 10]."""
    effort: int = 9000
    """Evaluations of all residuals after which no further claim is looked for, and a third of which may go before the
    search begins again: some 4 ms each for 60 s of data, [100, 1000000]."""


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
        self._begun = problem.evaluations
        self._looked: dict[frozenset[str], tuple[tuple[float, ...], list[Fit]]] = {}
        """By the labels of a base: the doubt under which it was looked at, and the fits with one claim more."""

    def run(self) -> Outcome:
        """Search; where something remains, search again from other first claims, and keep the best outcome."""
        nothing = fit(self.problem, ())
        openings = self._ranked(nothing)
        best = self._from(nothing, openings[:1])
        for opening in openings[1 : self.settings.openings]:
            if not noticeable(self.problem, best.fit.residual) or self._spent > self.settings.effort / 3:
                break
            self.progress(f"again from {opening.claims[0].effect.label}")
            best = self._better(best, self._from(nothing, [opening]))
        self.steps[:] = best.steps
        return best

    def _from(self, nothing: Fit, opening: Sequence[Fit]) -> Outcome:
        """Add what pays most, exchange what others do better, until nothing pays; then drop what is not needed."""
        self.problem.set_doubt(())
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
            more = len(outcome.fit.claims) < self.settings.most and self._spent < self.settings.effort
            ranked = self._ranked(outcome.fit) if more else []
        return outcome

    @property
    def _spent(self) -> int:
        return self.problem.evaluations - self._begun

    def _better(self, one: Outcome, other: Outcome) -> Outcome:
        """The outcome with more evidence, both weighed with the doubt that either of them brings."""
        self.problem.set_doubt((*one.fit.claims, *other.fit.claims))
        first, second = (score(self.problem, fit(self.problem, found.fit.claims)) for found in (one, other))
        winner = one if first <= second else other
        self.problem.set_doubt(winner.fit.claims)
        return winner

    def _ranked(self, base: Fit) -> list[Fit]:
        """Fits with one claim more that pay, the best first.

        None at all where the best only mends the form of its kin: what others explain of that is mimicry.
        """
        enough = score(self.problem, base) - self.settings.threshold
        worth = [one for one in self._extended(base) if score(self.problem, one) <= enough and self._worth(one)]
        return [] if worth and self._form_error(base, worth[0]) else worth

    def _extended(self, base: Fit) -> list[Fit]:
        """Fits with one claim more, the best first; those of a base that was looked at before are only refined."""
        key, doubt = frozenset(claim.effect.label for claim in base.claims), self.problem.doubted
        seen, fits = self._looked.get(key, ((), []))
        if key not in self._looked:
            prospects = screen(self.problem, base, self.library)[: self.settings.shortlist]
            hopeful = [prospect for prospect in prospects if prospect.gain > 0.5 * self.settings.threshold]
            fits = [fit(self.problem, (*base.claims, one.claim), tolerance=SKETCHED) for one in hopeful]
        elif seen != doubt:
            fits = [fit(self.problem, one.claims, tolerance=SKETCHED) for one in fits]
        fits = sorted(fits, key=lambda one: score(self.problem, one))
        self._looked[key] = doubt, fits
        return fits

    def _swap(self, outcome: Outcome) -> bool:
        """Try other causes in each claim's place; remember the fits as rivals. Whether any was exchanged."""
        changed = False
        for claim in outcome.fit.claims:
            if claim not in outcome.fit.claims:
                continue
            others = tuple(one for one in outcome.fit.claims if one is not claim)
            if any(claim.effect.id in one.effect.needs for one in others):
                continue
            label = claim.effect.label
            fits = [one for one in self._extended(fit(self.problem, others)) if one.claims[-1].effect.label != label]
            outcome.rivals[label] = fits[:4]
            better = [one for one in fits if score(self.problem, one) < score(self.problem, outcome.fit) - 2.0]
            if better and self._worth(better[0]):
                self._accept(outcome, better[0], "swap", f"{label} -> {better[0].claims[-1].effect.label}")
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
        outcome.fit = self._weighed(found)
        outcome.nothing = fit(self.problem, ())
        gained = score(self.problem, outcome.fit) - score(self.problem, outcome.nothing)
        outcome.steps.append(Step(action, label, gained))
        self.steps[:] = outcome.steps
        self.progress(f"{action} {label}")

    def _weighed(self, found: Fit) -> Fit:
        """The fit under the doubt that its own claims bring, which moves with them, until both stand still."""
        for _ in range(RIPENING):
            before = pack(found.claims)[1]
            self.problem.set_doubt(found.claims)
            found = fit(self.problem, found.claims)
            if np.allclose(pack(found.claims)[1], before, rtol=1e-3, atol=0.0) or not any(self.problem.doubted):
                break
        return found

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
    """Whether any of a claim's amplitudes is beyond its smallest size, and none where physics ends."""
    amplitudes = [one for one in claim.effect.parameters if one.smallest > 0.0]
    if any(_at_its_end(one, claim.values[one.name]) for one in amplitudes):
        return False
    return not amplitudes or any(abs(claim.values[one.name] - one.neutral) >= one.smallest for one in amplitudes)


def _at_its_end(parameter: Parameter, value: float) -> bool:
    """Whether a value stands at a bound that is not its neutral value."""
    near = 1e-3 * parameter.smallest
    return any(abs(value - end) <= near < abs(end - parameter.neutral) for end in (parameter.low, parameter.high))


__all__ = ["Outcome", "Search", "SearchSettings", "Step", "cause", "score", "worth_claiming"]
