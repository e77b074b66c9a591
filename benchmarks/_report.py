# SPDX-License-Identifier: Apache-2.0
"""What the benchmarks share: their options."""

from __future__ import annotations

import argparse
from pathlib import Path

from hydro_core.cli.console import make_parser


def parser(name: str, description: str | None) -> argparse.ArgumentParser:
    """Every benchmark takes `--json FILE`."""
    made = make_parser(f"python -m benchmarks.{name}", description)
    made.add_argument("--json", type=Path, metavar="FILE", help="write the result there as well")
    return made
