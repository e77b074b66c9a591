# SPDX-License-Identifier: Apache-2.0
"""`make fuzz-line` in short: hostile bytes on the serial line of an armed plant; a slow machine may lose samples."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from tests.hostile_line import attack

pytestmark = [pytest.mark.graph, pytest.mark.study]


def test_hostile_bytes_on_the_line_of_an_armed_plant_move_nothing(tmp_path: Path) -> None:
    seen, report = attack(500_000, 100.0, 1, tmp_path)
    print(seen, report)
    assert seen.samples > 2000 and not seen.unsafe
    assert min(report[way]["hostile"] for way in ("up", "down")) >= 500_000
