# SPDX-License-Identifier: Apache-2.0
"""Ground motions of the benchmark, as published: recorded accelerations in MATLAB files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import loadmat

from hydro_core.cli.console import UserError
from hydro_core.signals import FloatArray

MOTIONS = {"El Centro": "ElCentroAccel", "Kobe": "KobeAccel", "Morgan Hill": "MorganAccel"}
"""Name in the benchmark: variable in the file `<variable>NoScaling.mat`."""
SAMPLING = 4096
"""Hz."""
STEP = 1.0 / SAMPLING
"""s."""
ORIGIN = "https://github.com/lihongweiseu/RTHS_benchmark_SMC"
"""Repository with the organisers' files; FermandoisLab/RobustAMBCvRTHS has El Centro and Kobe, too."""


def ground_motion(folder: Path, name: str, intensity: float) -> FloatArray:
    """Read a motion and interpolate it linearly.

    Parameters
    ----------
    folder
        Holds the file `<variable>NoScaling.mat`, a matrix (2, n) of time [s] and acceleration [m/s^2].
    name
        One of `MOTIONS`.
    intensity
        Factor of the acceleration.

    Returns
    -------
    Acceleration [m/s^2] at every half step of `STEP`, shape (2 n + 1,), for n steps.

    Raises
    ------
    UserError
        There is no such file in the folder, or it has another content.
    """
    path = folder / f"{MOTIONS[name]}NoScaling.mat"
    if not path.is_file():
        raise UserError(f"{path} does not exist: get it from {ORIGIN}, and name its folder with --data")
    try:
        time, acceleration = loadmat(path)[MOTIONS[name]].astype(float)
    except (KeyError, ValueError, TypeError):
        raise UserError(f"{path} has no matrix {MOTIONS[name]} of two rows, time and acceleration") from None
    halves = 2 * int(time[-1] * SAMPLING) + 1
    return intensity * np.interp(0.5 * STEP * np.arange(halves), time, acceleration)
