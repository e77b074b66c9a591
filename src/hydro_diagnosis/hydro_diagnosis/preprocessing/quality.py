# SPDX-License-Identifier: Apache-2.0
"""Quality checks: faults are repaired and listed where that is sound, refused in one sentence where it is not.

The outcome is contiguous segments on an even grid: a recording is cut where samples, numbers or a sensor are missing
for longer than `BRIDGED`, and what is shorter is bridged (`box_clock`).

Time stamps: a logger that stamps rows on arrival adds jitter to samples that the box took evenly; one that polls takes
samples unevenly with correct stamps. The recording itself decides: placed correctly, it is smoother.

Frozen sensors: a noisy one repeats its number. An encoder is quantised and a piston may stand: frozen is one that stays
exactly where it is while the load's force or the reported velocity moves on, or that jumps when it comes back. What
follows a stop for a moment (the load cell's amplifier rings, the velocity's filter runs out) does not count.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_diagnosis.bench_numbers import has_spring, knows
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.box_clock import SAME, on_box_clock, rate_note
from hydro_diagnosis.preprocessing.smoothing import white_noise
from hydro_diagnosis.recording import MEASURED, Recording, Segment, UnusableRecordingError
from hydro_diagnosis.significance import OUTLYING
from hydro_sim.model.bench import Bench

Rows = npt.NDArray[np.int64]
SHAKEN = 0.02
"""Deviation of a stamp, as a share of the sampling time, that counts as jitter."""
OFTEN = 0.05
"""Share of the stamps that must have jitter."""
FOLLOWS = 0.01
"""Gain of the clock that counts rows: the share of a stamp's error that it follows."""
SMOOTHER = 0.9
"""Ratio to the roughness of evenly taken samples below which samples lie at their stamps."""
_LOOKS = ((32, 0.03), (512, 3e-3), (8192, 2e-4))
"""Rows in which a rhythm is sought, and how far around the guess: finer as more of them are in step."""
_BEGIN = 21
"""Stamps that initialise that clock."""


def uneven(time: FloatArray) -> bool:
    """Return whether stamps [s] run forward, but not evenly."""
    steps = np.diff(time)
    if not np.all(np.isfinite(steps)) or np.any(steps < 0.0) or not np.any(steps > 0.0):
        return False
    steps = steps / float(np.median(steps[steps > 0.0]))
    return bool(np.mean(np.abs(steps - np.rint(steps)) > SHAKEN) > OFTEN)


def counted(time: FloatArray) -> tuple[float, Rows]:
    """Sampling time [s] and the row of each stamp; rows that are missing leave gaps in the count."""
    steps = np.diff(time)
    rows = _followed(time, _period(time, float(np.median(steps[steps > 0.0]))))
    return float(np.polyfit(rows, time - time[0], 1)[0]), rows


