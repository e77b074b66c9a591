# SPDX-License-Identifier: Apache-2.0
"""`make soak` in short: a few faults, each of which the plant is safe in. How soon is judged by `make soak`."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

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
