# SPDX-License-Identifier: Apache-2.0
"""Digest of a run's results, equal for two runs of the same seed on a plant with its own clock.

SHA-256 over, in order::

    policy    its tensors by name, each as little-endian float32
    states    each recorded BenchState by sequence, little-endian: 15 float64 (its stamp in ns since the first, and the
              fields of the message in their order), flags and sequence as uint32; one recorded twice counts once.
              They end with the sample that ended the run: when the plant is disarmed after it is the wall clock's
    table     the rows of the closing comparison as canonical JSON: sorted keys, no blanks, full precision, NaN as null
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

import msgspec
import numpy as np
from safetensors.numpy import load_file

from hydro_bridge.bags.recording import stream_bag
from hydro_core.signals import STATE_FIELDS
from hydro_policy.task.cases import Score

_ROW_DTYPE = np.dtype([("numbers", "<f8", (1 + len(STATE_FIELDS),)), ("flags", "<u4"), ("sequence", "<u4")])


def run_digest(policy: Path, recordings: Sequence[Path], rows: Sequence[Score], end: int) -> str:
    """Return the digest, 64 hexadecimal digits, of a policy's file, recordings in their order, and a table's rows.

    `end`: sequence of the sample that ended the run; later ones of the last recording do not count.
    """
    content = hashlib.sha256()
    for _, tensor in sorted(load_file(policy).items()):
        content.update(np.ascontiguousarray(tensor, "<f4").tobytes())
    first, last = None, -1
    for path in recordings:
        for states in stream_bag(path):
            fresh = np.diff(states["sequence"], prepend=np.uint32(last & 0xFFFFFFFF)) != 0
            states = states[fresh]
            if not len(states):
                continue
            first = states["time"][0] if first is None else first
            last = int(states["sequence"][-1])
            packed = np.empty(len(states), _ROW_DTYPE)
            packed["numbers"][:, 0] = np.rint(1e9 * (states["time"] - first))
            for column, name in enumerate(STATE_FIELDS):
                packed["numbers"][:, column + 1] = states[name]
            packed["flags"], packed["sequence"] = states["flags"], states["sequence"]
            ended = path == recordings[-1] and end in states["sequence"]
            content.update(packed[: list(states["sequence"]).index(end) + 1 if ended else None].tobytes())
            if ended:
                break
    content.update(msgspec.json.encode(list(rows), order="sorted"))
    return content.hexdigest()


def platform_description() -> str:
    """Return the processor and the versions on which a digest may depend, as a sentence."""
    cpu = platform.processor() or platform.machine()
    with suppress(OSError, StopIteration):
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
        cpu = next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "numba", "torch"))
    return f"on {cpu}, Python {platform.python_version()}, {packages}"
