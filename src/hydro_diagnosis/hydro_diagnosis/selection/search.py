# SPDX-License-Identifier: Apache-2.0
"""Stepwise search for the causes that jointly explain the recordings: forward and swap steps by evidence.

Evidence is the Bayesian information criterion on the deviance of `fit`: a claim must gain more than ln(n) per
parameter plus a threshold; a cause that replaces another must, for each additional parameter.
`benchmarks.null_simulations` measures the evidence that chance alone reaches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from hydro_diagnosis.effects.base import CHANNELS, Effect
from hydro_diagnosis.estimation.budget import SEARCH_SHARE
from hydro_diagnosis.estimation.fit import (
    FORM_ERROR_SHARE,
    Candidate,
    Fit,
    Signatures,
    add_claim,
    fit,
    pack,
    rank_candidates,
    rank_pairs,
    remove_claim,
)
from hydro_diagnosis.estimation.intervals import all_significant
from hydro_diagnosis.significance import (
    CLAIM_THRESHOLD,
    COVERAGE_FACTOR,
    ITERATIONS,
    PRACTICAL_SHARE,
    VERY_STRONG_EVIDENCE,
)

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.problem import Problem


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """Settings of a search: its effort, and the thresholds of claims."""

    threshold: float = CLAIM_THRESHOLD
    """Evidence in units of BIC that a claim needs beyond its parameters' price."""
    max_claims: int = 12
    """Largest number of claims."""
    effort: int = 9000
    """Evaluations of all residuals after which the search ends: some 3 ms each for 60 s of data."""


@dataclass(frozen=True)
class Step:
    """One step of the search, for the plot of its convergence: action, label of the cause, BIC against no claims."""

    action: str
    label: str
    score: float


@dataclass
class SearchOutcome:
    """Result of a search."""

    problem: Problem
    """The problem with the weights of the fit."""
    fit: Fit
    baseline_fit: Fit
    steps: list[Step] = field(default_factory=list)
    rivals: dict[str, list[Fit]] = field(default_factory=dict)
    """Fits with another cause in place of a claim, by the claim's label, best first."""
    stop_reason: str = ""
    """Reason in words if the search stopped while further claims might gain enough; else empty."""


SCREEN_TOLERANCE = 1.0
"""Tolerance [deviance] of the fits of candidates, which serve to rank them."""
REFIT_TOLERANCE = 1e-3
"""Relative change of the residuals' uncertainty, or of the claims' values, below which fits are not repeated."""


@dataclass
class _Screened:
    """Screened candidates for a further claim on one base fit."""

    doubt: tuple[float, ...]
    """`Problem.uncertainty` at the time of the screening."""
    waiting: list[Candidate]
    """Candidates that are not fitted yet."""
    fits: list[Fit] = field(default_factory=list)
    """Fits with one claim more than the base."""
    refitted: set[str] = field(default_factory=set)
    """Labels of the candidates that are fitted in full, not by secants."""


def _labels(base: Fit) -> frozenset[str]:
    return frozenset(claim.effect.label for claim in base.claims)


class Shortlists:
    """Shortlists of candidates for a further claim, one for each base fit that they extend."""

    def __init__(self, library: Sequence[Effect], settings: SearchSettings) -> None:
        self._library, self._settings = library, settings
        self._screened: dict[frozenset[str], _Screened] = {}
        """Screened candidates by the labels of the base's claims."""
        self.signatures: Signatures = {}
        """Cached signatures of the candidates; cleared at each further claim, to be computed again."""

    def extensions(self, problem: Problem, base: Fit, promised: float, but: str = "") -> list[Fit]:
        """Return the fits with one claim more than a base, best first: in full, or by secants from its Jacobian.

        `promised`: least first-order gain of the candidates fitted now; the others wait. `but`: excluded label.
        """
        screened = self._screened.get(_labels(base))
        if screened is None:
            candidates = rank_candidates(problem, base, self._library, self.signatures)[:7]  # the most promising ones
            hopeful = [candidate for candidate in candidates if candidate.gain > 0.5 * self._settings.threshold]
            screened = self._screened[_labels(base)] = _Screened(problem.uncertainty, hopeful)
        elif not np.allclose(screened.doubt, problem.uncertainty, rtol=REFIT_TOLERANCE, atol=0.0):
            again = [Candidate(one.claims[-1], np.inf) for one in screened.fits]
            screened = self._screened[_labels(base)] = _Screened(problem.uncertainty, [*again, *screened.waiting])
        now = [one for one in screened.waiting if one.gain >= promised and one.claim.effect.label != but]
        screened.waiting = [one for one in screened.waiting if one not in now]
        screened.fits += [add_claim(problem, base, one.claim, tolerance=SCREEN_TOLERANCE) for one in now]
        screened.fits.sort(key=lambda one: one.score)
        return [one for one in screened.fits if one.claims[-1].effect.label != but]

    def refit(self, problem: Problem, base: Fit, enough: float, most: int = 1000, kin: str = "") -> None:
        """Fit in full the extensions of a base that score `enough` or less, among the best `most`.

        `kin`: family that is fitted in full whatever its score: secants do not converge on a spool's two parameters.
        """
        screened = self._screened[_labels(base)]
        for k, one in enumerate(screened.fits[:most]):
            newest = one.claims[-1].effect
            label = newest.label
            if label not in screened.refitted and (one.score <= enough or (kin and newest.family == kin)):
                screened.fits[k] = fit(problem, one.claims, tolerance=SCREEN_TOLERANCE)
                screened.refitted.add(label)
        screened.fits.sort(key=lambda one: one.score)


