# SPDX-License-Identifier: Apache-2.0
"""Resampling to the box's clock: the valve current changes once a millisecond, whatever the logger's rate.

From a faster logger, one row per box sample is taken. For a slower one, or one that lost rows, missing rows are
interpolated by splines and excluded from the residuals. The same stretch is also interpolated from half of the rows
(`Segment.half_rows`): the difference estimates the effect of missing rows on residuals and parameters.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_diagnosis.recording import MEASURED_CHANNELS, Segment
from hydro_diagnosis.significance import PRACTICAL_SHARE

Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.int64]
MAX_SAMPLES_PER_ROW = 10
"""Largest number of samples per row of a slow logger: its splines resolve no faster motion."""


def resample_to_box_clock(
    name: str, start: float, step: float, rows: Rows, columns: Mapping[str, FloatArray], *, resampled: bool = False
) -> Segment:
    """Resample a stretch without long gaps to the box's clock.

    `name`, `start`, `step`: the recording, the stretch's start in it [s], and the logger's row spacing [s]. `rows`:
    index of each recorded row on the logger's even grid, ascending, shape (m,). `columns`: recorded values by
    BenchState field, each of shape (m,). `resampled`: whether they are interpolated from uneven stamps.
    """
    rows, skipped = rows - rows[0], round(SAMPLE_PERIOD / step)
    if skipped > 1:  # the current changes at the box's milliseconds, and is held until the next
        current = columns.get("valve_current", np.zeros(len(rows)))
        changed = rows[1:][np.diff(current) != 0.0]
        begin = int(np.argmax(np.bincount(changed % skipped, minlength=skipped)))
        at = (rows >= begin) & ((rows - begin) % skipped == 0)
        rows, step, start = (rows[at] - begin) // skipped, step * skipped, start + begin * step
        columns = {key: values[at] for key, values in columns.items()}
        start, rows = start + rows[0] * step, rows - rows[0]
    step = SAMPLE_PERIOD if abs(step - SAMPLE_PERIOD) < PRACTICAL_SHARE * SAMPLE_PERIOD else step
    spacing, count = min(max(round(step / SAMPLE_PERIOD), 1), MAX_SAMPLES_PER_ROW), int(rows[-1]) + 1
    even = step == SAMPLE_PERIOD and not resampled
    if even and len(rows) == count:
        return Segment(name, start, step, {key: np.asarray(one, np.float64) for key, one in columns.items()})
    length = (count - 1) * spacing + 1
    kept = np.ones(len(rows), dtype=np.bool_) if even else rows % 2 == 0
    if even:  # `half_rows` lacks as many further rows after each gap as the gap has
        for k in np.flatnonzero(np.diff(rows) > 1):
            kept[k + 1 : k + int(rows[k + 1] - rows[k])] = False
        kept[-4:] = True
    fewer = {key: values[kept] for key, values in columns.items()}
    apart = spacing if even else 2 * spacing
    half_rows = _placed(name, start, step / spacing, apart, length, rows[kept] * spacing, fewer)
    return _placed(name, start, step / spacing, spacing, length, rows * spacing, columns, half_rows)


def _placed(
    name: str, start: float, step: float, spacing: int, count: int, at: Rows, columns: Mapping[str, FloatArray],
    half_rows: Segment | None = None,
) -> Segment:  # fmt: skip
    """Segment of `count` samples, interpolated from the recorded ones at indices `at`."""
    even, measured = np.arange(count), np.zeros(count, dtype=np.bool_)
    measured[at] = True
    splined = (*MEASURED_CHANNELS, "valve_current")  # all others by straight lines
    channels = {
        key: CubicSpline(at, values)(even) if key in splined else np.interp(even, at, values)
        for key, values in columns.items()
    }
    for key, values in columns.items():
        channels[key][at] = values
    held = step / SAMPLE_PERIOD  # box samples, each with its own current, per sample of the segment
    if "valve_current" in columns and spacing > 1 and held > 1.5:
        channels["valve_current"] = CubicSpline(at, columns["valve_current"])(even + 0.5 * (held - 1.0) / held)
    return Segment(name, start, step, channels, spacing, measured, half_rows)
