# SPDX-License-Identifier: Apache-2.0
"""Mistakes of wiring that would explain a mismatch, judged by the model on all recordings together.

Each repair is done to the recordings, and what the same claims then leave is compared. That is a suspicion, no more:
a cause of the table may leave even less (`stages.hypotheses`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.estimation.layout import CHANNELS
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.partial_bench import knows
from hydro_diagnosis.recording import MEASURED, Segment
from hydro_diagnosis.wiring.repairs import Advance, Exchange, Repair, Scale, in_unit, reversed_sign

CLEAR = float(np.log(10.0))
"""Log of the factor, over all channels, by which a repair must reduce what is left: more than any chance."""
ALIKE = float(np.log(1.1))
"""Log of the factor within which two readings leave the same."""
UNJUDGED = 100.0
"""Price of a sample that a hypothesis does not judge, in noise variances: it is left if it is not known better."""
MOST = 4
"""Largest number of simultaneous mistakes."""
STEP = 0.02
"""s by which a channel is moved to see which way it is late."""
REACH = 0.15
"""s, the longest delay that is looked for."""
DOWNHILL = 5
"""Parabolas at most on the way to a delay."""
PHYSICS = {
    "valve_current": (-0.02, 0.0),
    "piston_position": (-0.01, 0.02),
    "load_force": (-0.01, 0.06),
    "hydraulic_force": (-0.02, 0.02),
    "pressure_a": (-0.02, 0.02),
    "pressure_b": (-0.02, 0.02),
}
"""s by which a channel may be late (negative: early) because of valve, play or an amplifier: causes, no mistakes."""


Left = dict[str, tuple[float, float]]
"""By channel: sum of the squares that are left, over the noise's, and how many they are."""


def left(problem: Problem, claims: Sequence[Claim]) -> Left:
    """What claims leave."""
    with np.errstate(all="ignore"):
        squares = problem.layout.squares(problem.residual(claims))
    counts = problem.layout.count()
    return {
        name: (float(np.nan_to_num(squares[k], nan=1e30, posinf=1e30)), float(counts[k]))
        for k, name in enumerate(CHANNELS)
        if counts[k]
    }


def gain(before: Left, after: Left) -> float:
    """Log of the factor by which less is left after than before, over all channels; what is not judged has its price.

    A tenth of the samples may be missing for nothing.
    """
    total = 0.0
    for name in {*before, *after}:
        most = 0.9 * max(found.get(name, (0.0, 0.0))[1] for found in (before, after))
        for found, sign in ((before, 1.0), (after, -1.0)):
            squares, count = found.get(name, (0.0, 0.0))
            mean = (squares + UNJUDGED * max(most - count, 0.0)) / max(most, count)
            total += sign * float(np.log(max(mean, 1.0)))
    return total


def times(found: Left) -> float:
    """Root mean square of what is left, over the noise's."""
    return float(np.sqrt(sum(squares for squares, _ in found.values()) / sum(count for _, count in found.values())))


def suspected(problem: Problem, claims: Sequence[Claim], held: Sequence[Segment] = ()) -> tuple[Repair, ...]:
    """The repairs that together leave much less under these claims, the most telling first; empty if none does.

    `held`: recordings that are judged besides those of the problem.
    """
    segments = [replace(one, thinner=None) for one in (*(model.segment for model in problem.models), *held)]
    found: list[Repair] = []
    while len(found) < MOST:
        trial = _Trial(problem, claims, segments)
        better = max(trial.repairs(), key=trial.gain, default=None)
        if better is None or trial.gain(better) < CLEAR:
            break
        found.append(trial.timed(better) if isinstance(better, Advance) else better)
        segments = trial.segments(found[-1])
    return tuple(found)


