# SPDX-License-Identifier: Apache-2.0
"""Wiring hypotheses: the recordings as they are, or with a wiring mistake repaired; the better explained are diagnosed.

No recording is refused for its wiring, and no correlation between two channels decides: in a closed loop the current
follows the force as much as the flow. If a mistake is suspected, causes are searched for in the recordings as they are
and as repaired, with the same small effort; a repair must reduce the residuals of fitted and of held-out recordings.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice, product
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy.optimize import minimize_scalar
from threadpoolctl import threadpool_limits

from hydro_core.signals import FloatArray
from hydro_diagnosis.bench_parameters import is_known
from hydro_diagnosis.effects.base import EffectHypothesis
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.column_map import ColumnMap, Source
from hydro_diagnosis.recording import MEASURED_CHANNELS, InputError, Segment
from hydro_diagnosis.selection.search import Search, SearchSettings
from hydro_diagnosis.significance import ITERATIONS
from hydro_diagnosis.wiring import AlternativeRepairs, PlausibilityCheck, Repair, in_other_units, reversed_sign

if TYPE_CHECKING:
    from hydro_diagnosis.stages.naming import StageResult
    from hydro_diagnosis.stages.reading import DiagnosisInput, PreparedDiagnosis, ProgressCallback

DECISIVE_LOG_RATIO = float(np.log(10.0))
"""Decisive `log_gain` of a repair: log of the factor by which mean squared residuals fall, summed over the channels."""
TIE_LOG_RATIO = float(np.log(1.1))
"""`log_gain` within which two wiring hypotheses tie."""
PHYSICAL_DELAYS = {
    "valve_current": (-0.02, 0.0), "piston_position": (-0.01, 0.02), "load_force": (-0.01, 0.06),
    "hydraulic_force": (-0.02, 0.02), "pressure_a": (-0.02, 0.02), "pressure_b": (-0.02, 0.02),
}  # fmt: skip
"""Range of each channel's delay [s] (negative: early) that valve, play or an amplifier explain: causes, no mistakes."""
RepairedDiagnosis: TypeAlias = "tuple[tuple[Repair, ...], PreparedDiagnosis]"
"""Repairs, and the prepared diagnosis of the repaired recordings."""


def residual_sums(problem: Problem, claims: Sequence[EffectHypothesis]) -> FloatArray:
    """Return sums of squared residuals over the noise variance, and counts, shape (2, channels)."""
    with np.errstate(all="ignore"):
        squares = problem.layout.squares(problem.residual(claims))
    counts = problem.layout.count
    return np.array([np.where(counts, np.nan_to_num(squares, nan=1e30, posinf=1e30), 0.0), counts], dtype=np.float64)


def log_gain(before: FloatArray, after: FloatArray) -> float:
    """Return the log of the factor by which mean squared residuals fall, summed over the channels.

    `before`, `after`: of `residual_sums`. A tenth of the samples may be lost at no cost; each further sample that is
    not evaluated costs 100 noise variances.
    """
    judged = np.maximum(before[1], after[1]) > 0.0
    most = 0.9 * np.maximum(before[1], after[1])[judged]
    means = [
        (squares + 100.0 * np.maximum(most - counts, 0.0)) / np.maximum(most, counts)
        for squares, counts in (before[:, judged], after[:, judged])
    ]
    here, there = (np.log(np.maximum(mean, 1.0)) for mean in means)
    return float(np.sum(here - there))


def suspected_repairs(
    problem: Problem,
    claims: Sequence[EffectHypothesis],
    held_out: Sequence[Segment] = (),
    units: Mapping[str, str] | None = None,
) -> tuple[Repair, ...]:
    """Return at most four repairs, selected greedily, that each gain `DECISIVE_LOG_RATIO` or more under these claims.

    `held_out`: held-out segments, evaluated jointly with the problem's; `units`: unit of a field's column, if not SI.
    """
    segments = [replace(one, half_rows=None) for one in (*(model.segment for model in problem.models), *held_out)]
    found: list[Repair] = []
    while len(found) < 4:
        trial = _Trial(problem, claims, segments)
        better = max(trial.repairs(units or {}), key=trial.log_gain, default=None)
        if better is None or trial.log_gain(better) < DECISIVE_LOG_RATIO:
            break
        found.append(trial.refine_delay(better) if better.delay else better)
        segments = trial.segments(found[-1])
    return tuple(found)


