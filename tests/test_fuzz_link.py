# SPDX-License-Identifier: Apache-2.0
"""`make fuzz` in short, and that it would notice."""

from __future__ import annotations

import pytest

from hydro_bridge.serial import protocol
from tests.fuzz_link import DAMAGES, fuzz


def test_hostile_frames_break_no_rule():
    table, violations = fuzz(20_000, seed=1)
    assert violations == 0
    assert {row["damage"] for row in table.rows} == set(DAMAGES)
    assert all(row["frames"] > 1000 for row in table.rows)


def test_the_fuzzer_notices_a_missing_check_sum(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(protocol, "crc32", lambda _: 0)
    _, violations = fuzz(10_000, seed=1)
    assert violations > 0
