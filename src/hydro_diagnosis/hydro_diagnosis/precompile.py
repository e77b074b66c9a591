# SPDX-License-Identifier: Apache-2.0
"""Compilation at set-up: each compiled entry point of this package is called once, on small real inputs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hydro_diagnosis.model.memory import RecordMemory


def _memory() -> None:
    path, record = np.zeros(10), RecordMemory(1e-3)
    record.bristle("z", path, 2e5, np.ones(10))
    record.play("p", path, 0.1)


STEPS: dict[str, Callable[[], None]] = {"diagnosis": _memory}
"""By what is said while one runs. Recordings are simulated by `hydro_sim`, whose own steps compile that."""
