# SPDX-License-Identifier: Apache-2.0
"""The replay buffer rolls, draws uniformly and refuses what is not finite."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hydro_policy.sac.replay import ReplayBuffer


def rows(first: int, count: int) -> np.ndarray:
    """Rows of widths 2, 2, 1, 1, 1 whose every entry is the row's number plus a tenth of its column."""
    return (np.arange(first, first + count)[:, None] + 0.1 * np.arange(7)).astype(np.float32)


def test_what_is_drawn_are_whole_transitions() -> None:
    memory = ReplayBuffer(2, 1, 100)
    memory.extend(rows(0, 20))
    drawn = memory.rows[memory.draw(4000, torch.Generator().manual_seed(0)).numpy()]
    np.testing.assert_allclose(drawn, drawn[:, :1] + rows(0, 1), rtol=1e-6)
    counts = np.bincount(drawn[:, 0].round().astype(int), minlength=20)
    assert counts.sum() == 4000 and len(counts) == 20 and counts.min() > 130  # 200 expected, 14 standard deviation


def test_rows_that_are_not_finite_are_refused() -> None:
    memory = ReplayBuffer(2, 1, 100)
    bad = rows(0, 2)
    bad[1, 3] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        memory.extend(bad)
    assert len(memory) == 0
