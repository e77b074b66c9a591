# SPDX-License-Identifier: Apache-2.0
"""A network of two hidden ReLU layers for one input at a time.

::

    flat weights  | W1 (n, h1) | b1 (h1) | W2 (h1, h2) | b2 (h2) | W3 (h2, m) | b3 (m) |      paper: h1 = h2 = 32

    a1 = relu(x W1 + b1)    a2 = relu(a1 W2 + b2)    y = a2 W3 + b3

A trajectory is sequential and a network this small lives in the first-level cache, so one trajectory at a time, its
loops running over neighboring weights, is what vectorizes; a batch is spread over cores. `Layers` is a tuple of views
of the flat vector, so that compiled code has names, and the optimizer one vector.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

LOOSE = {"reassoc", "contract"}
"""Sums may be reordered and fused, which vectorizes them; NaN and infinity keep their meaning."""


class Layers(NamedTuple):
    """Views of a flat vector of weights."""

    w1: npt.NDArray[np.floating]
    b1: npt.NDArray[np.floating]
    w2: npt.NDArray[np.floating]
    b2: npt.NDArray[np.floating]
    w3: npt.NDArray[np.floating]
    b3: npt.NDArray[np.floating]


def count(inputs: int, hidden: tuple[int, int], outputs: int) -> int:
    """Number of weights."""
    return inputs * hidden[0] + hidden[0] + hidden[0] * hidden[1] + hidden[1] + hidden[1] * outputs + outputs


def layers(flat: npt.NDArray[np.floating], inputs: int, hidden: tuple[int, int], outputs: int) -> Layers:
    """Views of `flat`, shape (count(...),), C-contiguous; writing to one writes to the other."""
    shapes = [(inputs, hidden[0]), (hidden[0],), hidden, (hidden[1],), (hidden[1], outputs), (outputs,)]
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
    if flat.shape != (ends[-1],):
        raise ValueError(f"{flat.shape[0]} weights for a network that has {ends[-1]}")
    parts = np.split(flat, ends[:-1])
    return Layers(*(part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)))


def initial(
    generator: np.random.Generator, inputs: int, hidden: tuple[int, int], outputs: int, *, last: float = 1.0
) -> npt.NDArray[np.float64]:
    """Random weights, uniform within 1/sqrt(fan-in) as torch.nn.Linear has them, the last layer's times `last`."""
    flat = np.empty(count(inputs, hidden, outputs))
    views = layers(flat, inputs, hidden, outputs)
    for index, fan_in in enumerate((inputs, inputs, hidden[0], hidden[0], hidden[1], hidden[1])):
        bound = (last if index >= 4 else 1.0) / np.sqrt(fan_in)
        views[index][...] = generator.uniform(-bound, bound, views[index].shape)
    return flat
