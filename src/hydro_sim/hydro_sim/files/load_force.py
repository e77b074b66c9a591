# SPDX-License-Identifier: Apache-2.0
"""Ring file of the true load forces of an emulated bench, written by the emulator and read for scores.

No sensor shows them: for scoring only.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hydro_core.signals import FloatArray

RING_SIZE = 1 << 17
"""Number of samples in the ring, 131 s."""

_DTYPE = np.dtype([("force", np.float64), ("sequence", np.uint32), ("known", np.uint32)])

Ring = npt.NDArray[np.void]


def create_ring(path: Path) -> Ring:
    """Create the ring file; write to it by `write_force`. Raises OSError: it cannot be made, or the disk is full.

    Its blocks are reserved: a page of a sparse file that finds no room later ends the process (SIGBUS).
    """
    with path.open("wb") as file:
        try:
            os.posix_fallocate(file.fileno(), 0, RING_SIZE * _DTYPE.itemsize)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from None
    return np.memmap(path, _DTYPE, "r+", shape=(RING_SIZE,))


def write_force(ring: Ring, sequence: int, force: float) -> None:
    """Write the true load force [N] of sample `sequence`."""
    ring[sequence % RING_SIZE] = (force, sequence, 1)


def read_forces(path: Path, sequences: npt.NDArray[np.uint32]) -> FloatArray:
    """Return the forces [N] of these samples, shape (n,); NaN where overwritten, or without a file."""
    if not path.is_file():
        return np.full(len(sequences), np.nan)
    entries = np.memmap(path, _DTYPE, "r", shape=(RING_SIZE,))[sequences % RING_SIZE]
    return np.where((entries["sequence"] == sequences) & (entries["known"] == 1), entries["force"], np.nan)
