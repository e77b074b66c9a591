# SPDX-License-Identifier: Apache-2.0
"""Responses of many terms in the residuals, fold by fold, and their products with the columns of a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from hydro_diagnosis.closure.evidence import BLOCK, FOLDS
from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.estimation.layout import CHANNELS, Layout

ROWS = 40000
"""Residuals of a channel beyond which only every second, third ... is taken."""
CHUNK = 64
"""Terms whose responses are multiplied at a time."""
Chunk = tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]
"""Places of terms, and their responses, shape (terms, rows)."""


class FoldedResponses:
    """Responses of `terms` terms, added law by law.

    Attributes
    ----------
    every
        Only every so many residuals are looked at.
    count
        Residuals of each channel that are, shape (channels,).
    square
        Of each term with itself, shape (folds, channels, terms).
    """

    def __init__(self, layout: Layout, terms: int) -> None:
        self.every = max(int(layout.count().max()) // ROWS, 1)
        fold = (np.floor(layout.time / BLOCK).astype(np.int64) + layout.segment) % FOLDS
        kept = [np.flatnonzero(layout.channel == k)[:: self.every] for k in range(len(CHANNELS))]
        self._order = [np.argsort(fold[rows], kind="stable") for rows in kept]
        self._rows = [rows[order] for rows, order in zip(kept, self._order, strict=True)]
        self._folds = [np.searchsorted(fold[rows], np.arange(FOLDS + 1)) for rows in self._rows]
        self.count = np.array([len(rows) for rows in self._rows], dtype=np.float64)
        self.square = np.zeros((FOLDS, len(CHANNELS), terms))
        self._chunks: dict[int, list[Chunk]] = {}
        self._waiting: dict[int, list[Chunk]] = {}

    def add(self, places: npt.NDArray[np.int64], shown: Mapping[int, FloatArray]) -> None:
        """Take the responses of a law's terms by channel, shape (terms, residuals of the channel)."""
        for channel, columns in shown.items():
            thinned = columns[:, :: self.every].astype(np.float32)[:, self._order[channel]]
            self._waiting.setdefault(channel, []).append((places, thinned))
            if sum(len(one) for one, _ in self._waiting[channel]) >= CHUNK:
                self._keep(channel, self._waiting.pop(channel))

    def finish(self) -> None:
        """Take what was added last."""
        for channel in list(self._waiting):
            self._keep(channel, self._waiting.pop(channel))

    def _keep(self, channel: int, chunks: Sequence[Chunk]) -> None:
        places, columns = (np.concatenate(one) for one in zip(*chunks, strict=True))
        self._chunks.setdefault(channel, []).append((places, columns))
        for k, (begin, end) in enumerate(pairwise(self._folds[channel])):
            part = columns[:, begin:end]
            self.square[k, channel, places] = np.einsum("ij,ij->i", part, part)

    def products(self, standing: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Products of standing columns, shape (residuals, columns), with each other and with the terms.

        Returns
        -------
        Shapes (folds, channels, columns, columns) and (folds, channels, columns, terms).
        """
        width = standing.shape[1]
        own = np.zeros((FOLDS, len(CHANNELS), width, width))
        cross = np.zeros((FOLDS, len(CHANNELS), width, self.square.shape[-1]))
        for channel, rows in enumerate(self._rows):
            looked_at = standing[rows]
            for k, (begin, end) in enumerate(pairwise(self._folds[channel])):
                part = looked_at[begin:end]
                own[k, channel] = part.T @ part
                single = part.astype(np.float32)
                for places, columns in self._chunks.get(channel, ()):
                    cross[k, channel][:, places] = (columns[:, begin:end] @ single).T
        return own, cross
