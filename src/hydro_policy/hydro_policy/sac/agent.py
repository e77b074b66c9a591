# SPDX-License-Identifier: Apache-2.0
"""What a learner owns: its replay buffer, and the agent (networks, optimizer states, counters) with its file.

Plain arrays, which `sac.Sac` updates in place and other processes share: whoever acts or keeps files needs no torch.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from hydro_core.files.tensors import check_finite, check_shapes
from hydro_core.settings import check
from hydro_core.signals import FloatArray
from hydro_policy.sac.settings import SacSettings


class ReplayBuffer:
    """Replay buffer of the last `capacity` transitions, one row each, so that a batch is one gather.

        row        [ observation | next observation | action | reward, terminated ]   float32
        example    13 + 13 + 2 + 2 = 30 numbers; 288 000 rows (the paper's 160 x 1800) are 35 MB

    `observations`, `actions`: sizes of an observation and of an action. `capacity`: rows kept; the oldest are
    overwritten.
    """

    def __init__(self, observations: int, actions: int, capacity: int) -> None:
        self.rows = np.zeros((capacity, 2 * observations + actions + 2), np.float32)
        self.total_appended = 0
        """Number of transitions ever appended."""

    def __len__(self) -> int:
        return min(self.total_appended, len(self.rows))

    def extend(self, rows: NDArray[np.float32]) -> None:
        """Append rows [n, width] in order, overwriting the oldest.

        Raises ValueError: a row holds NaN or infinity, which would corrupt every network at the first batch with it.
        """
        if not np.isfinite(rows).all():
            raise ValueError("a transition holds a value that is not finite")
        kept = rows[-len(self.rows) :]
        first = self.total_appended + len(rows) - len(kept)
        self.rows[(first + np.arange(len(kept))) % len(self.rows)] = kept
        self.total_appended = first + len(kept)

    def draw(self, shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.int64]:
        """Draw indices in `rows` of stored transitions, uniformly, with replacement."""
        return rng.integers(len(self), size=shape)

    def snapshot(self) -> tuple[NDArray[np.float32], int]:
        """Return a copy of all stored rows, oldest first, and `total_appended` at that moment."""
        produced = self.total_appended
        if produced < len(self.rows):
            return self.rows[:produced].copy(), produced
        return np.roll(self.rows, -(produced % len(self.rows)), axis=0), produced

    def restore(self, rows: NDArray[np.float32], produced: int) -> None:
        """Restore the result of `snapshot`, so that appending continues at the same row."""
        self.rows[(produced - len(rows) + np.arange(len(rows))) % len(self.rows)] = rows
        self.total_appended = produced


OPTIMIZED = ("actor", "critics", "entropy")
"""Parameters with an optimizer: networks, and log alpha, the logarithm of the entropy coefficient."""
MOMENTS = ("parameters", "first_moment", "second_moment")
_CACHE_LINE = 64  # bytes


def layer_shapes(members: int, inputs: int, hidden: int, outputs: int) -> list[tuple[int, int, int]]:
    """Return the shapes of weights [member, fan_in, fan_out] and biases [member, 1, fan_out], in turn, of three layers.

    A flat vector, also in files, holds them in this order.
    """
    sizes = (inputs, hidden, hidden, outputs)
    return [(members, rows, n) for m, n in pairwise(sizes) for rows in (m, 1)]


class Losses(NamedTuple):
    """Losses of one update, each evaluated on its batches before the update; NaN before the first."""

    critics: float = math.nan
    """1/2 sum_i mean (Q_i(o, a) - y)^2"""
    actor: float = math.nan
    """mean(alpha log pi(a|o) - min_i Q_i(o, a))"""
    temperature: float = math.nan
    """-log(alpha) (mean log pi(a|o) + target entropy)"""


class Agent:
    """Actor, twin critics, target critics and temperature with their Adam states, as views of one array.

        state      [ updates | optimizer steps | actor: parameters, moments | critics | log alpha | target critics ]

    `observations`, `actions`: sizes of the observation and of the action; actions lie in (-1, 1). `dtype`: float32 in
    use; float64 for checks.
    """

    def __init__(self, observations: int, actions: int, settings: SacSettings, dtype: Any = np.float32) -> None:
        self.settings, self.sizes = settings, (observations, actions)
        h = settings.hidden_size
        self.layers = {
            "actor": layer_shapes(1, observations, h, 2 * actions),
            "critics": layer_shapes(2, observations + actions, h, 1),
        }
        lengths = {name: sum(map(math.prod, shapes)) for name, shapes in self.layers.items()} | {"entropy": 1}
        keys = {f"{name}.{key}": lengths[name] for name in OPTIMIZED for key in MOMENTS}
        keys |= {"target_critics": lengths["critics"]}
        numbers = -(-sum(keys.values()) * np.dtype(dtype).itemsize // 8)
        memory = np.zeros(2 + numbers + _CACHE_LINE // 8, np.int64)
        start = -(memory.ctypes.data + 16) % _CACHE_LINE // 8  # a product's rounding may depend on the alignment
        self.state: NDArray[np.int64] = memory[start : start + 2 + numbers]
        """Complete state: counters of updates and optimizer steps, then all vectors, which are its views."""
        vectors = np.split(self.state[2:].view(dtype), np.cumsum(list(keys.values())))
        self.vectors: dict[str, NDArray[Any]] = dict(zip(keys, vectors, strict=False))
        """Flat vectors by their names in files."""
        rng = np.random.default_rng(settings.seed).spawn(1)[0]  # exploration has the seed itself
        for name, shapes in self.layers.items():
            for k in range(0, len(shapes), 2):
                bound = 1.0 / math.sqrt(shapes[k][1])
                for part in self.parts(name)[k : k + 2]:
                    part[:] = rng.uniform(-bound, bound, part.shape)
        self.vectors["target_critics"][:] = self.vectors["critics.parameters"]
        self.vectors["entropy.parameters"][:] = math.log(settings.initial_entropy_coefficient)

    def parts(self, name: str) -> list[NDArray[Any]]:
        """Return views of weights and biases, in turn, of `actor` or `critics`."""
        shapes, vector = self.layers[name], self.vectors[f"{name}.parameters"]
        parts = np.split(vector, np.cumsum([math.prod(shape) for shape in shapes]))
        return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=False)]

    @property
    def updates(self) -> int:
        """Number of updates in this run."""
        return int(self.state[0])

    @updates.setter
    def updates(self, count: int) -> None:
        self.state[0] = count

    @property
    def steps(self) -> int:
        """Number of optimizer steps, those of earlier runs included."""
        return int(self.state[1])

    @property
    def entropy_coefficient(self) -> float:
        """alpha, the temperature."""
        return math.exp(self.vectors["entropy.parameters"][0])

    def actor_parameters(self) -> FloatArray:
        """Return a copy of the actor's flat parameters, float64, for `Policy.load_flat`."""
        return self.vectors["actor.parameters"].astype(np.float64)

    def dump(self) -> bytes:
        """Return the complete state as the content of a safetensors file (no pickle).

        Each network and each moment is one flat tensor; counters and settings are JSON under the header key "hydro".
        """
        counters = {"updates": self.updates, **{f"{name}.steps": self.steps for name in OPTIMIZED}}
        header = json.dumps({"counters": counters, "settings": asdict(self.settings)})
        return bytes(save(self.vectors, {"hydro": header}))

    def restore(self, blob: bytes) -> None:
        """Restore the result of `dump`: later updates are bit-identical.

        Raises ValueError: the bytes are not a dump, are of networks of another shape, or hold invalid numbers.
        """
        tensors, header = _opened(blob)
        check_shapes(tensors, {name: vector.shape for name, vector in self.vectors.items()})
        for name, vector in self.vectors.items():
            vector[:] = tensors[name]
        self.state[:2] = header["counters"]["updates"], header["counters"]["actor.steps"]


def actor_parameters(blob: bytes) -> FloatArray:
    """Return the actor's flat parameters in a dump, float64, for `Policy.load_flat`."""
    return np.asarray(_opened(blob)[0]["actor.parameters"], np.float64)


def settings_of(blob: bytes) -> SacSettings:
    """Return the settings of the agent in a dump."""
    settings = SacSettings(**_opened(blob)[1]["settings"])
    check(settings)
    return settings


def _opened(blob: bytes) -> tuple[Mapping[str, Any], dict[str, Any]]:
    """Return tensors and header; raises ValueError if they are truncated or damaged."""
    try:
        tensors = load(blob)
        length = int.from_bytes(blob[:8], "little")
        header: dict[str, Any] = json.loads(json.loads(blob[8 : 8 + length])["__metadata__"]["hydro"])
    except (SafetensorError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"not a whole agent: {' '.join(str(error).split())}") from error
    check_finite(tensors)
    return tensors, header