MAX_REFITS = 3
"""Largest number of candidates for a further claim that are fitted in full; the others by secants."""
REFIT_MARGIN = 0.3
"""Share of the best gain by which a candidate's secant fit may fall short and the candidate still be fitted in full;
also the share of a claim's gain that a candidate must promise to first order to be tried at once as its replacement.
"""


class Search:
    """Search over one problem; `given`: whether bench parameters to be estimated start at a bench file's values."""

    def __init__(
        self,
        problem: Problem,
        library: Sequence[Effect],
        settings: SearchSettings | None = None,
        progress: Callable[[str], None] = lambda text: None,
        *,
        given: bool = False,
    ) -> None:
        self.problem = problem
        self.given = given
        self.library = tuple(library)
        self.settings = settings or SearchSettings()
        self.progress = progress
        self.steps: list[Step] = []
        """Steps of the search so far: additions and swaps."""
        self._begun = problem.budget.evaluations
        self._passed_over = False
        """Whether a candidate was skipped that may only correct a form error of its family."""
        self._unguarded = False
        """Whether such candidates are accepted."""
        self._shortlists = Shortlists(self.library, self.settings)

    def run(self) -> SearchOutcome:
        """Run the search and return its outcome."""
        if self.problem.estimated and self.given:
            if beside := self._with_given_numbers():
                return beside
            self._begun = self.problem.budget.evaluations
        return self._from(fit(self.problem, ()))

    def baseline_outcome(self) -> SearchOutcome:
        """Return the outcome without claims."""
        problem = self.problem.reweighted(())
        baseline_fit = fit(problem, ())
        return SearchOutcome(problem, baseline_fit, baseline_fit)

    def _with_given_numbers(self) -> SearchOutcome | None:
        """Return the outcome of a search at the given bench parameters, then estimated jointly with its claims.

        None where something remains: without causes not found yet, a parameter would leave its given value.
        """
        outcome = Search(self.problem.with_estimated(()), self.library, self.settings, self.progress).run()
        if outcome.problem.has_excess(outcome.fit.residual) and not self.problem.budget.exceeds(SEARCH_SHARE):
            return None
        most = outcome.fit.score + VERY_STRONG_EVIDENCE * self.settings.threshold
        sizes = {claim.effect.label: claim.values for claim in outcome.fit.claims}
        numbers = [replace(one, values=sizes.pop(one.effect.label, one.values)) for one in self.problem.estimated]
        others = [claim for claim in outcome.fit.claims if claim.effect.label in sizes]
        outcome.problem, outcome.fit = self._weighed(fit(self.problem, (*numbers, *others)))
        outcome.baseline_fit = fit(outcome.problem, ())
        names = {one.effect.label for one in numbers}
        for label, fits in outcome.rivals.items():
            near = [one for one in fits if one.score < most and not names & _labels(one)]
            outcome.rivals[label] = [fit(outcome.problem, (*numbers, *one.claims)) for one in near]
        self.steps[:] = outcome.steps
        return outcome

    def _from(self, baseline_fit: Fit) -> SearchOutcome:
        """Add the best candidates, and swap claims for better ones, until no step gains enough.

        Where something remains, candidates that may only correct a form error of their family join too, but only if in
        the end nothing remains.
        """
        self.steps.clear()
        self._unguarded = self._passed_over = False
        outcome = self._common_to_edges(
            self._grown(SearchOutcome(self.problem.reweighted(()), baseline_fit, baseline_fit))
        )
        if self._passed_over and outcome.problem.has_excess(outcome.fit.residual):
            self._unguarded = True
            whole = self._grown(replace(outcome, steps=[*outcome.steps], rivals={**outcome.rivals}))
            if not whole.problem.has_excess(whole.fit.residual):
                return whole
            self.steps[:] = outcome.steps
        return outcome

    def _common_to_edges(self, outcome: SearchOutcome) -> SearchOutcome:
        """The outcome with causes common to the valve's edges in place of several single ones, if as likely."""
        single = [claim for claim in outcome.fit.cause_claims if claim.effect.physics.edge]
        if len(single) < 2 or self._exhausted:
            return outcome
        others = fit(outcome.problem, [claim for claim in outcome.fit.claims if claim not in single])
        library = [effect for effect in self.library if not effect.physics.edge]
        settings = replace(self.settings, max_claims=len(outcome.fit.cause_claims))
        common = Search(self.problem, library, settings, self.progress)._grown(
            SearchOutcome(outcome.problem, others, outcome.baseline_fit)
        )
        return common if common.fit.score <= outcome.fit.score else outcome

    def _grown(self, outcome: SearchOutcome) -> SearchOutcome:
        """The outcome with further claims."""
        self._shortlists.signatures.clear()
        ranked = self._ranked(outcome.problem, outcome.fit)
        for _ in range(2 * self.settings.max_claims):
            if ranked:
                self._accept(outcome, ranked[0], "add", ranked[0].claims[-1].effect.label)
            elif self._exhausted or not self._swap(outcome, 0.0):
                break
            for _ in range(ITERATIONS):
                if self._exhausted or not self._swap(outcome, REFIT_MARGIN):
                    break
            if len(outcome.fit.cause_claims) == 2 and outcome.problem.has_excess(outcome.fit.residual):
                self._swap_both(outcome)
            ranked = self._further(outcome)
        return outcome

    def _further(self, outcome: SearchOutcome) -> list[Fit]:
        """Return candidates for a further claim; none if the search must end (`SearchOutcome.stop_reason` says why)."""
        if self._exhausted:
            effort = f"its effort of {self.settings.effort} evaluations"
            spent = self.problem.budget.exceeds(SEARCH_SHARE)
            outcome.stop_reason = f"{'its part of the budget of work' if spent else effort} was spent"
            return []
        ranked = self._ranked(outcome.problem, outcome.fit)
        if ranked and len(outcome.fit.cause_claims) >= self.settings.max_claims:
            outcome.stop_reason = f"it looks for {self.settings.max_claims} causes at most"
            return []
        outcome.stop_reason = ""
        return ranked

    @property
    def _exhausted(self) -> bool:
        spent = self.problem.budget.evaluations - self._begun
        return spent > self.settings.effort or self.problem.budget.exceeds(SEARCH_SHARE)

    def _ranked(self, problem: Problem, base: Fit) -> list[Fit]:
        """Fits with one claim more that gain enough, the best first.

        Where the best may only correct a form error of its family, so may others there: then those that act elsewhere.
        """
        enough = base.score - self.settings.threshold
        self._shortlists.signatures.clear()
        fits = self._shortlists.extensions(problem, base, 0.0)
        if fits:
            best = fits[0].score
            self._shortlists.refit(problem, base, best + REFIT_MARGIN * (base.score - best), MAX_REFITS)
        better = [one for one in self._shortlists.extensions(problem, base, 0.0) if one.score <= enough]
        evidence = [one for one in better if all_significant(problem, one)]
        if self._unguarded or not evidence or not form_error(problem, base, evidence[0]):
            return evidence
        if not self._completed(problem, base, evidence[0]):
            self._passed_over = True
            evidence = [one for one in evidence[1:] if acts_in_other_channels(problem, base, evidence[0], one)]
        return evidence

    def _completed(self, problem: Problem, base: Fit, found: Fit) -> bool:
        """Whether `found` and one claim more leave only noise in a channel in which that claim alone leaves more."""
        enough = found.score - self.settings.threshold
        self._shortlists.extensions(problem, found, 0.0)
        self._shortlists.refit(problem, found, enough, MAX_REFITS)
        for pair in self._shortlists.extensions(problem, found, 0.0)[:MAX_REFITS]:
            clean = problem.excess_channels(base.residual).keys() - problem.excess_channels(pair.residual).keys()
            if clean and clean & problem.excess_channels(fit(problem, (*base.claims, pair.claims[-1])).residual).keys():
                return True
        return False

    def _swap(self, outcome: SearchOutcome, promising: float) -> bool:
        """Try to swap each claim for another cause, store the fits as rivals; return whether any was swapped.

        `promising`: share of a claim's gain that a candidate must promise to be tried.
        """
        changed = False
        for claim in outcome.fit.cause_claims:
            problem = outcome.problem
            if claim not in outcome.fit.removable:
                continue
            label, base = claim.effect.label, remove_claim(problem, outcome.fit, claim)
            present = outcome.fit.score
            evidence = max(base.score - present, 0.0)
            self._shortlists.extensions(problem, base, promising * evidence, label)
            self._shortlists.refit(problem, base, present + REFIT_MARGIN * evidence, kin=claim.effect.family)
            fits = self._shortlists.extensions(problem, base, promising * evidence, label)
            outcome.rivals[label] = fits[:4]
            better = []
            for one in fits:  # each parameter more than the claim has must be worth the threshold
                more = len(one.claims[-1].effect.parameters) - len(claim.effect.parameters)
                if one.score + self.settings.threshold * max(more, 0) < present - COVERAGE_FACTOR * SCREEN_TOLERANCE:
                    better.append(one)
            if better and all_significant(problem, better[0]):
                self._accept(outcome, better[0], "swap", f"{label} -> {better[0].claims[-1].effect.label}")
                changed = True
        return changed

    def _swap_both(self, outcome: SearchOutcome) -> None:
        """Put the best pair of causes in place of the two claims if it is more likely.

        Step by step a pair is passed over whose causes explain little alone: a valve's null and gain beside its leak.
        """
        problem, base = outcome.problem, outcome.baseline_fit
        pairs = rank_pairs(problem, base, rank_candidates(problem, base, self.library))[:MAX_REFITS]
        best = min((fit(problem, (*base.claims, *pair)) for pair in pairs), key=lambda one: one.score, default=base)
        if best.score < outcome.fit.score - self.settings.threshold and all_significant(problem, best):
            labels = (" + ".join(claim.effect.label for claim in one.cause_claims) for one in (outcome.fit, best))
            self._accept(outcome, best, "swap", " -> ".join(labels))

    def _accept(self, outcome: SearchOutcome, found: Fit, action: str, label: str) -> None:
        outcome.problem, outcome.fit = self._weighed(found)
        outcome.baseline_fit = fit(outcome.problem, ())
        gained = outcome.fit.score - outcome.baseline_fit.score
        outcome.steps.append(Step(action, label, gained))
        self.steps[:] = outcome.steps
        self.progress(f"{action} {label}")

    def _weighed(self, found: Fit) -> tuple[Problem, Fit]:
        """Problem and fit under the uncertainty of the fit's own claims, iterated until they converge."""
        for _ in range(ITERATIONS):
            before = pack(found.claims)[1]
            problem = self.problem.reweighted(found.claims)
            found = fit(problem, found.claims)
            stands = np.allclose(pack(found.claims)[1], before, rtol=REFIT_TOLERANCE, atol=0.0)
            if stands or not any(problem.uncertainty):
                break
        return problem, found


