# SPDX-License-Identifier: Apache-2.0
"""Choice of the next recording, when the present ones do not separate the hypotheses.

Every reference of a small catalog is simulated on the assumed bench (`hydro_sim.model.plant.AnalyticPlant` with the
box's own force law, without the effects). The criterion is the part of one cause's signature that the other cannot
reproduce with any parameter values: the distance of two fitted models, in BIC.

A bench's physics is never exactly a law of the grammar: for a closure, a second law is a rival even if it gains 10 %
less.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hydro_core.signals import STATE_FIELDS, ReferenceSignal, Waveform
from hydro_diagnosis.closure.evidence import has_identified_shapes
from hydro_diagnosis.closure.screen import Screen
from hydro_diagnosis.effects.closure import is_closure
from hydro_diagnosis.estimation.fit import Fit, fit, jacobian
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import check_recording
from hydro_diagnosis.recording import InputError, Recording
from hydro_diagnosis.significance import VERY_STRONG_EVIDENCE
from hydro_sim.model.bench import Bench
from hydro_sim.model.laws import Law
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

if TYPE_CHECKING:
    from hydro_diagnosis.judge import Assessment
    from hydro_diagnosis.selection.search import SearchOutcome


def simulated_recording(
    bench: Bench, reference: ReferenceSignal, *, gains: tuple[float, float] = (60.0, 10.0), seconds: float = 10.0,
    noise: float = 1.0, seed: int = 0, truth: Bench | None = None,
) -> Recording:  # fmt: skip
    """Simulate a recording under the box's force law.

    `bench`: bench model of the law. `reference`, `gains`, `seconds`: commanded force, (K_p [1/s], K_i [1/s^2]), length.
    `noise`, `seed`: scale and seed of the sensors' noise. `truth`: simulated bench, `bench` by default.
    """
    plant = AnalyticPlant(replace(truth or bench, effects=(), closures=()), noise=noise)
    without_effects = replace(bench, effects=(), closures=())
    states = simulate(plant, without_effects, Schedule(reference=reference, gains=gains, seconds=seconds), seed=seed)
    columns = {name: states[name].copy() for name in STATE_FIELDS}
    return check_recording(RawTable("rehearsal", states["time"].copy(), None, columns), without_effects)


PROPOSED_TIME = 20.0
"""Length [s] of a proposed recording."""


def catalog(bench: Bench) -> list[ReferenceSignal]:
    """Candidate references over the working range; forces scale with the bench's piston area times supply pressure."""
    nominal = Bench.nominal()
    strength = bench.piston_area * bench.supply_pressure / (nominal.piston_area * nominal.supply_pressure)
    of_nominal = []
    for offset in (-120.0, 0.0, 120.0):
        of_nominal += [
            ReferenceSignal(waveform=Waveform.SINE, amplitude=150.0, offset=offset, frequency=0.3),
            ReferenceSignal(waveform=Waveform.MULTISINE, amplitude=170.0, offset=offset, frequency=0.7),
        ]
    of_nominal += [
        ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=2.0),
        ReferenceSignal(waveform=Waveform.SINE, amplitude=40.0, frequency=2.0),
        ReferenceSignal(waveform=Waveform.SMOOTH_STEP, amplitude=260.0, frequency=0.8),
        ReferenceSignal(waveform=Waveform.SMOOTH_STEP, amplitude=60.0, frequency=0.3),
        ReferenceSignal(waveform=Waveform.HOLD, offset=200.0),
    ]
    return [
        replace(one, amplitude=float(f"{strength * one.amplitude:.2g}"), offset=float(f"{strength * one.offset:.2g}"))
        for one in of_nominal
    ]


