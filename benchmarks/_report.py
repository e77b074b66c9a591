# SPDX-License-Identifier: Apache-2.0
"""What the benchmarks share: percentiles and how they are shown."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt

PERCENTILES = (50.0, 99.0, 99.9)


def parser(name: str, description: str | None) -> argparse.ArgumentParser:
    """Every benchmark takes `--json FILE`."""
    made = argparse.ArgumentParser(
        prog=f"python -m benchmarks.{name}", description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    made.add_argument("--json", type=Path, metavar="FILE", help="write the result there as well")
    return made


def percentiles(seconds: npt.ArrayLike) -> dict[str, float]:
    """Percentiles and maximum [us] of durations [s]."""
    durations = 1e6 * np.asarray(seconds, np.float64)
    values = {f"p{percent:g}": float(np.percentile(durations, percent)) for percent in PERCENTILES}
    return values | {"max": float(durations.max())}
