# SPDX-License-Identifier: Apache-2.0
"""Quality checks: faults are repaired and listed where that is sound, refused in one sentence where it is not.

The result is contiguous segments on an even grid: a recording is cut where samples, numbers or a sensor are missing
for longer than five rows; shorter gaps are interpolated (`box_clock`).

Time stamps: a logger that stamps rows on arrival adds jitter to samples that the box took evenly; one that polls takes
samples unevenly with correct stamps. The alternative with less white noise in the position is taken.

Frozen sensors: a noisy one repeats its value. An encoder is quantised and a piston may stand: it is frozen if its value
repeats while the load force or the reported velocity changes, or if it jumps afterwards. Transients just after a stop
(ringing of the load cell's amplifier, settling of the velocity's filter) do not count.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_diagnosis.bench_parameters import has_spring, is_known
from hydro_diagnosis.io.columns import means, median_step
from hydro_diagnosis.preprocessing.box_clock import Mask, Rows, resample_to_box_clock
from hydro_diagnosis.preprocessing.smoothing import white_noise
from hydro_diagnosis.recording import MEASURED_CHANNELS, Recording, Segment, UnusableRecordingError
from hydro_diagnosis.significance import OUTLIER_FACTOR, PRACTICAL_SHARE
from hydro_sim.model.bench import Bench

if TYPE_CHECKING:
    from hydro_diagnosis.io.table import RawTable


def uneven(time: FloatArray) -> bool:
    """Return whether stamps [s] never decrease, but over 5 % of their steps are off multiples of the median by 2 %."""
    steps = np.diff(time)
    if not np.all(np.isfinite(steps)) or np.any(steps < 0.0) or not np.any(steps > 0.0):
        return False
    steps = steps / float(np.median(steps[steps > 0.0]))
    return bool(np.mean(np.abs(steps - np.rint(steps)) > 0.02) > 0.05)


def sampling_grid(time: FloatArray) -> tuple[float, Rows]:
    """Return the sampling time [s] and the row index of each stamp, (n,); missing rows leave gaps in the indices."""
    step = median_step(time)  # too long if rows were lost
    for count, reach in ((32, 0.03), (512, 3e-3), (8192, 2e-4)):  # finer as longer blocks stay in phase
        length = min(count, len(time))
        blocks = time[: len(time) // length * length].reshape(-1, length)
        trials = step * (1.0 + np.linspace(-reach, reach, 61))
        rhythm = [np.sum(np.square(np.abs(np.exp(2j * np.pi / one * blocks).sum(axis=1)))) for one in trials]
        step = float(trials[int(np.argmax(rhythm))])
    turns = np.exp(2j * np.pi / step * (time[:21] - time[0]))  # mean phase, insensitive to lost rows
    clock = float(time[0]) + float(np.angle(turns.mean())) / (2.0 * np.pi) * step
    rows, row = np.zeros(len(time), dtype=np.int64), 0
    for k in range(1, len(time)):
        passed = max(round((time[k] - clock) / step), 1)
        row += passed
        clock += passed * step
        clock += 0.01 * (time[k] - clock)  # tracks slow drift of the stamps
        rows[k] = row
    return float(np.polyfit(rows, time - time[0], 1)[0]), rows


def _stamped(
    columns: dict[str, FloatArray], time: FloatArray, notes: list[str]
) -> tuple[dict[str, FloatArray], float, Rows, bool]:
    """Readings at even times, the sampling time [s], rows, and whether the samples were taken at their uneven stamps.

    The valve current is then left out: it is held for a millisecond, and which one a row has caught is not known.
    """
    step, rows = sampling_grid(time)
    off = time - step * rows
    even, distinct = float(np.median(off)) + step * rows, np.concatenate([[True], np.diff(time) > 0.0])
    names = [name for name in MEASURED_CHANNELS if name in columns and np.all(np.isfinite(columns[name]))]
    moved = {name: CubicSpline(time[distinct], columns[name][distinct])(even) for name in names}
    first = "piston_position" if "piston_position" in names else next(iter(names), "")
    taken_there = bool(names) and not white_noise(moved[first]) > 0.9 * white_noise(columns[first])
    if lost := int(rows[-1]) + 1 - len(rows):
        notes.append(f"{lost} samples are missing")
    size = f"the time stamps are uneven by {1e3 * float(np.std(off - np.median(off))):.2g} ms"
    if not taken_there:
        notes.append(f"{size}, the samples are even: they were placed by counting rows")
        return columns, step, rows, False
    notes.append(f"{size}, as the samples are: they were interpolated, and the chambers' equations are not checked")
    others = {name: values for name, values in columns.items() if name != "valve_current"}
    return others | moved, step, rows, True


MIN_CHANGE_QUANTA = 10.0
"""Quantisation steps by which a sensor's value must change to count as moved."""
AVERAGED_SAMPLES = 20
"""Samples over which load force and pressures are averaged."""