class _Trial:
    """Trial of single repairs on segments."""

    def __init__(self, problem: Problem, claims: Sequence[EffectHypothesis], segments: list[Segment]) -> None:
        self._problem, self._claims, self._segments = problem, claims, segments
        self._known: dict[Repair | None, FloatArray] = {}

    def segments(self, repair: Repair | None) -> list[Segment]:
        """Repaired segments, trimmed by the delay at both ends."""
        if repair is None:
            return self._segments
        moved = [replace(one, channels={**repair.apply(one.channels, one.step)}) for one in self._segments]
        margins = [int(np.ceil(abs(repair.delay) / one.step)) for one in moved]
        return [one.cut(margin, len(one) - margin) for one, margin in zip(moved, margins, strict=True)]

    def residual_sums(self, repair: Repair | None = None) -> FloatArray:
        """Return `residual_sums` after a repair."""
        if repair not in self._known:
            problem, segments = self._problem, self.segments(repair)
            with np.errstate(all="ignore"):
                built = Problem(segments, problem.bench, problem.baseline, estimated=problem.estimated)
            self._known[repair] = residual_sums(built, self._claims)
        return self._known[repair]

    def log_gain(self, repair: Repair) -> float:
        """Return `log_gain` of a repair."""
        return log_gain(self.residual_sums(), self.residual_sums(repair))

    def repairs(self, units: Mapping[str, str]) -> Iterator[Repair]:
        """Yield the repairs that are possible for channels with values of plausible magnitude."""
        here = set.intersection(*(set(segment.channels) for segment in self._segments))
        bench = self._problem.bench
        for name in ("valve_current", "hydraulic_force", "load_force"):
            if name in here:
                yield reversed_sign(name)
        if "piston_position" in here and is_known(bench, "stroke"):
            yield replace(reversed_sign("piston_position"), offset=bench.stroke)
        for one, other in (("pressure_a", "pressure_b"), ("hydraulic_force", "load_force")):
            if {one, other} <= here:
                yield Repair(one, f"{one} and {other} are exchanged", exchanged_with=other)
        for name in ("hydraulic_force", "load_force"):
            if name in here:
                yield from in_other_units(name, ("N", "kN", "daN", "lbf"), units)
        for name in (*MEASURED_CHANNELS, "valve_current"):
            if name in here and not PHYSICAL_DELAYS[name][0] <= (late := self.delay(name)) <= PHYSICAL_DELAYS[name][1]:
                yield advance(name, late)

    def delay(self, field: str) -> float:
        """Return an estimate of the delay [s] that minimises the residuals, by successive parabolic interpolation."""

        def squares(delay: float) -> float:
            found, before = self.residual_sums(advance(field, delay)), self.residual_sums()
            there = found[1] > 0.0
            return float(np.sum(found[0, there] / found[1, there] / before[0, there]))

        step, reach = 0.02, 0.15  # s: half-width of the interval of a parabola; largest delay
        at = 0.0
        for _ in range(ITERATIONS):
            low, middle, high = (squares(at + by) for by in (-step, 0.0, step))
            bend = low + high - 2.0 * middle
            vertex = 0.5 * step * (low - high) / bend if bend > 0.0 else reach * float(np.sign(low - high))
            moved = float(np.clip(at + np.clip(vertex, -2.0 * step, 2.0 * step), -reach, reach)) - at
            at += moved
            if abs(moved) < 0.5 * step:
                break
        return at

    def refine_delay(self, repair: Repair) -> Repair:
        """Return the repair with the delay that minimises the residuals, rounded to whole rows if these tie."""
        row = max(one.step * one.spacing for one in self._segments)
        width = max(0.3 * abs(repair.delay), 2.0 * row)
        found = minimize_scalar(
            lambda delay: -self.log_gain(advance(repair.field, delay)),
            bounds=(repair.delay - width, repair.delay + width), method="bounded", options={"xatol": 1e-5},
        )  # fmt: skip
        best, whole = (advance(repair.field, float(at)) for at in (round(found.x, 5), row * round(found.x / row)))
        return whole if self.log_gain(whole) > self.log_gain(best) - TIE_LOG_RATIO else best


def advance(field: str, delay: float) -> Repair:
    """Repair of a field that was recorded late by `delay` [s] (negative: early)."""
    said = f"{abs(delay) * 1e3:.3g} ms {'late' if delay > 0.0 else 'early'}"
    return Repair(field, f"{field} was recorded about {said}", delay=delay)


