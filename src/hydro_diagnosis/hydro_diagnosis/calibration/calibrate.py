# SPDX-License-Identifier: Apache-2.0
"""`ros2 run hydro_diagnosis calibrate`: the evidence that a claim needs, from recordings with nothing missing.

What is recorded and searched: `null_simulations`. With --write, finished trials are saved, and the same command resumes
from them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from hydro_bridge.cli.console import add_json_argument, command, writable


def parser() -> argparse.ArgumentParser:
    """The command line."""
    options = argparse.ArgumentParser(
        prog="calibrate",
        description="Search recordings in which nothing is missing, and say how much evidence a claim needs.",
    )
    options.add_argument("--bench", help="bench.yaml (default: the nominal bench)")
    options.add_argument("--runs", type=int, default=200, help="pairs of recordings (default: 200)")
    options.add_argument("--seed", type=int, default=0, help="of references, gains and noise")
    options.add_argument("--rate", type=float, default=1e-3, help="of false claims to allow (default: 0.001)")
    options.add_argument("--jobs", type=int, default=2, help="processes (default: 2)")
    options.add_argument(
        "--write", type=writable, metavar="FILE", help="keep the trials there, as JSON, and go on from them"
    )
    add_json_argument(options)
    return options


def run(arguments: Sequence[str]) -> int:
    """Parse the command line and calibrate; 130 after Ctrl-C before the first trial."""
    chosen = parser().parse_args(arguments)
    from hydro_diagnosis.calibration.run import calibrate  # with compiled code: not for --help or a wrong option

    return calibrate(chosen)


@command(ValueError, OSError)
def main() -> int:
    """Entry point."""
    return run(sys.argv[1:])


if __name__ == "__main__":
    main()
