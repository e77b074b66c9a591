# SPDX-License-Identifier: Apache-2.0
"""The recordings as they are, or as they would be without a mistake of wiring: what explains them better is diagnosed.

Nothing is refused, and a correlation between two channels decides nothing: in a closed loop the current follows the
force as much as the flow. Where a mistake is suspected, causes are searched for in the recordings as they are and as
repaired, with the same small effort, and what is left on fitted and held-out recordings together is compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice, product

from threadpoolctl import threadpool_limits

from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.column_source import Source
from hydro_diagnosis.recording import InputError
from hydro_diagnosis.selection.localisation import noticeable
from hydro_diagnosis.selection.miswiring import ALIKE, CLEAR, Left, gain, left, retimed, suspected, times
from hydro_diagnosis.selection.outcome import NAMES
from hydro_diagnosis.selection.search import Search
from hydro_diagnosis.stages.naming import Standing
from hydro_diagnosis.stages.reading import Case, Progress, Question, read
from hydro_diagnosis.wiring.repairs import Advance, Exchange, Rename, Repair, Scale
from hydro_diagnosis.wiring.sizes import Doubt

TRIAL = replace(NAMES, restarts=1, effort=1500)
"""Search by which two readings of the same recordings are compared."""
LAGS = frozenset({"sensor_lag", "transport_delay", "valve_lag"})
"""Causes that a delay of a channel found too short or too long would pass for."""
MOST = 8
"""Ways of reading that are tried where numbers cannot be what they are named."""


Repaired = tuple[tuple[Repair, ...], Case]
"""Repairs, and the recordings after them."""


@dataclass(frozen=True)
class Explained:
    """What the best causes leave of a reading of the recordings."""

    fitted: Left
    held: Left
    claims: tuple[Claim, ...]

    @property
    def numbers(self) -> int:
        """Parameters of the causes."""
        return sum(len(claim.effect.parameters) for claim in self.claims)


def understood(question: Question, progress: Progress) -> Case:
    """The recordings as they are, or repaired where that explains them better; `Case.wiring` tells which and why.

    Raises
    ------
    InputError
        If they cannot be diagnosed, neither as they are nor repaired.
    """
    doubted: list[Doubt] = []
    case: Case | None = None
    refusal = ""
    try:
        case = read(question, progress, doubted)
    except InputError as error:
        if question.as_wired or not doubted:
            raise
        refusal = str(error)
    if case is not None and (question.as_wired or not (doubted or _mismatch(case.problem))):
        return case
    readings = _plausible(question, doubted, progress) if doubted or case is None else [((), case)]
    readings = [_freed(question, *one, progress) for one in readings]
    if not readings:
        return read(question, progress)
    repairs, other = _least(readings, progress)
    if not repairs:
        return other
    if any(isinstance(repair, Rename) and not repair.becomes for repair in repairs):
        refusal = "no two sensors have the same noise"
    if case is None or refusal:
        return replace(other, wiring=_told(repairs, other.question, f"as recorded: {refusal.split(' (')[0]}"))
    return _decided(case, _tried(case, progress), repairs, other, progress)


def reconsidered(case: Case, found: Standing, progress: Progress) -> Case:
    """The same case, or it repaired, where causes leave something: what they leave may be a mistake of wiring."""
    claims = found.outcome.fit.claims
    left_over = found.assessment.remainder or noticeable(found.unseen, found.unseen.residual(claims))
    if case.question.as_wired or not left_over:
        return case
    repairs = suspected(case.problem, claims, case.held)
    if not repairs:
        return case
    try:
        other = read(_repaired(case.question, repairs), progress)
    except InputError:
        return case
    return _decided(case, _left(case, found.unseen, claims), repairs, other, progress)


def _mismatch(problem: Problem) -> bool:
    return noticeable(problem, problem.residual(()))


def _plausible(question: Question, doubted: Iterable[Doubt], progress: Progress) -> list[Repaired]:
    """Of the repairs that numbers ask for which cannot be what they are named, those that leave least.

    One for each choice of channels that is left.
    """
    best: dict[frozenset[str], Repaired] = {}
    for repairs in islice(product(*_merged(doubted)), MOST):
        further: list[Doubt] = []
        try:
            case = read(_repaired(question, repairs), progress, further)
            if further:  # in millimetres and from mid-stroke, for instance
                repairs = (*repairs, *(doubt[-1] for doubt in _merged(further)))
                case = read(_repaired(question, repairs), progress)
        except InputError:
            continue
        key = frozenset(case.problem.models[0].channels)
        if key not in best or gain(left(best[key][1].problem, ()), left(case.problem, ())) > 0.0:
            best[key] = repairs, case
    return list(best.values())


def _freed(question: Question, repairs: tuple[Repair, ...], case: Case, progress: Progress) -> Repaired:
    """A reading without the mistakes that the model suspects in it too."""
    further = suspected(case.problem, (), case.held)
    if not further:
        return repairs, case
    try:
        return (*repairs, *further), read(_repaired(question, (*repairs, *further)), progress)
    except InputError:
        return repairs, case


def _least(readings: Sequence[Repaired], progress: Progress) -> Repaired:
    """The reading of which the best causes leave least."""
    if len(readings) == 1:
        return readings[0]
    explained = [_tried(case, progress) for _, case in readings]
    return readings[max(range(len(readings)), key=lambda k: gain(explained[0].fitted, explained[k].fitted))]


def _merged(doubted: Iterable[Doubt]) -> list[Doubt]:
    """One doubt of each field: of those of several recordings the one with the middle number."""
    groups: list[tuple[set[str], list[Doubt]]] = []
    for doubt in doubted:
        fields = {one.field for one in doubt}
        met = [group for group in groups if group[0] & fields]
        groups = [group for group in groups if not group[0] & fields]
        groups.append(
            (fields.union(*(group[0] for group in met)), [one for group in met for one in group[1]] + [doubt])
        )
    middle = [sorted(found, key=lambda doubt: str(doubt[-1]))[len(found) // 2] for _, found in groups]
    return [tuple(doubt) for doubt in middle]


def _repaired(question: Question, repairs: Sequence[Repair]) -> Question:
    """The same question with the column map that repairs the recordings."""
    given = ColumnMap.load(question.columns) or ColumnMap({})
    fields = [name for one in repairs for name in (one.field, one.other if isinstance(one, Exchange) else one.field)]
    whole = "time" in given.sources
    columns = given if whole else ColumnMap({**{name: Source(name) for name in fields}, **given.sources}, given.absent)
    for repair in repairs:
        columns = repair.edit(columns)
    return replace(question, columns=columns if whole else columns.corrections())


def _tried(case: Case, progress: Progress) -> Explained:
    """What is left after a small search for causes."""
    with threadpool_limits(1, "blas"):
        found = Search(case.problem, case.candidates, TRIAL, progress).run()
    problem = case.problem
    unseen = Problem(case.held, problem.bench, problem.baseline, noise=problem.sensor_noise)
    unseen.update_weights(found.fit.claims)
    return _left(case, unseen, found.fit.claims)


def _left(case: Case, unseen: Problem, claims: Sequence[Claim]) -> Explained:
    return Explained(left(case.problem, claims), left(unseen, claims), tuple(claims))


def _decided(case: Case, here: Explained, repairs: Sequence[Repair], other: Case, progress: Progress) -> Case:
    """The better of the two, with a note on both."""
    there = _tried(other, progress)
    again = retimed(other.problem, [claim for claim in there.claims if claim.effect.id not in LAGS], repairs)
    if again != tuple(repairs):
        with suppress(InputError):
            nearer = read(_repaired(case.question, again), progress)
            closer = _tried(nearer, progress)
            gained = gain(there.fitted, closer.fitted)
            if gained > ALIKE or (gained > -ALIKE and closer.numbers <= there.numbers):
                repairs, other, there = again, nearer, closer
    clearer = min(gain(here.fitted, there.fitted), gain(here.held, there.held))
    simpler = there.numbers + sum(_fitted(repair) for repair in repairs) < here.numbers
    if clearer >= CLEAR or (clearer > -ALIKE and simpler):
        beside = (
            f"as recorded, the best causes leave {times(here.held):.3g} times the noise on what was held out, "
            f"repaired {times(there.held):.3g} times"
        )
        return replace(other, wiring=_told(repairs, other.question, beside))
    note = (
        f"the recordings look as if {_words(repairs)}, but as recorded their causes leave {times(here.held):.3g} times "
        f"the noise on what was held out, repaired {times(there.held):.3g} times: they were diagnosed as recorded; if "
        f'it is a mistake of wiring all the same, diagnose with --columns "{other.question.columns}"'
    )
    return replace(case, wiring=note)


def _told(repairs: Sequence[Repair], question: Question, beside: str) -> str:
    return (
        f'{_words(repairs)}: the recordings were diagnosed as repaired by --columns "{question.columns}" ({beside}); '
        "correct it at the rig or in the logger, or keep that map; --as-wired takes them as recorded"
    )


def _words(repairs: Sequence[Repair]) -> str:
    return ", and ".join(repair.sentence for repair in repairs)


def _fitted(repair: Repair) -> int:
    """Numbers of a repair that were found from the recordings."""
    return int(isinstance(repair, Advance) or (isinstance(repair, Scale) and bool(repair.offset)))
