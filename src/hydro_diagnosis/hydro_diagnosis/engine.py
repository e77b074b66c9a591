# SPDX-License-Identifier: Apache-2.0
"""Version of the diagnosis: a digest of its sources and of the model's, except those of the blind benchmark."""

from __future__ import annotations

from functools import cache
from hashlib import sha256
from pathlib import Path

import hydro_sim.model


@cache
def engine() -> str:
    """Digest of the sources at the first call."""
    digest = sha256()
    for package in (Path(__file__).parent, Path(hydro_sim.model.__file__).parent):
        for path in sorted(package.rglob("*.py")):
            if "blind_benchmark" not in path.relative_to(package).parts:
                digest.update(path.read_bytes())
    return digest.hexdigest()[:12]
