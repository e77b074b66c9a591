# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_diagnosis prove: the diagnosis on sealed cases, `python -m benchmarks.prove` of this checkout."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from hydro_core.cli.console import UserError, command

CHECKOUT = Path(__file__).resolve().parents[3]


@command()
def main() -> int:
    """Entry point; status as the benchmark's."""
    if not (CHECKOUT / "benchmarks" / "prove").is_dir():
        raise UserError("prove runs the emulator on sealed cases, which an installation lacks: run it in a checkout")
    sys.path.insert(0, str(CHECKOUT))
    status: int = importlib.import_module("benchmarks.prove.__main__").main()
    return status
