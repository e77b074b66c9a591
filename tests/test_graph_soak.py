# SPDX-License-Identifier: Apache-2.0
"""`make soak` and `make fuzz-line` in short; how soon the plant is safe is judged by `make soak`."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from tests.hostile_line import attack
from tests.soak.soak import soaking

pytestmark = [pytest.mark.graph, pytest.mark.study]

CAUSES = ("unplug", "stall of commands", "SIGSTOP bridge", "SIGSTOP filter", "stranger: /hydro/gains")
SLACK = 10.0
"""Times the bound in which the plant must be safe: a machine may stand still. In the box's own time there is none."""


def test_the_plant_is_safe_in_each_fault_and_nothing_is_left_behind(tmp_path: Path) -> None:
    with soaking(tmp_path, seed=1) as soak:
        soak.run(math.inf, CAUSES, slack=SLACK)
    for outcome in soak.outcomes:
        print(outcome)
    assert {outcome.cause for outcome in soak.outcomes} == set(CAUSES)
    assert len(soak.records) > 5000
    assert not soak.violations(SLACK), soak.crew.text[-5000:]


def test_hostile_bytes_on_the_line_of_an_armed_plant_move_nothing(tmp_path: Path) -> None:
    seen, report = attack(500_000, 100.0, 1, tmp_path)
    print(seen, report)
    assert seen.samples > 2000 and not seen.unsafe
    assert min(report[way]["hostile"] for way in ("up", "down")) >= 500_000