@dataclass(frozen=True)
class WiringFit:
    """Residuals of the best causes under one wiring hypothesis: the recordings as they are, or repaired."""

    fitted: FloatArray
    """`residual_sums` of the fitted recordings."""
    held_out: FloatArray
    """`residual_sums` of the held-out recordings."""
    claims: tuple[EffectHypothesis, ...]
    parameter_count: int
    """Number of parameters of the causes."""


def prepare_best_wiring(inputs: DiagnosisInput, progress: ProgressCallback) -> PreparedDiagnosis:
    """Prepare the recordings as they are, or repaired if that explains them better; its `wiring` states which and why.

    Raises InputError if they can be diagnosed neither as they are nor repaired.
    """
    inspection = PlausibilityCheck()
    prepared: PreparedDiagnosis | None = None
    try:
        prepared = inputs.prepare(progress, inspection)
    except InputError:
        if inputs.as_wired or not inspection.doubts:
            raise
    if prepared is not None and inputs.as_wired:
        return prepared
    if prepared is not None and not (inspection.doubts or prepared.problem.has_excess(prepared.problem.residual(()))):
        return prepared
    readings: list[RepairedDiagnosis] = [((), prepared)] if prepared is not None else []
    if prepared is None or inspection.doubts:
        readings = _plausible(inputs, inspection, progress)
    for k, (repairs, one) in enumerate(readings):
        if further := suspected_repairs(one.problem, (), one.held_out, one.units):  # besides implausible values
            repairs = (*repairs, *further)
            with suppress(InputError):
                readings[k] = repairs, _repaired(inputs, repairs, inspection.units).prepare(progress)
    if not readings:
        return inputs.prepare(progress)
    repairs, other = readings[0]
    if len(readings) > 1:
        explained = [_searched(one, progress) for _, one in readings]
        repairs, other = readings[
            max(range(len(readings)), key=lambda k: log_gain(explained[0].fitted, explained[k].fitted))
        ]
    if not repairs:
        return other
    if prepared is None or any(repair.reassigned_to == "" for repair in repairs):
        return replace(other, wiring=_repair_note(repairs, other.inputs))
    return _choose(prepared, _searched(prepared, progress), repairs, other, progress)


def reconsider_wiring(prepared: PreparedDiagnosis, found: StageResult, progress: ProgressCallback) -> PreparedDiagnosis:
    """Return the prepared diagnosis, or its repaired version if a wiring mistake explains residual or two claims."""
    claims = found.outcome.fit.claims
    left_over = found.assessment.remainder or found.holdout.has_excess(found.holdout.residual(claims))
    if prepared.inputs.as_wired or found.by_curve is not None:
        return prepared  # the residual of rough recordings is no evidence of their wiring
    repairs = suspected_repairs(found.problem, claims, prepared.held_out, prepared.units) if left_over else ()
    values = {claim.effect.id: claim.values for claim in claims}
    if not repairs and values.keys() >= {"spring_rest", "dead_volume"}:
        offset = found.problem.bench.spring_rest_position - values["spring_rest"]["position"]
        said = "piston_position has its zero elsewhere (offset estimated from the spring force: better measure it)"
        repairs = (Repair("piston_position", said, offset=float(f"{offset:.5g}")),)
    if not repairs:
        return prepared
    try:
        other = _repaired(prepared.inputs, repairs, prepared.units).prepare(progress)
    except InputError:
        return prepared
    return _choose(prepared, _wiring_fit(found.problem, found.holdout, claims), repairs, other, progress)


def _plausible(
    inputs: DiagnosisInput, inspection: PlausibilityCheck, progress: ProgressCallback
) -> list[RepairedDiagnosis]:
    """Repairs of the fields with implausible values, with the smallest residuals for each set of remaining channels.

    At most eight combinations are tried.
    """
    best: dict[frozenset[str], RepairedDiagnosis] = {}
    units = inspection.units
    for repairs in islice(product(*_one_per_field(inspection.doubts)), 8):
        further = PlausibilityCheck()
        try:
            prepared = _repaired(inputs, repairs, units).prepare(progress, further)
            if further.doubts:  # in millimetres and from mid-stroke, for instance
                repairs = (*repairs, *(doubt[-1] for doubt in _one_per_field(further.doubts)))
                prepared = _repaired(inputs, repairs, units).prepare(progress)
        except InputError:
            continue
        key = frozenset(prepared.problem.models[0].channels)
        if (
            key not in best
            or log_gain(residual_sums(best[key][1].problem, ()), residual_sums(prepared.problem, ())) > 0.0
        ):
            best[key] = repairs, prepared
    return list(best.values())


