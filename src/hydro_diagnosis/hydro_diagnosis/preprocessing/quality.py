# SPDX-License-Identifier: Apache-2.0
"""Quality checks: faults are repaired and listed where that is sound, refused in one sentence where it is not.

The outcome is contiguous segments on an even grid: a recording is cut where samples, numbers or a sensor are missing
for longer than `BRIDGED`, and what is shorter is bridged (`box_clock`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_diagnosis.io.table import RawTable, UnusableRecordingError
from hydro_diagnosis.partial_bench import knows
from hydro_diagnosis.preprocessing.box_clock import SAME, on_box_clock, rate_note
from hydro_diagnosis.preprocessing.sensor_faults import Mask, frozen_encoder, repeats
from hydro_diagnosis.preprocessing.stamps import counted, placed_by_stamps, stamped, uneven
from hydro_diagnosis.recording import MEASURED, Recording, Segment
from hydro_sim.model.bench import Bench

BRIDGED = 5
"""Longest gap [rows] that is bridged."""
SHORTEST = 1.5
"""Shortest segment [s] that is used."""
STOP_MARGIN = 5e-4
"""Margin [m] from an end stop."""
CAVITATION = 5e4
"""Pressure [Pa] below which the oil cavitates."""
EVENT_MARGIN = 100
"""Samples before and after such an event that are left out."""
STILL = 1e-5
"""m: a recording whose position moves less shows nothing."""
MOVING = 2e-4
"""m: a segment in which the position moves less (a tripped bench, say) is left out."""
REMEDY = (
    "record it with lower gains; if the bench still trips or swings from stop to stop, give the box, not the "
    "diagnosis, a bench.yaml with a valve_nominal_flow that is 25 % higher or more"
)
"""Remedy for a bench that cannot be driven: the velocity term is then compensated only in part."""


def checked(table: RawTable, bench: Bench) -> Recording:
    """Check a recording, and cut it into segments that can be diagnosed.

    Raises
    ------
    UnusableRecordingError
        Too short, clock broken, nothing moves, or saturated throughout.
    """
    notes: list[str] = []
    columns, shaken = _alive(table, notes), False
    if table.sample is None and uneven(table.time):
        step, index = counted(table.time)
        placed = placed_by_stamps(columns, table.time, index, step)
        columns, shaken = placed or columns, placed is not None
        notes += stamped(table.time, index, step, taken_there=shaken)
    else:
        step, index = _grid(table, notes)
    if not any(name in columns for name in MEASURED):
        raise UnusableRecordingError(f"{table.name}: no sensor in it is alive")
    _refuse_useless(table.name, columns, bench)
    bad = _bad_samples(columns, step, bench, notes)
    outside = _outside_equations(columns, bench, notes)
    bad |= outside
    segments = _segments(table.name, step, index, columns, bad, notes, shaken)
    if not segments:
        raise UnusableRecordingError(
            f"{table.name}: the bench moves without a gap for less than {SHORTEST:g} s: too short to be diagnosed"
            + (f" ({'; '.join(notes)})" if notes else "")
            + (f"; {REMEDY}" if outside.any() or _stands(columns) else "")
        )
    return Recording(table.name, tuple(segments), tuple(f"{table.name}: {note}" for note in (*table.notes, *notes)))


def _grid(table: RawTable, notes: list[str]) -> tuple[float, npt.NDArray[np.int64]]:
    """Sampling time and the number of each sample on an even grid; steps back become gaps."""
    time = table.time
    if len(time) < 3 or np.count_nonzero(np.isfinite(time)) < 3:
        raise UnusableRecordingError(f"{table.name}: the recording is empty")
    steps = np.diff(time)
    forward = steps[np.isfinite(steps) & (steps > 0.0)]
    if len(forward) < 0.5 * len(steps):
        raise UnusableRecordingError(f"{table.name}: the time does not run forward")
    step = float(np.median(forward))
    step = 1e-3 if abs(step - 1e-3) < 5e-5 else step
    counts = np.diff(table.sample) if table.sample is not None else steps / step
    whole = np.rint(np.where(np.isfinite(counts), counts, 1e6)).astype(np.int64)
    jumps = int(np.count_nonzero((np.abs(steps - whole * step) > max(5e-3, 2.0 * step)) & np.isfinite(steps)))
    if jumps and table.sample is not None:
        whole[np.abs(steps - whole * step) > max(5e-3, 2.0 * step)] = 10**6
        notes.append(f"the clock jumps {jumps} times; the recording is cut there")
    back = int(np.count_nonzero(whole < 0))
    if back:
        notes.append(f"the time steps back {back} times; the recording is cut there")
    lost = int(np.sum(whole[(whole > 1) & (whole < 10**6)] - 1))
    if lost:
        notes.append(f"{lost} samples are missing")
    whole[whole < 0] = 10**6
    return step, np.concatenate([[0], np.cumsum(whole)])


def _alive(table: RawTable, notes: list[str]) -> dict[str, FloatArray]:
    """Columns without those that hold nothing or never change."""
    alive = {}
    for name, values in table.columns.items():
        finite = values[np.isfinite(values)]
        if len(finite) < 0.5 * len(values):
            notes.append(f"{name} is missing in most samples and was left out")
        elif name in MEASURED and np.ptp(finite) == 0.0 and name != "piston_position":
            if np.any(finite != 0.0):
                notes.append(f"{name} is frozen throughout and was left out")
        else:
            alive[name] = values
    return alive


def _refuse_useless(name: str, columns: dict[str, FloatArray], bench: Bench) -> None:
    if "piston_position" in columns:
        span = float(np.nanmax(columns["piston_position"]) - np.nanmin(columns["piston_position"]))
        if span < STILL:
            raise UnusableRecordingError(
                f"{name}: the piston position does not change (by {span:.2g} m): nothing can be diagnosed"
            )
    if "valve_current" in columns:
        limit = bench.valve_current_max * 0.999
        share = float(np.mean(np.abs(columns["valve_current"]) >= limit))
        if share > 0.6:
            raise UnusableRecordingError(
                f"{name}: the valve current is saturated in {share * 100:.0f} % of the samples: {REMEDY}"
            )


def _stands(columns: dict[str, FloatArray]) -> bool:
    """Return whether the piston stands still in the second half, as it does once the box has tripped."""
    position = columns.get("piston_position", np.zeros(0))
    return len(position) > 0 and float(np.ptp(position[len(position) // 2 :])) < MOVING


def _bad_samples(columns: dict[str, FloatArray], step: float, bench: Bench, notes: list[str]) -> Mask:
    bad = np.zeros(len(next(iter(columns.values()))), dtype=bool)
    for channel, values in columns.items():
        if channel not in MEASURED and channel != "valve_current":
            continue
        missing = ~np.isfinite(values)
        if missing.any():
            notes.append(f"{channel} is not a number in {int(missing.sum())} samples")
        frozen = _frozen(channel, columns, step, bench)
        if frozen.any():
            notes.append(f"{channel} is frozen in {int(frozen.sum())} samples; the recording is cut there")
        bad |= missing | frozen
    return bad


def _frozen(channel: str, columns: dict[str, FloatArray], step: float, bench: Bench) -> Mask:
    if channel == "valve_current":  # a command: it may stay what it is
        return np.zeros(len(columns[channel]), dtype=bool)
    return frozen_encoder(columns, step, bench) if channel == "piston_position" else repeats(columns[channel])


def _outside_equations(columns: dict[str, FloatArray], bench: Bench, notes: list[str]) -> Mask:
    """Samples in or near an end stop or cavitation, which no equation here describes; wide margins on both sides."""
    outside = np.zeros(len(next(iter(columns.values()))), dtype=bool)
    if "piston_position" in columns:
        position = columns["piston_position"]
        if knows(bench, "stroke"):
            outside |= (position < STOP_MARGIN) | (position > bench.stroke - STOP_MARGIN)
    for name in ("pressure_a", "pressure_b"):
        if name in columns:
            outside |= columns[name] < CAVITATION
    if not outside.any():
        return outside
    notes.append(
        f"{int(outside.sum())} samples stand in an end stop or cavitate; they and their surroundings are not judged"
    )
    wide: Mask = np.convolve(outside, np.ones(2 * EVENT_MARGIN + 1), mode="same") > 0.5
    return wide


def _segments(
    name: str,
    step: float,
    index: npt.NDArray[np.int64],
    columns: dict[str, FloatArray],
    bad: Mask,
    notes: list[str],
    shaken: bool,
) -> list[Segment]:
    good = np.flatnonzero(~bad)
    if len(good) < 2:
        return []
    unique, first = np.unique(index[good], return_index=True)
    if len(unique) < len(good):
        notes.append(f"{len(good) - len(unique)} samples come twice; the first was kept")
    rows = good[first]
    cuts = np.flatnonzero(np.diff(unique) > BRIDGED + 1)
    starts, ends = np.concatenate([[0], cuts + 1]), np.concatenate([cuts + 1, [len(unique)]])
    segments, bridged, short, still = [], 0, 0, 0
    origin = unique[0]
    for begin, end in zip(starts, ends, strict=True):
        at = unique[begin:end]
        even = np.arange(at[0], at[-1] + 1)
        if len(even) * step < SHORTEST:
            short += len(even)
            continue
        found = {key: values[rows[begin:end]] for key, values in columns.items()}
        if "piston_position" in found and np.ptp(found["piston_position"]) < MOVING:
            still += len(even)
            continue
        bridged += len(even) - len(at)
        start = float(min(at[0] - origin, 10**5) * step)
        segments.append(on_box_clock(name, start, step, at, found, shaken=shaken))
    if bridged:
        notes.append(f"{bridged} missing samples were bridged by splines; they and their neighbours are not judged")
    if segments and abs(step - SAMPLE_PERIOD) > SAME * SAMPLE_PERIOD:
        notes.append(rate_note(step, segments[0]))
    if still:
        notes.append(f"{still} samples in which the piston stands still were not used")
    if short:
        notes.append(f"{short} samples stand in stretches shorter than {SHORTEST:g} s and were not used")
    return segments