def repeated_values(values: FloatArray) -> Mask:
    """Mask of frozen samples of a noisy sensor, (n,): runs of at least 40 equal values that end in a jump.

    A run at the end of the recording is frozen unless the sensor resolves coarsely, and so may rest at its zero.
    """
    mask = np.zeros(len(values), dtype=bool)
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    quantum = float(np.min(steps[steps > 0.0], initial=np.inf))
    coarse = float(np.median(steps)) < MIN_CHANGE_QUANTA * quantum
    for begin, end in _runs(values):
        goes_on = abs(values[end] - values[end - 1]) <= MIN_CHANGE_QUANTA * quantum if end < len(values) else coarse
        mask[begin:end] = not goes_on
    return mask


def frozen_encoder(columns: Mapping[str, FloatArray], step: float, bench: Bench) -> Mask:
    """Mask of the samples, (n,), in which `piston_position` repeats but the piston moves; `step`: sampling time [s]."""
    position = columns["piston_position"]
    steps = np.abs(np.diff(position))
    quantum = float(np.min(steps[steps > 0.0], initial=np.inf))
    least = max(least_travel(position, bench), MIN_CHANGE_QUANTA * quantum if np.isfinite(quantum) else 0.0)

    def load_moves(begin: int, end: int) -> bool:
        """Return whether the load force changes by more than the spring's over `least`, and by more than its noise."""
        if "load_force" not in columns or not has_spring(bench):
            return False
        force = columns["load_force"]
        averaged = means(force[begin + round(0.1 / step) : end], AVERAGED_SAMPLES)
        averaged = averaged[np.isfinite(averaged)]
        if len(averaged) < 2:
            return False
        noise = white_noise(force[np.isfinite(force)]) / AVERAGED_SAMPLES**0.5
        return float(np.ptp(averaged)) > max(bench.spring_stiffness * least, 8.0 * noise)

    def glides(begin: int, end: int) -> bool:
        """Return whether the reported velocity moves the piston by over `least`; a tachometer's offset is no motion."""
        if "piston_velocity" not in columns:
            return False
        speed = np.abs(columns["piston_velocity"])
        settled = speed[begin + round(0.03 / step) : end]
        settled = settled[np.isfinite(settled)]
        return bool(settled.sum() * step > least and settled.mean() > 0.2 * np.nanmean(speed))

    mask = np.zeros(len(position), dtype=bool)
    for begin, end in _runs(position):
        jumps = end < len(position) and abs(position[end] - position[end - 1]) > least
        mask[begin:end] = jumps or load_moves(begin, end) or glides(begin, end)
    return mask


def _runs(values: FloatArray) -> list[tuple[int, int]]:
    """First and one past the last sample of every run of at least 40 equal values.

    A noisy sensor with such a run is frozen, an encoder may be.
    """
    same = np.concatenate([[False], np.diff(values) == 0.0, [False]])
    edges = np.flatnonzero(np.diff(same.astype(np.int8)))
    return [(b, e + 1) for b, e in zip(edges[::2], edges[1::2], strict=True) if e - b >= 40]


