# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import subprocess
import sys

LEAVE_OUT = "from benchmarks.doubts import DOUBTS, leave_out\nfor one in DOUBTS: leave_out(one)"


def test_each_doubt_is_where_the_table_says() -> None:
    subprocess.run([sys.executable, "-c", LEAVE_OUT], check=True, timeout=60)
