# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_sim export_c: the former name of `export --box`."""

from __future__ import annotations

import argparse

from hydro_core.cli.console import UserError, command


@command()
def main() -> None:
    """Entry point."""
    argparse.ArgumentParser(prog="export_c", description="Refused: it is now `export --box FILE.h`.").parse_known_args()
    raise UserError("export_c is now export: `ros2 run hydro_sim export --box FILE.h`")