def next_recording(problem: Problem, outcome: SearchOutcome, assessment: Assessment) -> dict[str, Any] | None:
    """Proposed recording that separates the closest pair of rivals; None if all are distinguished."""
    close = []
    for claim in assessment.fit.claims:
        for rival in outcome.rivals.get(claim.effect.label, []):
            distance, other = rival.score - assessment.fit.score, rival.claims[-1].effect
            if distance < VERY_STRONG_EVIDENCE and other.named and other.id != claim.effect.id:
                close.append((distance, claim.effect.label, rival))
    if not close:
        return None
    _, label, rival = min(close, key=lambda one: one[0])
    names = [label.split(":")[0], rival.claims[-1].effect.id]
    alike = f"{names[0]} and {names[1]} explain these recordings alike"
    return proposal(problem, assessment.fit, rival, names, alike)


def proposal(problem: Problem, claimed: Fit, rival: Fit, names: list[str], alike: str) -> dict[str, Any]:
    """Report entry with the catalog's reference on which two fits differ most; `alike`: their likeness, as a clause."""
    gains = [
        (expected_difference(problem, reference, claimed, rival), reference) for reference in catalog(problem.bench)
    ]
    gain, reference = max(gains, key=lambda one: one[0])
    if gain < VERY_STRONG_EVIDENCE:
        why = f"No reference tells {names[0]} from {names[1]} on this bench: another sensor or a known load would."
        return {"why": why, "separates": names, "reference": None, "expected_gain": gain}
    why = f"{alike}; on this reference they differ most, by {gain**0.5:.3g} standard deviations of the noise."
    proposed = {
        "waveform": reference.waveform.name.lower(), "amplitude": reference.amplitude, "offset": reference.offset,
        "frequency": reference.frequency, "seconds": PROPOSED_TIME,
    }  # fmt: skip
    return {"why": why, "separates": names, "reference": proposed, "expected_gain": gain}


def expected_difference(problem: Problem, reference: ReferenceSignal, claimed: Fit, rival: Fit) -> float:
    """Expected BIC difference between a fit and its rival after `PROPOSED_TIME` seconds of a reference."""
    seconds = 10.0
    try:
        recording = simulated_recording(problem.bench, reference, seconds=seconds)
    except InputError:
        return 0.0
    rehearsed = Problem(recording.segments, problem.bench, problem.baseline)
    mimicked = rehearsed.residual(rival.claims)
    apart = rehearsed.residual(claimed.claims) - mimicked
    columns = jacobian(rehearsed, rival.claims, mimicked)
    lengths = np.linalg.norm(columns, axis=0)
    basis = np.linalg.qr(columns[:, lengths > 0.0] / lengths[lengths > 0.0])[0]
    left = apart - basis @ (basis.T @ apart)
    return float(left @ left) * PROPOSED_TIME / seconds


def next_for_law(problem: Problem, found: Fit, screen: Screen | None = None) -> dict[str, Any] | None:
    """Proposed recording that separates the most significant law of a fit from a rival; None without either."""
    fits = {
        k: fit(problem, found.claims_without(claim))
        for k, claim in enumerate(found.claims)
        if is_closure(claim.effect) and isinstance(claim.effect.law, Law)
    }
    if not fits:
        return None
    place = max(fits, key=lambda k: fits[k].deviance)
    without, own = fits[place], found.claims[place].effect.label
    candidates, _possible_gain = (screen or Screen(problem, without)).best_laws(without, 3, {own})
    enough = 0.9 * (without.deviance - found.deviance)
    for candidate in candidates:  # with the next best law, as the last claim, in the place of this one
        starts = (fit(problem, (*without.claims, start)) for start in candidate.starts)
        rival = min(starts, key=lambda one: one.deviance)
        gained = without.deviance - rival.deviance
        if gained >= enough and has_identified_shapes(problem, rival, rival.claims[-1]):
            break
    else:
        return None
    share = gained / (without.deviance - found.deviance)
    names = []
    for claim in (found.claims[place], rival.claims[-1]):
        assert is_closure(claim.effect)
        names.append(f"{claim.effect.law.form} ({claim.effect.law.equation})")
    alike = f"{names[1]} explains {100.0 * min(share, 1.0):.3g} % of what {names[0]} explains of these recordings"
    return proposal(problem, found, rival, names, alike)
