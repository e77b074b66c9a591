# SPDX-License-Identifier: Apache-2.0
"""Entry point of renamed commands, which refuses and names the present command."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hydro_core.cli.console import UserError, command

RENAMED_COMMANDS = {"export_c": "ros2 run hydro_sim export --box FILE.h", "collect": "ros2 run hydro_policy collect"}


@command()
def main() -> None:
    """Entry point."""
    told = {name: f"{name} is now `{now}`" for name, now in RENAMED_COMMANDS.items()}
    argparse.ArgumentParser(description=f"Refused: {'; '.join(told.values())}.").parse_known_args()
    raise UserError(told[Path(sys.argv[0]).stem])