def form_error(problem: Problem, base: Fit, found: Fit) -> bool:
    """Return whether the newest claim explains no more than a form error of a claim of its family might.

    False where something remains without it and nothing with it: a wrong form leaves a remainder with any name.
    """
    if problem.has_excess(base.residual) and not problem.has_excess(found.residual):
        return False
    newest = found.claims[-1].effect
    kin = [claim for claim in base.cause_claims if newest.family and claim.effect.family == newest.family]
    for claim in kin:
        if claim.effect.id in newest.needs:
            continue
        without = problem.residual(tuple(one for one in found.claims[:-1] if one.effect is not claim.effect))
        signature = float(np.sum(np.square(without - problem.residual(found.claims[:-1]))))
        added = float(np.sum(np.square(base.residual)) - np.sum(np.square(found.residual)))
        if added < FORM_ERROR_SHARE**2 * signature:
            return True
    return False


def acts_in_other_channels(problem: Problem, base: Fit, mended: Fit, other: Fit) -> bool:
    """Return whether the newest claim of `other` acts in channels in which that of `mended` removes little."""
    before, one, two = (problem.mean_squares(each.residual) for each in (base, mended, other))
    counts = dict(zip(CHANNELS, problem.layout.count, strict=True))
    removed = {name: max(before[name] - two[name], 0.0) * counts[name] for name in before}
    little = 2.0 * PRACTICAL_SHARE
    shared = sum(
        part for name, part in removed.items() if before[name] - one[name] > little * (before[name] - two[name])
    )
    return shared < little * sum(removed.values())