class _Trial:
    """Segments to which single repairs are done."""

    def __init__(self, problem: Problem, claims: Sequence[Claim], segments: Sequence[Segment]) -> None:
        self._problem, self._claims, self._segments = problem, claims, segments
        self._channels = set.intersection(*(set(segment.channels) for segment in segments))
        self._before = left(self._built(segments), claims)
        self._known: dict[Repair, Left] = {}

    def gain(self, repair: Repair) -> float:
        """Log of the factor by which less is left after it."""
        return gain(self._before, self._left(repair))

    def _left(self, repair: Repair) -> Left:
        if repair not in self._known:
            self._known[repair] = left(self._built(self.segments(repair)), self._claims)
        return self._known[repair]

    def segments(self, repair: Repair) -> list[Segment]:
        """The segments after it, without the ends where the clocks do not meet."""
        return [_repaired(segment, repair) for segment in self._segments]

    def repairs(self) -> Iterator[Repair]:
        """Whatever may be wrong with channels that are there and read as numbers of the right size."""
        here, bench = self._channels, self._problem.bench
        for name in ("valve_current", "hydraulic_force", "load_force"):
            if name in here:
                yield reversed_sign(name)
        if "piston_position" in here and knows(bench, "stroke"):
            yield Scale("piston_position", "piston_position has the wrong sign", factor=-1.0, offset=bench.stroke)
        for one, other in (("pressure_a", "pressure_b"), ("hydraulic_force", "load_force")):
            if {one, other} <= here:
                yield Exchange(one, f"{one} and {other} are exchanged", other=other)
        for name in ("hydraulic_force", "load_force"):
            if name in here:
                yield from (in_unit(name, unit) for unit in ("kN", "daN", "lbf"))
        for name in (*MEASURED, "valve_current"):
            if name in here:
                yield from self._delays(name)

    def timed(self, repair: Advance) -> Advance:
        """The repair with the delay that leaves least; that of whole rows, if it leaves no more."""
        row = max(one.step * one.spacing for one in self._segments)
        width = max(0.3 * abs(repair.delay), 2.0 * row)
        found = minimize_scalar(
            lambda delay: -self.gain(advance(repair.field, delay)),
            bounds=(repair.delay - width, repair.delay + width), method="bounded", options={"xatol": 1e-5},
        )  # fmt: skip
        best, whole = (advance(repair.field, float(at)) for at in (round(found.x, 5), row * round(found.x / row)))
        return whole if self.gain(whole) > self.gain(best) - ALIKE else best

    def _delays(self, field: str) -> Iterator[Advance]:
        """The delay that leaves least, about, where no cause makes it: downhill by parabolas through three delays."""
        at, moved = 0.0, REACH
        for _ in range(DOWNHILL):
            low, middle, high = (self._squares(advance(field, at + by)) for by in (-STEP, 0.0, STEP))
            bend = low + high - 2.0 * middle
            vertex = 0.5 * STEP * (low - high) / bend if bend > 0.0 else REACH * float(np.sign(low - high))
            moved = float(np.clip(at + np.clip(vertex, -2.0 * STEP, 2.0 * STEP), -REACH, REACH)) - at
            at += moved
            if abs(moved) < 0.5 * STEP:
                break
        if not PHYSICS[field][0] <= at <= PHYSICS[field][1]:
            yield advance(field, at)

    def _squares(self, repair: Repair) -> float:
        """What is left after a repair, each channel's over what was left before."""
        found = self._left(repair)
        return sum(squares / count / self._before[name][0] for name, (squares, count) in found.items())

    def _built(self, segments: Sequence[Segment]) -> Problem:
        problem = self._problem
        with np.errstate(all="ignore"):
            return Problem(segments, problem.bench, problem.baseline, estimated=problem.estimated)


def advance(field: str, delay: float) -> Advance:
    """A field that was recorded late by `delay` [s]."""
    said = f"{abs(delay) * 1e3:.3g} ms {'late' if delay > 0.0 else 'early'}"
    return Advance(field, f"{field} was recorded about {said}", delay=delay)


def retimed(problem: Problem, claims: Sequence[Claim], repairs: Sequence[Repair]) -> tuple[Repair, ...]:
    """The repairs, their delays by what these claims leave of the repaired recordings."""
    trial = _Trial(problem, claims, [replace(model.segment, thinner=None) for model in problem.models])
    return tuple(
        advance(one.field, round(one.delay + trial.timed(advance(one.field, 0.0)).delay, 5))
        if isinstance(one, Advance) else one
        for one in repairs
    )  # fmt: skip


def _repaired(segment: Segment, repair: Repair) -> Segment:
    moved = replace(segment, channels={**repair.apply(segment.channels, segment.step)})
    margin = int(np.ceil(abs(repair.delay) / segment.step)) if isinstance(repair, Advance) else 0
    return moved.cut(margin, len(moved) - margin)
