# SPDX-License-Identifier: Apache-2.0
"""Resampling to the box's clock: the valve current changes once a millisecond, whatever the logger's rate.

From a faster logger, the rows at the box's milliseconds are taken. For a slower one, or one that lost rows, missing
rows are interpolated by splines and never judged; and the same stretch is made again from half of the rows
(`Segment.thinner`): the missing rows may change a residual or a parameter by as much as that does.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_diagnosis.recording import MEASURED, Segment
from hydro_diagnosis.significance import PRACTICAL_SHARE

Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.int64]
BETWEEN = 10
"""Samples from one row of a slow logger to the next at most: its splines bend no faster."""


def on_box_clock(
    name: str, start: float, step: float, rows: Rows, columns: Mapping[str, FloatArray], *, resampled: bool = False
) -> Segment:
    """One stretch without a long gap.

    `name`, `start`, `step`: the recording, s since its start, and s between the logger's rows. `rows`: number of each
    recorded row by the logger's even count, ascending, shape (m,). `columns`: what was recorded there, by BenchState
    field, each of shape (m,). `resampled`: whether they are interpolated from uneven stamps.
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
    spacing, count = min(max(round(step / SAMPLE_PERIOD), 1), BETWEEN), int(rows[-1]) + 1
    even = step == SAMPLE_PERIOD and not resampled
    if even and len(rows) == count:
        return Segment(name, start, step, {key: np.asarray(one, np.float64) for key, one in columns.items()})
    length = (count - 1) * spacing + 1
    kept = np.ones(len(rows), dtype=np.bool_) if even else rows % 2 == 0
    if even:  # without as many rows after each gap as the gap has
        for k in np.flatnonzero(np.diff(rows) > 1):
            kept[k + 1 : k + int(rows[k + 1] - rows[k])] = False
        kept[-4:] = True
    fewer = {key: values[kept] for key, values in columns.items()}
    apart = spacing if even else 2 * spacing
    thinner = _placed(name, start, step / spacing, apart, length, rows[kept] * spacing, fewer)
    return _placed(name, start, step / spacing, spacing, length, rows * spacing, columns, thinner)


def _placed(
    name: str, start: float, step: float, spacing: int, count: int, at: Rows, columns: Mapping[str, FloatArray],
    thinner: Segment | None = None,
) -> Segment:  # fmt: skip
    """`count` samples on the box's clock, of which those `at` were recorded."""
    even, measured = np.arange(count), np.zeros(count, dtype=np.bool_)
    measured[at] = True
    splined = (*MEASURED, "valve_current")  # all others by straight lines
    channels = {
        key: CubicSpline(at, values)(even) if key in splined else np.interp(even, at, values)
        for key, values in columns.items()
    }
    for key, values in columns.items():
        channels[key][at] = values
    held = step / SAMPLE_PERIOD  # of the box's milliseconds, in each of which the current is another
    if "valve_current" in columns and spacing > 1 and held > 1.5:
        channels["valve_current"] = CubicSpline(at, columns["valve_current"])(even + 0.5 * (held - 1.0) / held)
    return Segment(name, start, step, channels, spacing, measured, thinner)
