# SPDX-License-Identifier: Apache-2.0
"""Uneven time stamps: the row of each by a tracking clock, and whether the samples were taken at their stamps.

A logger that stamps rows on arrival adds jitter to the stamps of samples that the box took evenly; one that polls when
it can takes samples unevenly with correct stamps. The recording itself decides: placed correctly, it is smoother.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.preprocessing.white_noise import white_noise
from hydro_diagnosis.recording import MEASURED

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
