# SPDX-License-Identifier: Apache-2.0
"""`make soak` and `make fuzz-line` in short; how soon the plant is safe is judged by `make soak`."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from tests.soak.faults import FAULTS
from tests.soak.soak import soaking

pytestmark = [pytest.mark.graph, pytest.mark.realtime, pytest.mark.study]

CAUSES = (
    "unplug", "stall of commands", "corrupt bytes", "corrupt bytes alone", "SIGSTOP bridge", "SIGSTOP filter",
    "stranger: gains, epoch copied", "stranger: /hydro/arm false",
)  # fmt: skip
SLACK = 10.0
"""Times the bound in which the plant must be safe: a machine may stand still. In the box's own time there is none."""


def test_the_plant_is_safe_in_each_fault_and_nothing_is_left_behind(tmp_path: Path) -> None:
    with soaking(tmp_path, seed=1, slack=SLACK) as soak:
        soak.run([fault for fault in FAULTS if fault.cause in CAUSES])
    for outcome in soak.outcomes:
        print(outcome)
    assert {outcome.cause for outcome in soak.outcomes} == set(CAUSES)
    assert len(soak.records) > 5000
    assert min(soak.carried[way]["hostile"] for way in ("up", "down")) > 100_000
    assert not soak.violations(), soak.crew.text[-5000:]