def _one_per_field(doubted: Iterable[AlternativeRepairs]) -> list[AlternativeRepairs]:
    """One doubt per field; of those of several recordings, the median."""
    groups: list[tuple[set[str], list[AlternativeRepairs]]] = []
    for doubt in doubted:
        fields, found = {one.field for one in doubt}, [doubt]
        for group in [group for group in groups if group[0] & fields]:
            groups.remove(group)
            fields, found = fields | group[0], [*found[:-1], *group[1], doubt]
        groups.append((fields, found))
    return [sorted(found, key=lambda doubt: str(doubt[-1]))[len(found) // 2] for _, found in groups]


def _repaired(inputs: DiagnosisInput, repairs: Sequence[Repair], units: Mapping[str, str]) -> DiagnosisInput:
    """Input with the column map that repairs the recordings; `units`: of the fields' columns, if not SI."""
    given = ColumnMap.load(inputs.columns) or ColumnMap({})
    fields = [name for one in repairs for name in (one.field, one.exchanged_with) if name]
    whole = "time" in given.sources
    columns = given if whole else ColumnMap({**{name: Source(name) for name in fields}, **given.sources}, given.absent)
    for name in fields:
        if name in units and (source := columns.sources[name]).plain:
            columns = columns.changed(name, replace(source, unit=units[name]))
    for repair in repairs:
        columns = repair.edit(columns)
    return replace(inputs, columns=columns if whole else columns.corrections())


def _searched(prepared: PreparedDiagnosis, progress: ProgressCallback) -> WiringFit:
    """Residuals after a small search for causes."""
    with threadpool_limits(1, "blas"):
        found = Search(prepared.problem, prepared.candidates, SearchSettings(effort=1500), progress).run()
    holdout = found.problem.for_segments(prepared.held_out).reweighted(found.fit.claims)
    return _wiring_fit(found.problem, holdout, found.fit.claims)


def _wiring_fit(problem: Problem, holdout: Problem, claims: Sequence[EffectHypothesis]) -> WiringFit:
    parameter_count = sum(len(claim.effect.parameters) for claim in claims)
    return WiringFit(residual_sums(problem, claims), residual_sums(holdout, claims), tuple(claims), parameter_count)


def _choose(
    prepared: PreparedDiagnosis,
    here: WiringFit,
    repairs: Sequence[Repair],
    other: PreparedDiagnosis,
    progress: ProgressCallback,
) -> PreparedDiagnosis:
    """The better explained of the two prepared diagnoses, with a note on both."""
    there = _searched(other, progress)
    lags = ("sensor_lag", "transport_delay", "valve_lag")  # these would absorb the error of an estimated delay
    claims = [claim for claim in there.claims if claim.effect.id not in lags]
    trial = _Trial(other.problem, claims, [replace(model.segment, half_rows=None) for model in other.problem.models])
    again = [
        advance(one.field, round(one.delay + trial.refine_delay(advance(one.field, 0.0)).delay, 5))
        if one.delay
        else one
        for one in repairs
    ]
    if again != list(repairs):
        with suppress(InputError):
            nearer = _repaired(prepared.inputs, again, prepared.units).prepare(progress)
            closer = _searched(nearer, progress)
            gained = log_gain(there.fitted, closer.fitted)
            if gained > TIE_LOG_RATIO or (gained > -TIE_LOG_RATIO and closer.parameter_count <= there.parameter_count):
                repairs, other, there = again, nearer, closer
    clearer = min(log_gain(here.fitted, there.fitted), log_gain(here.held_out, there.held_out))
    estimated = sum(bool(repair.delay or repair.offset) for repair in repairs)
    simpler = there.parameter_count + estimated < here.parameter_count
    if clearer >= DECISIVE_LOG_RATIO or (clearer > -TIE_LOG_RATIO and simpler):
        return replace(other, wiring=_repair_note(repairs, other.inputs))
    note = (
        f"the recordings look as if {_words(repairs)}, but were diagnosed as recorded; to have them repaired, "
        f'diagnose with --columns "{other.inputs.columns}"'
    )
    return replace(prepared, wiring=note)


def _repair_note(repairs: Sequence[Repair], inputs: DiagnosisInput) -> str:
    return (
        f'{_words(repairs)}: the recordings were diagnosed as repaired by --columns "{inputs.columns}"; --as-wired '
        "takes them as recorded"
    )


def _words(repairs: Sequence[Repair]) -> str:
    return ", and ".join(repair.sentence for repair in repairs)
