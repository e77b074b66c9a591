# SPDX-License-Identifier: Apache-2.0
"""The replay buffer: a rolling table of transitions, one row each, so that a batch is one gather."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


@dataclass(frozen=True)
class Batch:
    """Transitions (o, a, r, o', terminated): [batch, n] each, reward and terminated [batch]."""

    observation: Tensor
    action: Tensor
    reward: Tensor
    next_observation: Tensor
    terminated: Tensor


class ReplayBuffer:
    """The last `capacity` transitions.

        row        [ observation | next observation | action | reward, terminated ]   float32
        example    13 + 13 + 2 + 2 = 30 numbers; 288 000 rows (the paper's 160 x 1800) are 35 MB

    Parameters
    ----------
    observations, actions
        Sizes of an observation and of an action.
    capacity
        Rows kept; the oldest are overwritten.
    """

    def __init__(self, observations: int, actions: int, capacity: int) -> None:
        self.widths = (observations, observations, actions, 1, 1)
        self.rows: NDArray[np.float32] = np.zeros((capacity, sum(self.widths)), dtype=np.float32)
        self._tensor = torch.from_numpy(self.rows)
        self.size = 0
        self.cursor = 0

    def __len__(self) -> int:
        return self.size

    def extend(self, rows: NDArray[np.float32]) -> None:
        """Append rows [n, width] in order; the oldest make room. Rows with a value that is not finite are refused.

        Raises
        ------
        ValueError
            A row holds NaN or infinity: it would poison every network at the first batch that draws it.
        """
        if not np.isfinite(rows).all():
            raise ValueError("a transition holds a value that is not finite")
        rows = rows[-len(self.rows) :]
        places = (self.cursor + np.arange(len(rows))) % len(self.rows)
        self.rows[places] = rows
        self.cursor = int((self.cursor + len(rows)) % len(self.rows))
        self.size = min(self.size + len(rows), len(self.rows))

    def sample(self, batch_size: int, generator: torch.Generator) -> Batch:
        """Draw `batch_size` transitions uniformly, with replacement."""
        places = torch.randint(self.size, (batch_size,), generator=generator)
        observation, following, action, reward, terminated = self._tensor.index_select(0, places).split(self.widths, dim=1)
        return Batch(observation, action, reward.squeeze(1), following, terminated.squeeze(1))

    def stored(self) -> NDArray[np.float32]:
        """All rows held, oldest first (a copy)."""
        if self.size < len(self.rows):
            return self.rows[: self.size].copy()
        return np.roll(self.rows, -self.cursor, axis=0)
