# SPDX-License-Identifier: Apache-2.0
"""Digest of a run: what two runs of one seed have in common under the plant's clock.

SHA-256 over, in order::

    policy    its tensors by name, each as little-endian float32
    states    each recorded BenchState by sequence: stamp since the first [ns, int64], 14 floats [float64], flags,
              sequence [uint32], little-endian; one that was recorded twice counts once
    table     the rows of the closing comparison as canonical JSON: sorted keys, no blanks, full precision, NaN as null
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from struct import Struct

import msgspec
import numpy as np
from safetensors.numpy import load_file

from hydro_bridge.bags.recording import messages
from hydro_bridge.ros.messages import STATES
from hydro_bridge.ros.topics import STATE
from hydro_policy.task.cases import Score

_STATE = Struct("<q14dII")


def run_digest(policy: Path, recordings: Iterable[Path], rows: Sequence[Score]) -> str:
    """Return the digest, 64 hexadecimal digits, of a policy's file, recordings in their order, and a table's rows."""
    content = hashlib.sha256()
    for _, tensor in sorted(load_file(policy).items()):
        content.update(np.ascontiguousarray(tensor, "<f4").tobytes())
    first = last = None
    for path in recordings:
        for topic, _, _, data in messages(path):
            if topic != STATE or (state := STATES.unpack(data)) is None or state.sequence == last:
                continue
            first, last = state.stamp if first is None else first, state.sequence
            content.update(_STATE.pack(state.stamp - first, *state[2:16], state.flags, state.sequence))
    content.update(msgspec.json.encode(list(rows), order="sorted"))
    return content.hexdigest()


def circumstances() -> str:
    """Return the processor and the versions on which a digest may depend, as a sentence."""
    cpu = platform.processor() or platform.machine()
    with suppress(OSError, StopIteration):
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
        cpu = next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "torch", "numba"))
    return f"on {cpu}, Python {platform.python_version()}, {packages}"
