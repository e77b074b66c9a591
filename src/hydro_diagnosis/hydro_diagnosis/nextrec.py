# SPDX-License-Identifier: Apache-2.0
"""Which recording to make next, when rivals cannot be told apart by those at hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hydro_diagnosis.report import EffectReport
from hydro_diagnosis.verdict import Assessment


def next_recording(effects: Sequence[EffectReport], assessment: Assessment) -> dict[str, Any] | None:
    """The recording that separates the closest pair of rivals; None if all are told apart."""
    return None
