# SPDX-License-Identifier: Apache-2.0
"""Replay buffer: a ring of transitions, one row each, so that a batch is one gather.

It can be in memory shared between the acting process, which appends, and the learner process, which draws: nothing is
sent, and nothing is lost when the learner dies.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

_COUNTER_BYTES = 64  # a separate cache line
_MARGIN = 64  # oldest rows of a full buffer that are not drawn: the other process may be overwriting them


class ReplayBuffer:
    """The last `capacity` transitions.

        row        [ observation | next observation | action | reward, terminated ]   float32
        example    13 + 13 + 2 + 2 = 30 numbers; 288 000 rows (the paper's 160 x 1800) are 35 MB

    `observations`, `actions`: sizes of an observation and of an action. `capacity`: rows kept, more than 64; the oldest
    are overwritten. `memory`: writable buffer of `nbytes` bytes, initially zero. None: private memory.
    """

    def __init__(self, observations: int, actions: int, capacity: int, memory: object | None = None) -> None:
        if capacity <= _MARGIN:
            raise ValueError(f"a replay buffer holds more than {_MARGIN} transitions, not {capacity}")
        self.widths = (observations, observations, actions, 1, 1)
        if memory is None:
            memory = bytearray(self.nbytes(observations, actions, capacity))
        self._counter = np.frombuffer(memory, np.int64, 1)  # type: ignore[call-overload]
        rows = np.frombuffer(memory, np.float32, capacity * sum(self.widths), _COUNTER_BYTES)  # type: ignore[call-overload]
        self.rows: NDArray[np.float32] = rows.reshape(capacity, -1)

    @staticmethod
    def nbytes(observations: int, actions: int, capacity: int) -> int:
        """Return the bytes needed for a buffer of these sizes."""
        return _COUNTER_BYTES + 4 * capacity * (2 * observations + actions + 2)

    @property
    def produced(self) -> int:
        """Transitions ever appended."""
        return int(self._counter[0])

    def __len__(self) -> int:
        return min(self.produced, len(self.rows))

    def extend(self, rows: NDArray[np.float32]) -> None:
        """Append rows [n, width] in order, overwriting the oldest. Only one process may do this.

        Raises ValueError: a row holds NaN or infinity, which would corrupt every network at the first batch with it.
        """
        if not np.isfinite(rows).all():
            raise ValueError("a transition holds a value that is not finite")
        kept = rows[-len(self.rows) :]
        first = self.produced + len(rows) - len(kept)
        self.rows[(first + np.arange(len(kept))) % len(self.rows)] = kept
        self._counter[0] = first + len(kept)  # after the rows: a reader that sees the count finds them complete

    def draw(self, count: int, generator: torch.Generator) -> Tensor:
        """Draw the indices in `rows` of `count` transitions, uniformly, with replacement."""
        produced, capacity = self.produced, len(self.rows)
        if produced < capacity:
            return torch.randint(produced, (count,), generator=generator)
        ages = torch.randint(capacity - _MARGIN, (count,), generator=generator)
        return (produced - 1 - ages) % capacity

    def stored(self) -> tuple[NDArray[np.float32], int]:
        """Return a copy of all stored rows, oldest first, and `produced` at that moment."""
        produced = self.produced
        if produced < len(self.rows):
            return self.rows[:produced].copy(), produced
        return np.roll(self.rows, -(produced % len(self.rows)), axis=0), produced

    def restore(self, rows: NDArray[np.float32], produced: int) -> None:
        """Restore the result of `stored`, so that appending continues at the same place."""
        if rows.shape[1:] != self.rows.shape[1:] or len(rows) != min(produced, len(self.rows)):
            raise ValueError(f"{len(rows)} stored rows of {rows.shape[1]} do not fit a buffer of {self.rows.shape}")
        self.rows[(produced - len(rows) + np.arange(len(rows))) % len(self.rows)] = rows
        self._counter[0] = produced
