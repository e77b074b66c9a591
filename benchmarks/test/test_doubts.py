# SPDX-License-Identifier: Apache-2.0
"""Doubts that are left out: each is where the table says, and the table counts what changes."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

from benchmarks.doubts import row

LEAVE_OUT = "from benchmarks.doubts import DOUBTS, leave_out\nfor one in DOUBTS: leave_out(one)"


def test_each_doubt_is_where_the_table_says() -> None:
    subprocess.run([sys.executable, "-c", LEAVE_OUT], check=True, timeout=60)


def told(**passed: bool) -> dict[str, Any]:
    case = {"claimed": ["friction_coulomb"], "truth": {"spring_rest": {}}, "estimates": [{"inside": True}]}
    return {"cases": [{"case": name, "passed": one, **case} for name, one in passed.items()]}


def test_a_row_says_which_cases_came_and_went() -> None:
    logger = {"holds": True, "others": 1}
    rig = {"agree": ["a"], "contradict": [], "missed": ["b"], "allowed": False, "curve": [[0.1, 1.0, 1.0, True]]}
    found = row("harmful", told(a=True, b=False), told(a=False, b=True), [logger], [rig])
    assert (found["right"], found["gained"], found["lost"]) == ("1/2", "a", "b")
    assert (found["spurious"], found["coverage"], found["loggers"], found["others"]) == (2, 100.0, 1, 1)
    assert (found["rigs"], found["missed"], found["verdicts"], found["speeds"]) == (1, 1, 1, "1/1")
