# SPDX-License-Identifier: Apache-2.0
"""`ros2 run hydro_diagnosis calibrate`: refused; it calibrated nothing."""

from __future__ import annotations

import argparse

from hydro_bridge.cli.console import UserError, command

NOW = "`calibrate` is now `python -m benchmarks.null_simulations`, in a checkout"


@command()
def main() -> None:
    """Entry point; 2."""
    argparse.ArgumentParser(prog="calibrate", description=f"{NOW}.").parse_known_args()
    raise UserError(NOW)


if __name__ == "__main__":
    main()