def _period(time: FloatArray, step: float) -> float:
    """The sampling time [s] in whose rhythm the stamps lie best, near a first guess that lost rows have lengthened."""
    for count, reach in _LOOKS:
        length = min(count, len(time))
        blocks = time[: len(time) // length * length].reshape(-1, length)
        trials = step * (1.0 + np.linspace(-reach, reach, 61))
        rhythm = [np.sum(np.square(np.abs(np.exp(2j * np.pi / one * blocks).sum(axis=1)))) for one in trials]
        step = float(trials[int(np.argmax(rhythm))])
    return step


def _followed(time: FloatArray, step: float) -> Rows:
    turns = np.exp(2j * np.pi / step * (time[:_BEGIN] - time[0]))  # their mean angle: lost rows do not matter
    begin = float(np.angle(turns.mean())) / (2.0 * np.pi) * step
    clock = float(time[0]) + begin
    rows, row = np.zeros(len(time), dtype=np.int64), 0
    for k in range(1, len(time)):
        passed = max(round((time[k] - clock) / step), 1)
        row += passed
        clock += passed * step
        clock += FOLLOWS * (time[k] - clock)
        rows[k] = row
    return rows


def placed_by_stamps(
    columns: Mapping[str, FloatArray], time: FloatArray, rows: Rows, step: float
) -> dict[str, FloatArray] | None:
    """Return the readings at even times, if the samples were taken at their stamps; None if they were even.

    The valve current is left out: it is held for a millisecond, and which one a row has caught is not known.
    """
    offset = float(np.median(time - step * rows))
    even, distinct = offset + step * rows, np.concatenate([[True], np.diff(time) > 0.0])
    names = [name for name in MEASURED if name in columns and np.all(np.isfinite(columns[name]))]
    if not names:
        return None
    moved = {name: CubicSpline(time[distinct], columns[name][distinct])(even) for name in names}
    first = "piston_position" if "piston_position" in names else names[0]
    if white_noise(moved[first]) > SMOOTHER * white_noise(columns[first]):
        return None
    return {name: values for name, values in columns.items() if name != "valve_current"} | moved


def stamped(time: FloatArray, rows: Rows, step: float, *, taken_there: bool) -> list[str]:
    """Notes on uneven stamps, one sentence each."""
    off = time - step * rows
    size = f"the time stamps are uneven by {1e3 * float(np.std(off - np.median(off))):.2g} ms"
    lost = int(rows[-1]) + 1 - len(rows)
    notes = [f"{lost} samples are missing"] if lost else []
    if not taken_there:
        return [*notes, f"{size}, the samples are even: they were placed by counting rows"]
    return [
        *notes,
        f"{size}, and the samples were taken so: the sensors were interpolated to even times; when the valve current "
        "acted is not known to the millisecond, so that the chambers' equations are not checked",
    ]


FROZEN = 40
"""Samples: a noisy sensor that repeats the same number so often has stopped, an encoder may have."""
QUANTA = 10.0
"""Steps of the encoder that it must move at least."""
LOAD_SETTLES, VELOCITY_SETTLES = 0.1, 0.03
"""s after a stop until load cell and velocity show it too."""
AVERAGED = 20
"""Samples over which the load's force is averaged."""
NOISE = 8.0
"""Standard deviations of such a mean that its range must exceed."""
MOVES = 0.2
"""Share of the recording's mean speed that the reported one must have: an offset of a tachometer is no motion."""
Mask = npt.NDArray[np.bool_]


def repeats(values: FloatArray) -> Mask:
    """Samples in which a sensor has stopped: at least `FROZEN` equal values, and what comes after is far from them.

    One that reads in coarse steps may stand at its zero, and goes on by a step or two.
    """
    mask = np.zeros(len(values), dtype=bool)
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    quantum = float(np.min(steps[steps > 0.0], initial=np.inf))
    coarse = float(np.median(steps)) < QUANTA * quantum
    for begin, end in _runs(values):
        goes_on = abs(values[end] - values[end - 1]) <= QUANTA * quantum if end < len(values) else coarse
        mask[begin:end] = not goes_on
    return mask


def frozen_encoder(columns: Mapping[str, FloatArray], step: float, bench: Bench) -> Mask:
    """Samples in which `piston_position` stands though the piston moves; `step` is the sampling time in s."""
    position = columns["piston_position"]
    steps = np.abs(np.diff(position))
    quantum = float(np.min(steps[steps > 0.0], initial=np.inf))
    least = max(MOVING, QUANTA * quantum) if np.isfinite(quantum) else MOVING
    mask = np.zeros(len(position), dtype=bool)
    for begin, end in _runs(position):
        jumps = end < len(position) and abs(position[end] - position[end - 1]) > least
        if jumps or _load_moves(columns, begin, end, step, bench, least) or _glides(columns, begin, end, step, least):
            mask[begin:end] = True
    return mask


def _runs(values: FloatArray) -> list[tuple[int, int]]:
    """First and one past the last sample of every run of at least `FROZEN` equal values."""
    same = np.concatenate([[False], np.diff(values) == 0.0, [False]])
    edges = np.flatnonzero(np.diff(same.astype(np.int8)))
    return [(b, e + 1) for b, e in zip(edges[::2], edges[1::2], strict=True) if e - b >= FROZEN]


def _load_moves(
    columns: Mapping[str, FloatArray], begin: int, end: int, step: float, bench: Bench, least: float
) -> bool:
    """Return whether the load's force changes by what the spring does over `least` [m], and beyond the noise."""
    if "load_force" not in columns or not has_spring(bench):
        return False
    settled = columns["load_force"][begin + round(LOAD_SETTLES / step) : end]
    means = settled[: len(settled) // AVERAGED * AVERAGED].reshape(-1, AVERAGED).mean(axis=1)
    means = means[np.isfinite(means)]
    if len(means) < 2:
        return False
    noise = white_noise(columns["load_force"][np.isfinite(columns["load_force"])])
    return float(np.ptp(means)) > max(bench.spring_stiffness * least, NOISE * noise / AVERAGED**0.5)


def _glides(columns: Mapping[str, FloatArray], begin: int, end: int, step: float, least: float) -> bool:
    """Return whether the reported velocity carries the piston by more than `least` [m]."""
    if "piston_velocity" not in columns:
        return False
    speed = np.abs(columns["piston_velocity"])
    settled = speed[begin + round(VELOCITY_SETTLES / step) : end]
    settled = settled[np.isfinite(settled)]
    if not len(settled):
        return False
    return bool(settled.sum() * step > least and settled.mean() > MOVES * np.nanmean(speed))


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
MOVING = 2e-4
"""m: a segment in which the position moves less (a tripped bench, say) is left out; of a recording in which it moves by
a tenth of it nothing can be diagnosed. An encoder that stands while the piston moves so far is frozen.
"""
REMEDY = (
    "record it with lower gains; if the bench still trips or swings from stop to stop, give the box, not the "
    "diagnosis, a bench.yaml with a valve_nominal_flow that is 25 % higher or more"
)
"""Remedy for a bench that cannot be driven: the velocity term is then compensated only in part."""


def checked(table: RawTable, bench: Bench) -> Recording:
    """Check a recording, and cut it into segments that can be diagnosed.

    Raises UnusableRecordingError: too short, clock broken, nothing moves, or saturated throughout.
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
    bad = _bad_samples(columns, table.time, step, bench, notes)
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
    step = SAMPLE_PERIOD if abs(step - SAMPLE_PERIOD) < SAME * SAMPLE_PERIOD else step
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
        notes.append(_lost(lost, whole, time))
    whole[whole < 0] = 10**6
    return step, np.concatenate([[0], np.cumsum(whole)])


def _lost(lost: int, whole: Rows, time: FloatArray) -> str:
    """Note on missing samples, and where most of them are; `whole`: rows from each sample to the next."""
    gaps = np.where(whole < 10**6, whole, 0)
    most = int(np.argmax(gaps))
    most_of = "" if gaps[most] > lost else f", {gaps[most] - 1} of them"
    return f"{lost} samples are missing{most_of} after {time[most]:.3f} s"


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
        if span < MOVING / 10.0:
            raise UnusableRecordingError(
                f"{name}: the piston position does not change (by {span:.2g} m): nothing can be diagnosed"
            )
        if knows(bench, "stroke"):
            _refuse_outside(name, columns["piston_position"], bench.stroke)
    if "valve_current" in columns:
        limit = SATURATED * bench.valve_current_max
        share = float(np.mean(np.abs(columns["valve_current"]) >= limit))
        if share > 0.6:
            raise UnusableRecordingError(
                f"{name}: the valve current is saturated in {share * 100:.0f} % of the samples: {REMEDY}"
            )


SATURATED = 0.999
"""Share of the largest current from which on the valve is taken to stand at its limit."""
OUTSIDE = 0.2
"""Share of samples beyond the stroke from which the position's zero or the stroke is another."""


def _refuse_outside(name: str, position: FloatArray, stroke: float) -> None:
    if np.mean((position < -STOP_MARGIN) | (position > stroke + STOP_MARGIN)) < OUTSIDE:
        return
    low, high = float(np.nanmin(position)), float(np.nanmax(position))
    raise UnusableRecordingError(
        f"{name}: piston_position runs from {1e3 * low:.4g} to {1e3 * high:.4g} mm, the stroke of the bench from 0 to "
        f"{1e3 * stroke:.4g} mm: "
        + (
            "write the rig's own in the bench file (--bench), or the column's unit in the map"
            if high - low > stroke
            else f"its zero is elsewhere; add it in the map, as in --columns piston_position=piston_position"
            f"{0.5 * (stroke - low - high):+.3g} (judged by the middle of its travel)"
        )
    )


def _stands(columns: dict[str, FloatArray]) -> bool:
    """Return whether the piston stands still in the second half, as it does once the box has tripped."""
    position = columns.get("piston_position", np.zeros(0))
    return len(position) > 0 and float(np.ptp(position[len(position) // 2 :])) < MOVING


def _bad_samples(columns: dict[str, FloatArray], time: FloatArray, step: float, bench: Bench, notes: list[str]) -> Mask:
    bad = np.zeros(len(time), dtype=bool)
    empty: dict[str, list[str]] = {}
    last = len(time) - 1
    for channel, values in columns.items():
        if channel not in MEASURED and channel != "valve_current":
            continue
        missing = ~np.isfinite(values)
        if missing.any():
            count, first = int(missing.sum()), int(np.argmax(missing))
            where = "in the last row: the file ends within it" if first == last else f"from {time[first]:.3f} s on"
            samples = f"in {count} samples " if count > 1 else ""
            empty.setdefault(f"{samples}{where}", []).append(channel)
        frozen = _frozen(channel, columns, step, bench)
        if frozen.any():
            notes.append(f"{channel} is frozen in {int(frozen.sum())} samples; the recording is cut there")
        bad |= missing | frozen
    notes += [f"no number of {', '.join(channels)} {where}" for where, channels in empty.items()]
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
        if name in columns and "valve_current" in columns:  # else no equation of the oil is checked
            outside |= _cavitates(columns[name], bench.tank_pressure)
    if not outside.any():
        return outside
    notes.append(
        f"{int(outside.sum())} samples stand in an end stop or cavitate; they and their surroundings are not judged"
    )
    wide: Mask = np.convolve(outside, np.ones(2 * EVENT_MARGIN + 1), mode="same") > 0.5
    return wide


def _cavitates(pressure: FloatArray, tank: float) -> Mask:
    """Samples whose pressure is too low, alone or in the mean around them, by more than its noise would make it.

    Where the `tank` [Pa] is nearer to nothing than that, gauges count from the atmosphere.
    """
    least = CAVITATION if tank > CAVITATION else -CAVITATION
    known = np.isfinite(pressure)
    noise, pressure = white_noise(pressure[known]), np.where(known, pressure, np.median(pressure[known]))
    found = np.zeros(len(pressure), dtype=bool)
    for count in (1, AVERAGED):
        found |= uniform_filter1d(pressure, count) < least - OUTLYING * noise / count**0.5
    return found


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