MIN_SEGMENT_TIME, MIN_STROKE_TIME = 1.5, 0.4
"""Shortest segment [s] that is used; the second where longer ones hold less than half of the samples, as of a fast
cylinder from stop to stop."""
STOP_MARGIN = 0.006
"""Distance from an end stop, over the stroke, within which samples are excluded."""
_MIN_TRAVEL = 0.0025
SATURATION_SHARE = 0.999
"""Share of the largest valve current from which the valve counts as saturated."""
REMEDY = "record it with lower gains, or give the box a bench.yaml with a larger valve_nominal_flow"
"""Advice for a bench that trips or saturates; with a larger nominal flow the law compensates the velocity in part."""


def least_travel(position: FloatArray, bench: Bench) -> float:
    """Return the range [m] of the position below which a segment (of a tripped bench, say) is omitted.

    Below a tenth of it a recording is refused. An encoder that repeats its value while the piston moves so far is
    frozen. It is a four-hundredth of the stroke, or of the range recorded where the stroke is unknown.
    """
    known = position[np.isfinite(position)]
    length = bench.stroke if is_known(bench, "stroke") else float(np.ptp(known))
    return max(_MIN_TRAVEL * length, OUTLIER_FACTOR * white_noise(known))


def check_recording(table: RawTable, bench: Bench) -> Recording:
    """Check a recording, and cut it into segments that can be diagnosed.

    Raises UnusableRecordingError: too short, invalid times, no sensor or motion, outside the stroke, or saturated.
    """
    notes: list[str] = []
    columns: dict[str, FloatArray] = {}
    for name, values in table.columns.items():
        finite = values[np.isfinite(values)]
        if len(finite) < 0.5 * len(values):
            notes.append(f"{name} is missing in most samples and was left out")
        elif name not in MEASURED_CHANNELS or name == "piston_position" or np.ptp(finite) > 0.0:
            columns[name] = values
        elif np.any(finite != 0.0):
            notes.append(f"{name} is frozen throughout and was left out")
    resampled = False
    if table.sample is None and uneven(table.time):
        columns, step, index, resampled = _stamped(columns, table.time, notes)
    else:
        step, index = _grid(table, notes)
    if not any(name in columns for name in MEASURED_CHANNELS):
        raise UnusableRecordingError(f"{table.name}: no sensor in it is alive")
    _refuse_useless(table.name, columns, bench)
    bad = _bad_samples(columns, table.time, step, bench, notes)
    outside = _outside_equations(columns, bench, notes)
    segments = _segments(table.name, step, index, columns, bad | outside, bench, notes, resampled)
    if not segments:
        raise UnusableRecordingError(
            f"{table.name}: the bench moves without a gap for less than {MIN_STROKE_TIME:g} s: "
            + "; ".join([*notes, REMEDY if outside.any() else "record 20 s of motion or more"])
        )
    return Recording(table.name, tuple(segments), tuple(f"{table.name}: {note}" for note in (*table.notes, *notes)))


