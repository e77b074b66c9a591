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

Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.int64]
SAME = 0.05
"""Share of the box's period by which a logger's may differ and still be the box's."""
BETWEEN = 10
"""Samples from one row of a slow logger to the next at most: its splines bend no faster."""


def on_box_clock(
    name: str, start: float, step: float, rows: Rows, columns: Mapping[str, FloatArray], *, shaken: bool = False
) -> Segment:
    """One stretch without a long gap.

    Parameters
    ----------
    name, start, step
        The recording, s since its start, and s between the logger's rows.
    rows
        Number of each recorded row by the logger's even count, ascending, shape (m,).
    columns
        What was recorded there, by BenchState field, each of shape (m,).
    shaken
        Whether the samples were taken unevenly and placed on an even grid since.
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
    step = SAMPLE_PERIOD if abs(step - SAMPLE_PERIOD) < SAME * SAMPLE_PERIOD else step
    spacing, count = min(max(round(step / SAMPLE_PERIOD), 1), BETWEEN), int(rows[-1]) + 1
    whole = len(rows) == count
    if whole and step == SAMPLE_PERIOD and not shaken:
        return Segment(name, start, step, {key: np.asarray(one, np.float64) for key, one in columns.items()})
    place = (name, start, step / spacing, spacing, (count - 1) * spacing + 1)
    if step == SAMPLE_PERIOD and not shaken:
        thinner = _placed(*place, *_fewer(rows, columns, _gaps_doubled(rows)))
    else:
        fewer, values = _fewer(rows, columns, rows % 2 == 0)
        thinner = _placed(name, start, step / spacing, 2 * spacing, place[-1], fewer * spacing, values)
    return _placed(*place, rows * spacing, columns, thinner)


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


def _fewer(rows: Rows, columns: Mapping[str, FloatArray], kept: Mask) -> tuple[Rows, dict[str, FloatArray]]:
    return rows[kept], {key: values[kept] for key, values in columns.items()}


def _gaps_doubled(rows: Rows) -> Mask:
    """Rows without as many after each gap as the gap has."""
    kept = np.ones(len(rows), dtype=np.bool_)
    for k in np.flatnonzero(np.diff(rows) > 1):
        lost = int(rows[k + 1] - rows[k]) - 1
        kept[k + 1 : k + 1 + lost] = False
    kept[-4:] = True
    return kept


def rate_note(step: float, segment: Segment) -> str:
    """Return a sentence on how a recording's `step` [s] limits the diagnosis."""
    rate = f"recorded at {1.0 / step:.4g} Hz"
    if segment.thinner is None:
        return f"{rate}: of every {round(SAMPLE_PERIOD / step)} rows that at the box's millisecond was taken"
    return (
        f"{rate}, not the box's {1.0 / SAMPLE_PERIOD:.4g} Hz: what happens between two rows is not known; "
        "nothing is claimed "
        "that half of the rows would not show too"
    )
