# SPDX-License-Identifier: Apache-2.0
"""Validation of tensors read from policy, metric, model and agent files: present, of the right shape, finite."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

MAX_MAGNITUDE = 1e30
"""Largest valid number, in SI units or normalized; a larger one means a damaged file, and its square would overflow."""


class InvalidTensorError(ValueError):
    """A tensor is missing, misshapen or not finite; the message is one sentence without the file's name."""


def check_finite(tensors: Mapping[str, Any]) -> None:
    """Raise InvalidTensorError for the first float tensor with NaN, infinity or a number above `MAX_MAGNITUDE`.

    The tensors `low` and `high` may be infinite, which means unbounded.
    """
    for name, array in ((name, np.asarray(tensor)) for name, tensor in tensors.items()):
        if array.dtype.kind == "f":
            wrong = np.isnan(array) if name in ("low", "high") else ~(np.abs(array) <= MAX_MAGNITUDE)
            if count := np.count_nonzero(wrong):
                raise InvalidTensorError(f"{name} holds {count} of {wrong.size} values that are no usable numbers")


def check_shapes(tensors: Mapping[str, Any], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise InvalidTensorError for the first tensor that is missing or has the wrong shape."""
    for name, shape in shapes.items():
        if name not in tensors or tuple(tensors[name].shape) != shape:
            raise InvalidTensorError(f"{name} is missing, or has another shape than {shape}")
