# SPDX-License-Identifier: Apache-2.0
"""Which channel, which recording and which time each entry of a residual vector belongs to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from hydro_diagnosis.effects.base import HYDRAULIC, FloatArray
from hydro_diagnosis.model.segment_model import BLOCKS, SegmentModel

CHANNELS = ("pressure_a", "pressure_b", "motion", "load", "hydraulic")


@dataclass(frozen=True)
class Layout:
    """Assignment of a residual vector's entries to channels: `channel[i]` indexes `CHANNELS`."""

    channel: np.ndarray[Any, np.dtype[np.int64]]
    segment: np.ndarray[Any, np.dtype[np.int64]]
    time: FloatArray

    @classmethod
    def of(cls, blocks: Sequence[str], models: Sequence[SegmentModel]) -> Layout:
        """Return that of these blocks, channel by channel and in each segment by segment."""
        channel, segment, time = [], [], []
        for block in blocks:
            for name in BLOCKS[block]:
                for k, model in enumerate(models):
                    at = model.block_time() if block == HYDRAULIC else model.kept_time()
                    channel.append(np.full(len(at), CHANNELS.index(name)))
                    segment.append(np.full(len(at), k))
                    time.append(at)
        return cls(np.concatenate(channel), np.concatenate(segment), np.concatenate(time))

    def count(self) -> FloatArray:
        """Entries per channel, shape (5,)."""
        return self._count

    def squares(self, residual: FloatArray) -> FloatArray:
        """Sum of each channel's squares, shape (5,)."""
        sums = np.zeros(len(CHANNELS))
        for index, begin, end in self._stretches:
            part = residual[begin:end]
            sums[index] += part @ part
        return sums

    @cached_property
    def _count(self) -> FloatArray:
        return np.bincount(self.channel, minlength=len(CHANNELS)).astype(np.float64)

    @cached_property
    def _stretches(self) -> list[tuple[int, int, int]]:
        """Channel, begin and end of the stretches of one channel each."""
        edges = [0, *(np.flatnonzero(np.diff(self.channel)) + 1).tolist(), len(self.channel)]
        return [(int(self.channel[begin]), begin, end) for begin, end in pairwise(edges)]
