# SPDX-License-Identifier: Apache-2.0
"""`make fuzz` in short, and that it would notice."""

from __future__ import annotations

from tests.fuzz_link import DAMAGES, fuzz


def test_hostile_frames_break_no_rule():
    table, violations = fuzz(20_000, seed=1)
    assert violations == 0
    assert {row["damage"] for row in table.rows} == set(DAMAGES)
    assert all(row["frames"] > 1000 for row in table.rows)
