# SPDX-License-Identifier: Apache-2.0
"""Channels that a logger has filled up to a faster clock: their own samples, and the clock of these.

A slower channel stands in every n-th row alone, is held for n rows, or goes on in straight lines over n rows. Its
steps (held) or bends (straight lines) then fall on every n-th row: nine tenths of their energy, in each of many blocks.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hydro_core.signals import FloatArray
from hydro_diagnosis.io.columns import median_step

_MAX_ROWS = 200
"""Largest number of rows from sample to sample."""
_SHARE = 0.9
_BLOCKS = 20


def own_rows(time: FloatArray, values: FloatArray) -> tuple[npt.NDArray[np.int64], str]:
    """Rows of a channel's own samples, and how the others were filled; empty if all rows are its own.

    `time`: of the rows, in any unit, shape (n,); `values`: shape (n,).
    """
    none = np.empty(0, dtype=np.int64)
    if len(time) != len(values) or len(time) < 100 or not np.isfinite(time).all():
        return none, ""
    steps, finite = np.diff(time), np.flatnonzero(np.isfinite(values))
    index = np.arange(len(time))
    if np.mean(steps > 0.0) > 0.9:  # counted by the times, since rows may be lost
        index = np.rint((time - time[0]) / median_step(time)).astype(np.int64)
    if 3 <= len(finite) < 0.7 * len(values):
        gaps = np.diff(index[finite])
        regular = np.median(gaps) > 1.0 and np.mean(gaps == np.median(gaps)) > _SHARE
        return (finite, "stands in some of the rows alone") if regular else (none, "")
    if len(finite) < len(values):
        values = np.interp(index, index[finite], values[finite])
    held, bent = np.diff(values), np.diff(values, 2)
    for change, at, how in ((held, index[1:], "is held"), (bent, index[1:-1], "goes on in straight lines")):
        rows, first = _period(change, at)
        if rows:
            return np.flatnonzero((index - first) % rows == 0), f"{how} over {rows} rows"
    return none, ""


def _period(change: FloatArray, at: npt.NDArray[np.int64]) -> tuple[int, int]:
    """Period and phase of the rows `at` on which a channel's changes fall; (0, 0) if there is none.

    The changes are compared within blocks, so that no single jump decides.
    """
    change, at = change[:200_000], at[:200_000]
    if not np.any(change) or np.mean(np.abs(change) < 1e-3 * np.std(change)) < 0.4:
        return 0, 0
    block = np.arange(len(change)) * _BLOCKS // len(change)
    energy = np.square(change)
    sums = np.bincount(block, energy, _BLOCKS)
    energy /= np.where(sums > 0.0, sums, 1.0)[block]
    for rows in range(2, min(_MAX_ROWS, len(change) // (3 * _BLOCKS)) + 1):
        phases = np.bincount(at % rows, energy, rows)
        if phases.max() > _SHARE * energy.sum():
            # the longest period with this property: a multiple of this one shares it where the channel is slower still
            longer = [k for k in range(2 * rows, _MAX_ROWS + 1, rows)
                      if np.bincount(at % k, energy, k).max() > _SHARE * energy.sum()]  # fmt: skip
            rows = max([rows, *longer])
            if np.count_nonzero(np.abs(change) > 1e-3 * np.std(change)) < 0.3 * len(change) / rows:
                return 0, 0  # a command of few steps or ramps, which rests or goes on evenly between them
            return rows, int(np.argmax(np.bincount(at % rows, energy, rows)))
    return 0, 0