def _grid(table: RawTable, notes: list[str]) -> tuple[float, Rows]:
    """Sampling time [s] and the row index of each sample on an even grid; backward steps become gaps."""
    time, gap = table.time, 10**6
    if len(time) < 3 or np.count_nonzero(np.isfinite(time)) < 3:
        raise UnusableRecordingError(f"{table.name}: the recording is empty")
    steps = np.diff(time)
    forward = steps[np.isfinite(steps) & (steps > 0.0)]
    if len(forward) < 0.5 * len(steps):
        raise UnusableRecordingError(f"{table.name}: the time does not run forward")
    step = float(np.median(forward))
    step = SAMPLE_PERIOD if abs(step - SAMPLE_PERIOD) < PRACTICAL_SHARE * SAMPLE_PERIOD else step
    counts = np.diff(table.sample) if table.sample is not None else steps / step
    whole = np.rint(np.where(np.isfinite(counts), counts, gap)).astype(np.int64)
    off = np.abs(steps - whole * step) > max(5e-3, 2.0 * step)
    jumps = int(np.count_nonzero(off & np.isfinite(steps)))
    if jumps and table.sample is not None:
        whole[off] = gap
        notes.append(f"the clock jumps {jumps} times; the recording is cut there")
    back = int(np.count_nonzero(whole < 0))
    if back:
        notes.append(f"the time steps back {back} times; the recording is cut there")
    lost = int(np.sum(whole[(whole > 1) & (whole < gap)] - 1))
    if lost:
        notes.append(
            f"{lost} samples are missing, the first after {time[int(np.argmax((whole > 1) & (whole < gap)))]:.3f} s"
        )
    whole[whole < 0] = gap
    return step, np.concatenate([[0], np.cumsum(whole)])


def _refuse_useless(name: str, columns: dict[str, FloatArray], bench: Bench) -> None:
    """Refuse a standing piston, a position outside the stroke, and a valve saturated in most samples."""
    if "piston_position" in columns:
        position, stroke = columns["piston_position"], bench.stroke
        low, high = float(np.nanmin(position)), float(np.nanmax(position))
        if high - low < least_travel(position, bench) / 10.0:
            raise UnusableRecordingError(
                f"{name}: the piston position does not change (by {high - low:.2g} m): nothing can be diagnosed"
            )
        beyond = (position < -STOP_MARGIN * stroke) | (position > (1.0 + STOP_MARGIN) * stroke)
        if is_known(bench, "stroke") and np.mean(beyond) >= 0.2:
            raise UnusableRecordingError(
                f"{name}: piston_position runs from {1e3 * low:.4g} to {1e3 * high:.4g} mm, the stroke of the bench "
                f"from 0 to {1e3 * stroke:.4g} mm: correct the bench file's stroke, or the column's unit or zero"
            )
    if "valve_current" in columns:
        share = float(np.mean(np.abs(columns["valve_current"]) >= SATURATION_SHARE * bench.valve_current_max))
        if share > 0.6:
            raise UnusableRecordingError(
                f"{name}: the valve current is saturated in {share * 100:.0f} % of the samples: {REMEDY}"
            )


def _bad_samples(columns: dict[str, FloatArray], time: FloatArray, step: float, bench: Bench, notes: list[str]) -> Mask:
    """Mask of the samples without a number or with a frozen sensor, (n,)."""
    bad = np.zeros(len(time), dtype=bool)
    for channel in (name for name in columns if name in (*MEASURED_CHANNELS, "valve_current")):
        values = columns[channel]
        missing = ~np.isfinite(values)
        bad |= missing
        if missing.any():
            first = time[int(np.argmax(missing))]
            notes.append(f"{channel} has no number in {int(missing.sum())} samples, the first at {first:.3f} s")
        if channel == "valve_current":
            continue  # a command, which may be constant
        frozen = frozen_encoder(columns, step, bench) if channel == "piston_position" else repeated_values(values)
        bad |= frozen
        if frozen.any():
            notes.append(f"{channel} is frozen in {int(frozen.sum())} samples; the recording is cut there")
    return bad


