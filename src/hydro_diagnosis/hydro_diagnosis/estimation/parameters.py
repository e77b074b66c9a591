# SPDX-License-Identifier: Apache-2.0
"""Parameters of claims as a vector, and back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_diagnosis.effects.base import Claim, Effect, FitParameter, FloatArray


def pack(claims: Sequence[Claim]) -> tuple[list[FitParameter], FloatArray]:
    """Parameters and their values, claim after claim."""
    parameters = [parameter for claim in claims for parameter in claim.effect.parameters]
    values = [claim.values[parameter.name] for claim in claims for parameter in claim.effect.parameters]
    return parameters, np.array(values, dtype=np.float64)


def unpack(effects: Sequence[Effect], values: FloatArray) -> tuple[Claim, ...]:
    """Claims from values."""
    claims, k = [], 0
    for effect in effects:
        names = [parameter.name for parameter in effect.parameters]
        claims.append(Claim(effect, dict(zip(names, map(float, values[k : k + len(names)]), strict=True))))
        k += len(names)
    return tuple(claims)
