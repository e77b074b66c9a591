# SPDX-License-Identifier: Apache-2.0
"""The last forces on an emulated load, in front of its cell: a file that the emulator writes and scores are made from.

No sensor shows them: for scoring only.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from hydro_core.signals import FloatArray

SAMPLES = 1 << 17
"""Number of samples that are kept, 131 s."""

_DTYPE = np.dtype([("force", np.float64), ("sequence", np.uint32), ("known", np.uint32)])

Ring = npt.NDArray[np.void]


def create(path: Path) -> Ring:
    """Create the file; write to it by `keep`."""
    return np.memmap(path, _DTYPE, "w+", shape=(SAMPLES,))


def keep(ring: Ring, sequence: int, force: float) -> None:
    """Write the force [N] of a sample."""
    ring[sequence % SAMPLES] = (force, sequence, 1)


def read(path: Path, sequences: npt.NDArray[np.uint32]) -> FloatArray:
    """Return the forces [N] of these samples, shape (n,); NaN where one is not kept, or there is no file."""
    if not path.is_file():
        return np.full(len(sequences), np.nan)
    entries = np.memmap(path, _DTYPE, "r", shape=(SAMPLES,))[sequences % SAMPLES]
    return np.where((entries["sequence"] == sequences) & (entries["known"] == 1), entries["force"], np.nan)