def _outside_equations(columns: dict[str, FloatArray], bench: Bench, notes: list[str]) -> Mask:
    """Mask of the samples within 100 of an end stop or of cavitation, which no equation here describes, (n,).

    A chamber cavitates if its pressure, or the moving average, is below half a bar by more than the noise; below minus
    half a bar if gauges read relative to the atmosphere: the tank pressure is at most half a bar, or a fifth of the
    samples would cavitate.
    """
    outside = np.zeros(len(next(iter(columns.values()))), dtype=bool)
    if "piston_position" in columns and is_known(bench, "stroke"):
        position = columns["piston_position"]
        outside |= (position < STOP_MARGIN * bench.stroke) | (position > (1.0 - STOP_MARGIN) * bench.stroke)
    checked = [name for name in ("pressure_a", "pressure_b") if name in columns and "valve_current" in columns]

    def below(least: float) -> Mask:
        mask = np.zeros_like(outside)
        for pressure in (columns[name] for name in checked):  # else no equation of the oil is checked
            known = np.isfinite(pressure)
            noise, pressure = white_noise(pressure[known]), np.where(known, pressure, np.median(pressure[known]))
            for count in (1, AVERAGED_SAMPLES):
                mask |= uniform_filter1d(pressure, count) < least - OUTLIER_FACTOR * noise / count**0.5
        return mask

    empty = below(5e4 if bench.tank_pressure > 5e4 else -5e4)
    if bench.tank_pressure > 5e4 and np.mean(empty) > 0.2:
        notes.append(
            f"the pressures are about 0 in {100.0 * float(np.mean(empty)):.0f} % of the samples, as gauges read; "
            "if they are relative to the atmosphere, so must be the bench file's tank_pressure and supply_pressure"
        )
        empty = below(-5e4)
    outside |= empty
    if not outside.any():
        return outside
    notes.append(
        f"{int(outside.sum())} samples stand in an end stop or cavitate; they and their surroundings are not judged"
    )
    wide: Mask = np.convolve(outside, np.ones(201), mode="same") > 0.5
    return wide


def _segments(
    name: str,
    step: float,
    index: Rows,
    columns: dict[str, FloatArray],
    bad: Mask,
    bench: Bench,
    notes: list[str],
    resampled: bool,
) -> list[Segment]:
    """Segments on the box's clock, cut where more than five rows are missing."""
    good = np.flatnonzero(~bad)
    if len(good) < 2:
        return []
    unique, first = np.unique(index[good], return_index=True)
    if len(unique) < len(good):
        notes.append(f"{len(good) - len(unique)} samples come twice; the first was kept")
    rows = good[first]
    cuts = np.flatnonzero(np.diff(unique) > 6) + 1
    pieces = list(zip([0, *cuts.tolist()], [*cuts.tolist(), len(unique)], strict=True))
    lengths = [int(unique[end - 1] - unique[begin]) + 1 for begin, end in pieces]
    long = sum(length for length in lengths if length * step >= MIN_SEGMENT_TIME)
    least = MIN_SEGMENT_TIME if long >= 0.5 * sum(lengths) else MIN_STROKE_TIME
    travel = least_travel(columns["piston_position"], bench) if "piston_position" in columns else 0.0
    segments, bridged, short, still = [], 0, 0, 0
    for (begin, end), length in zip(pieces, lengths, strict=True):
        at = unique[begin:end]
        found = {key: values[rows[begin:end]] for key, values in columns.items()}
        if length * step < least:
            short += length
        elif "piston_position" in found and np.ptp(found["piston_position"]) < travel:
            still += length
        else:
            bridged += length - len(at)
            start = float(min(at[0] - unique[0], 10**5) * step)
            segments.append(resample_to_box_clock(name, start, step, at, found, resampled=resampled))
    if bridged:
        notes.append(f"{bridged} missing samples were bridged by splines; they and their neighbours are not judged")
    if segments and abs(step - SAMPLE_PERIOD) > PRACTICAL_SHARE * SAMPLE_PERIOD:
        rate = f"recorded at {1.0 / step:.4g} Hz"
        notes.append(
            f"{rate}: of every {round(SAMPLE_PERIOD / step)} rows that at the box's millisecond was taken"
            if segments[0].half_rows is None
            else f"{rate}: nothing is claimed that half of the rows would not show too"
        )
    if still:
        notes.append(f"{still} samples in which the piston stands still were not used")
    if short:
        notes.append(f"{short} samples stand in stretches shorter than {least:g} s and were not used")
    return segments
