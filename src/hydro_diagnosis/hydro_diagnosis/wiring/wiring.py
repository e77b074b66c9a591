# SPDX-License-Identifier: Apache-2.0
"""Detection of mistakes in wiring, naming and units before the diagnosis, with the column map that corrects them.

Contradictions that no bench shows raise complaints (`checks`, `delays`); a mistake is named when undoing it leaves no
complaint, the fewest mistakes first. Nothing is ever repaired silently.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, islice

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.partial_bench import UnknownNumberError, guarded
from hydro_diagnosis.recording import MEASURED, InputError
from hydro_diagnosis.wiring.checks import CHECKS
from hydro_diagnosis.wiring.complaint import Complaint
from hydro_diagnosis.wiring.delays import delays
from hydro_diagnosis.wiring.repairs import Channels, Repair
from hydro_sim.model.bench import Bench

LOOKED_AT = 200_000
"""Number of samples examined, from the first."""
SHORTEST = 2.0
"""Shortest recording [s] that is judged."""
MOST = 4
"""Largest number of simultaneous mistakes that is searched."""
_FIELDS = (*MEASURED, "valve_current", "piston_velocity")
ANYWAY = "if the bench really does that, --as-wired goes on regardless"


class WiringError(InputError):
    """Channels that contradict each other or the bench file."""


@dataclass(frozen=True)
class Mistakes:
    """Contradictions in the wiring, and the repairs that resolve them."""

    complaints: tuple[Complaint, ...]
    repairs: tuple[Repair, ...]
    """Repairs that resolve all of them; empty if no known ones do."""


def wiring_checked(table: RawTable, bench: Bench, columns: ColumnMap | None) -> RawTable:
    """Return the table, with a note where channels contradict each other in a way that no known mistake explains.

    Parameters
    ----------
    table
        As read, before any check of its quality.
    bench
        The assumed bench.
    columns
        The map by which it was read.

    Raises
    ------
    WiringError
        Where a mistake explains it, so that a verdict would be about the wiring: what contradicts what, which mistake
        it is, and the map that repairs it.
    """
    found = mistakes(table, bench)
    if found is None:
        return table
    told = "; ".join(complaint.sentence for complaint in found.complaints[:2])
    if not found.repairs:
        return replace(table, notes=(*table.notes, f"{told}: no mistake of wiring or units that is known explains it"))
    wrong = ", and ".join(repair.sentence for repair in found.repairs)
    complete = columns is not None and "time" in columns.sources
    repaired = columns if columns is not None and complete else (columns or ColumnMap({})).completed(table.columns)
    for repair in found.repairs:
        repaired = repair.edit(repaired)
    said = repaired if complete else repaired.corrections()
    raise WiringError(f'{table.name}: {told}: {wrong}; repair: --columns "{said}"; {ANYWAY}')


def mistakes(table: RawTable, bench: Bench) -> Mistakes | None:
    """Find the wiring mistakes in a recording; None if there are none."""
    step, channels = _even(table)
    if not channels or step * len(next(iter(channels.values()))) < SHORTEST:
        return None
    complaints = _complaints(channels, step, bench)
    if not complaints:
        return None
    return Mistakes(complaints, _undone(channels, step, bench, complaints))


def _complaints(channels: Channels, step: float, bench: Bench) -> tuple[Complaint, ...]:
    """All that no bench does; delays only where signs and sizes are right."""
    known = guarded(bench)
    found = tuple(chain.from_iterable(_as_far_as_known(check(channels, step, known)) for check in CHECKS))
    return found or tuple(_as_far_as_known(delays(channels, step, known)))


def _as_far_as_known(complaints: Iterator[Complaint]) -> Iterator[Complaint]:
    """Complaints until a check needs a number that the bench file does not hold."""
    with suppress(UnknownNumberError):
        yield from complaints


def _undone(channels: Channels, step: float, bench: Bench, complaints: tuple[Complaint, ...]) -> tuple[Repair, ...]:
    """The fewest repairs that leave no complaint; empty if no `MOST` of them do."""
    front: list[tuple[tuple[Repair, ...], Channels, tuple[Complaint, ...]]] = [((), channels, complaints)]
    for _ in range(MOST):
        following = []
        for repairs, now, told in front:
            for repair in _suspects(told, repairs):
                if repair.field not in now:
                    continue
                then = repair.apply(now, step)
                left = _complaints(then, step, bench)
                if not left:
                    return (*repairs, repair)
                following.append(((*repairs, repair), then, left))
        following.sort(key=lambda one: len(one[2]))
        front = following[:8]
    return ()


def _suspects(complaints: tuple[Complaint, ...], done: tuple[Repair, ...]) -> Iterator[Repair]:
    """Repairs that the complaints name, each once, none that was done or that the last one undid."""
    named: dict[tuple[str, str], Repair] = {}
    for complaint in complaints:
        for repair in complaint.suspects:
            named.setdefault((repair.field, repair.sentence), repair)
    already = {(repair.field, repair.sentence) for repair in done}
    return islice((repair for key, repair in named.items() if key not in already), 12)


def _even(table: RawTable) -> tuple[float, dict[str, FloatArray]]:
    """Sampling time [s] and the first channels of numbers, equally spaced; none where the time says nothing."""
    time = table.time[:LOOKED_AT]
    steps = np.diff(time)
    forward = steps[np.isfinite(steps) & (steps > 0.0)]
    if len(forward) < 0.5 * len(steps) or len(time) < 20:
        return 0.0, {}
    step = float(np.median(forward))
    kept = np.isfinite(time)
    kept[1:] &= np.isfinite(steps) & (steps > 0.0)
    time = time[kept]
    even = np.arange(0.0, min(float(time[-1] - time[0]) / step, 2.0 * LOOKED_AT)) * step + time[0]
    channels = {}
    for name in _FIELDS:
        if name in table.columns:
            values = table.columns[name][:LOOKED_AT][kept]
            there = np.isfinite(values)
            if np.count_nonzero(there) > 0.5 * len(values):
                channels[name] = np.interp(even, time[there], values[there])
    return step, {name: values for name, values in channels.items() if np.ptp(values) > 0.0 or name != "load_force"}
