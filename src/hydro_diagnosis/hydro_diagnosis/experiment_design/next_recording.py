# SPDX-License-Identifier: Apache-2.0
"""Choice of the next recording, when the present ones do not separate the hypotheses.

Every reference of a small catalog is rehearsed on the believed bench. What matters is how much of one cause's
signature the other cannot mimic by any values of its parameters: the distance of two fitted models, in BIC.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from hydro_bridge.signals import ReferenceSignal, Waveform
from hydro_diagnosis.estimation.fit import Fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.slopes import jacobian
from hydro_diagnosis.experiment_design.synthetic_recording import rehearsal
from hydro_diagnosis.io.table import InputError
from hydro_diagnosis.selection.effect_summary import CLOSE
from hydro_diagnosis.selection.outcome import Outcome, score
from hydro_diagnosis.selection.verdict import Assessment

SECONDS = 10.0
"""Length of a rehearsal; the proposal is for `PROPOSED`."""
PROPOSED = 20.0


def catalog() -> Iterator[ReferenceSignal]:
    """References that the box can run, over the working range."""
    for offset in (-120.0, 0.0, 120.0):
        yield ReferenceSignal(waveform=Waveform.SINE, amplitude=150.0, offset=offset, frequency=0.3)
        yield ReferenceSignal(waveform=Waveform.MULTISINE, amplitude=170.0, offset=offset, frequency=0.7)
    yield ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=2.0)
    yield ReferenceSignal(waveform=Waveform.SINE, amplitude=40.0, frequency=2.0)
    yield ReferenceSignal(waveform=Waveform.SMOOTH_STEP, amplitude=260.0, frequency=0.8)
    yield ReferenceSignal(waveform=Waveform.SMOOTH_STEP, amplitude=60.0, frequency=0.3)
    yield ReferenceSignal(waveform=Waveform.HOLD, offset=200.0)


def next_recording(problem: Problem, outcome: Outcome, assessment: Assessment) -> dict[str, Any] | None:
    """The recording that separates the closest pair of rivals; None if all are distinguished."""
    pair = _closest(problem, outcome, assessment)
    if pair is None:
        return None
    label, rival = pair
    names = [label.split(":")[0], rival.claims[-1].effect.id]
    alike = f"{names[0]} and {names[1]} explain these recordings alike"
    return proposal(problem, assessment.fit, rival, names, alike)


def proposal(problem: Problem, claimed: Fit, rival: Fit, names: list[str], alike: str) -> dict[str, Any]:
    """The reference of the catalog on which two fits differ most; `alike`: how near they are, without a full stop."""
    gains = [(expected_gain(problem, reference, claimed, rival), reference) for reference in catalog()]
    gain, reference = max(gains, key=lambda one: one[0])
    if gain < CLOSE:
        why = f"No reference tells {names[0]} from {names[1]} on this bench: another sensor or a known load would."
        return {"why": why, "separates": names, "reference": None, "expected_gain": gain}
    why = f"{alike}; on this reference they differ most, by {gain**0.5:.3g} standard deviations of the noise."
    return {"why": why, "separates": names, "reference": _as_mapping(reference), "expected_gain": gain}


def expected_gain(problem: Problem, reference: ReferenceSignal, claimed: Fit, rival: Fit) -> float:
    """BIC by which `PROPOSED` seconds of a reference would tell a fit from a rival to it."""
    try:
        recording = rehearsal(problem.bench, reference, seconds=SECONDS)
    except InputError:
        return 0.0
    rehearsed = Problem(recording.segments, problem.bench, problem.baseline)
    mimicked = rehearsed.residual(rival.claims)
    apart = rehearsed.residual(claimed.claims) - mimicked
    columns = jacobian(rehearsed, rival.claims, mimicked)
    lengths = np.linalg.norm(columns, axis=0)
    basis = np.linalg.qr(columns[:, lengths > 0.0] / lengths[lengths > 0.0])[0]
    left = apart - basis @ (basis.T @ apart)
    return float(left @ left) * PROPOSED / SECONDS


def _closest(problem: Problem, outcome: Outcome, assessment: Assessment) -> tuple[str, Fit] | None:
    close = []
    for claim in assessment.fit.claims:
        for rival in outcome.rivals.get(claim.effect.label, []):
            distance = score(problem, rival) - score(problem, assessment.fit)
            other = rival.claims[-1].effect
            if distance < CLOSE and other.named and other.id != claim.effect.id:
                close.append((distance, claim.effect.label, rival))
    if not close:
        return None
    _, label, rival = min(close, key=lambda one: one[0])
    return label, rival


def _as_mapping(reference: ReferenceSignal) -> dict[str, Any]:
    return {
        "waveform": reference.waveform.name.lower(),
        "amplitude": reference.amplitude,
        "offset": reference.offset,
        "frequency": reference.frequency,
        "seconds": PROPOSED,
    }
