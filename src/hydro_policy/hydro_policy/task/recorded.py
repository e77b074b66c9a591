# SPDX-License-Identifier: Apache-2.0
"""Recorded references (ground motions, for instance), as sequences of sines that every box can play.

A box plays one waveform at a time and cross-fades to the next over `FADE_TIME` (protocol.md). So a record is sent as
sines with an offset, one per `FADE_TIME`, s_k at t_k = k `FADE_TIME`::

    f_r(t) = (1 - b) s_{k-1}(t) + b s_k(t)        b = p^4 (35 - 84 p + 70 p^2 - 20 p^3),  p = (t - t_k) / FADE_TIME

s_k is a least-squares fit over its two cross-fades, with s_{k-1} given; its frequency is the best of
`SINE_FREQUENCIES`. Four parameters per 0.3 s represent a record up to about 3 Hz, so it is low-passed there; the
residual is then 7 to 9 % of its RMS on the three ground motions of `benchmarks.hybrid_simulation`.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
from numpy.polynomial import Polynomial

from hydro_core.settings import SettingsError
from hydro_core.signals import FADE_TIME, SAMPLE_PERIOD, FloatArray, ReferenceSignal, Waveform

DURATION_MAX = 20.0  # longest part of a record that is played [s]: the one with the largest RMS
LOW_PASS_BANDWIDTH = 3.0  # cut-off frequency [Hz] of the low-pass, second order forwards and backwards
SINE_FREQUENCIES = np.arange(0.5, 10.01, 0.25)  # candidate frequencies of a sine [Hz]
SEGMENT_SAMPLES = round(FADE_TIME / SAMPLE_PERIOD)  # samples from one segment to the next
BLEND = Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])  # b of p


def read(path: Path) -> tuple[FloatArray, FloatArray]:
    """Return times [s] and values of a recorded reference, shape (n,) each.

    A rosbag2 folder or .mcap: its reference force. A .mat file: its matrix of two rows or columns. Else text with
    commas, the first two columns. Raises SettingsError: the file is missing or of another format, it has fewer than ten
    samples, or its times do not increase.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        if path.is_dir() or path.suffix == ".mcap":
            from hydro_bridge.bags.recording import read_bag

            states = read_bag(path).state
            table = np.stack((states["sequence"] * SAMPLE_PERIOD, states["reference_force"]))
        elif path.suffix == ".mat":
            found = [value for name, value in loadmat(path).items() if not name.startswith("__")]
            (table,) = (m.T if m.shape[0] > m.shape[1] else m for m in found if m.ndim == 2 and 2 in m.shape)
        else:
            table = np.genfromtxt(path, delimiter=",", usecols=(0, 1)).T
        table = table[:, np.isfinite(table).all(axis=0)].astype(float)
    except (OSError, ValueError, IndexError, NotImplementedError, MatReadError) as error:
        why = str(error).partition("\n")[0].rstrip(" :")
        raise SettingsError(f"{path} holds no record, a column of times [s] and one of values: {why}") from None
    if table.shape[1] < 10 or np.any(np.diff(table[0]) <= 0.0):
        raise SettingsError(f"{path} holds no record: ten times [s] or more that rise are needed")
    return table[0], table[1]


@cache
def segments(path: Path, amplitude: float) -> tuple[ReferenceSignal, ...]:
    """Return the signals to send one after the other, `FADE_TIME` apart, for a record scaled to a peak `amplitude` [N].

    Offset plus amplitude of a signal is at most twice that. Raises SettingsError: as `read`, or the record is shorter
    than three `FADE_TIME`, or constant.
    """
    from scipy.signal import butter, sosfiltfilt

    time, value = read(path)
    value = np.interp(np.arange(time[0], time[-1], SAMPLE_PERIOD), time, value)
    if len(value) < 3 * SEGMENT_SAMPLES or not np.ptp(value):
        raise SettingsError(f"{path} is shorter than {3 * FADE_TIME:.1f} s, or holds one value alone")
    smooth = sosfiltfilt(butter(2, LOW_PASS_BANDWIDTH, fs=1.0 / SAMPLE_PERIOD, output="sos"), value - value.mean())
    length = min(len(smooth), round(DURATION_MAX / SAMPLE_PERIOD))
    energy = np.concatenate(([0.0], np.cumsum(smooth**2)))
    first = int(np.argmax(energy[length:] - energy[: len(energy) - length]))
    part = smooth[first : first + length]
    record = amplitude / float(np.abs(part).max()) * part
    since, rising = SAMPLE_PERIOD * np.arange(2 * SEGMENT_SAMPLES), BLEND(np.arange(SEGMENT_SAMPLES) / SEGMENT_SAMPLES)
    weight = np.concatenate((rising, 1.0 - rising))
    angles = 2.0 * np.pi * np.outer(SINE_FREQUENCIES, since)
    bases = np.stack((np.ones_like(angles), np.sin(angles), np.cos(angles)), axis=-1)
    inverses = np.linalg.pinv(bases * weight[:, np.newaxis], rcond=0.03)
    made, leaving = list[ReferenceSignal](), np.zeros(SEGMENT_SAMPLES)
    for start in range(0, len(record) - 2 * SEGMENT_SAMPLES + 1, SEGMENT_SAMPLES):
        target = weight * record[start : start + 2 * SEGMENT_SAMPLES]
        target[:SEGMENT_SAMPLES] = record[start : start + SEGMENT_SAMPLES] - (1.0 - rising) * leaving
        found = inverses @ target
        played = np.einsum("fsn,fn->fs", bases, found)
        size = np.abs(found[:, 0]) + np.hypot(found[:, 1], found[:, 2])
        missed = np.where(size <= 2.0 * amplitude, np.sum((target - weight * played) ** 2, axis=1), np.inf)
        best = int(np.argmin(missed))
        offset, sine, cosine = map(float, found[best])
        made.append(
            ReferenceSignal(
                waveform=Waveform.SINE, amplitude=math.hypot(sine, cosine), offset=offset,
                frequency=float(SINE_FREQUENCIES[best]), phase=math.atan2(cosine, sine),
            )
        )  # fmt: skip
        leaving = played[best, SEGMENT_SAMPLES:]
    return tuple(made)
