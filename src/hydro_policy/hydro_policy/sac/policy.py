# SPDX-License-Identifier: Apache-2.0
"""Acting policy: the actor's perceptron in numpy (some ten microseconds a call), and its file.

policy.safetensors holds weight_k [fan_in, fan_out] and bias_k [fan_out] as float32, and under the header key "hydro"
JSON with architecture, observation names, centers and scales, the bench's size that these follow from, and the range of
the gains, which is all that is needed to act, and the box it was made for (`hydro_sim.files.pairing`).
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from pathlib import Path

import numpy as np

from hydro_core.bench_scales import BenchScales
from hydro_core.files.tensors import check_shapes
from hydro_core.settings import check
from hydro_core.signals import FloatArray
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_NAMES, OBSERVATION_SIZE, GainRange, normalization
from hydro_sim.files import weights
from hydro_sim.files.pairing import Provenance
from hydro_sim.model.bench import NOMINAL


class Policy:
    """Squashed Gaussian policy for acting.

    `sac`: units of the hidden layers, bounds of log sigma. `size`: size of the bench, which scales the observations.
    """

    def __init__(self, sac: SacSettings, size: BenchScales = NOMINAL) -> None:
        self.size = size
        self.sizes = (OBSERVATION_SIZE, sac.hidden_size, sac.hidden_size, 2 * ACTION_SIZE)
        self.log_std_bounds = sac.log_std_min, sac.log_std_max
        self.weights = [np.zeros((i, o)) for i, o in zip(self.sizes, self.sizes[1:], strict=False)]
        self.biases = [np.zeros(o) for o in self.sizes[1:]]

    def load_flat(self, parameters: FloatArray) -> None:
        """Load the actor's flat parameters (in the order of `agent.layer_shapes`), any float dtype."""
        offset = 0
        for weight, bias in zip(self.weights, self.biases, strict=True):
            for array in (weight, bias):
                array.flat[:] = parameters[offset : offset + array.size]
                offset += array.size

    def digest(self) -> str:
        """Return the digest (blake2b, 12 hex digits) of the present weights, the policy's identity in recordings."""
        content = hashlib.blake2b(digest_size=6)
        for array in (*self.weights, *self.biases):
            content.update(np.asarray(array, np.float32).tobytes())
        return content.hexdigest()

    def distribution(self, observation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (mu, log sigma) before squashing, [..., 2] each, of observations [..., 13]."""
        hidden = observation
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            hidden = np.maximum(hidden @ weight + bias, 0.0)
        output = hidden @ self.weights[-1] + self.biases[-1]
        low, high = self.log_std_bounds
        return output[..., :ACTION_SIZE], np.minimum(np.maximum(output[..., ACTION_SIZE:], low), high)

    def act(self, observation: FloatArray, rng: np.random.Generator | None = None) -> FloatArray:
        """Return actions [..., 2] in [-1, 1] for observations [..., 13]: drawn with `rng`; without it tanh(mu)."""
        return np.tanh(self.distribution(observation)[0]) if rng is None else self.draw(observation, rng)[0]

    def draw(self, observation: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Return (drawn actions, mean actions tanh(mu)), [..., 2] each in [-1, 1], for observations [..., 13]."""
        mean, log_std = self.distribution(observation)
        return np.tanh(mean + np.exp(log_std) * rng.standard_normal(mean.shape)), np.tanh(mean)

    def save(
        self, path: Path, gains: GainRange, notes: dict[str, object] | None = None, made: Provenance | None = None
    ) -> None:
        """Write policy.safetensors, with `notes` (run, episodes, updates) and provenance `made` in its header."""
        center, scale = normalization(self.size)
        header = {
            "architecture": {"sizes": self.sizes, "activation": "relu", "output": "tanh(mu), log sigma"},
            "log_std_bounds": self.log_std_bounds,
            "observation": {
                "names": OBSERVATION_NAMES,
                "center": center.tolist(),
                "scale": scale.tolist(),
                "size": asdict(self.size),
                "units": "SI before normalization",
            },
            "gains": asdict(gains),
            "notes": notes or {},
        }
        tensors: weights.Tensors = {f"weight_{k}": w.astype(np.float32) for k, w in enumerate(self.weights)}
        tensors |= {f"bias_{k}": b.astype(np.float32) for k, b in enumerate(self.biases)}
        weights.save(path, tensors, header, made)


def load_policy(path: Path) -> tuple[Policy, GainRange, dict[str, object]]:
    """Read policy.safetensors: the policy, the range of its gains, its notes.

    Raises ValueError: the file is not a policy, is for another observation, or holds unusable numbers.
    """
    tensors, header = weights.load(path)
    try:
        seen, (low, high) = header["observation"], header["log_std_bounds"]
        size = BenchScales(**seen["size"])
        check(size)
        center, scale = normalization(size)
        known = OBSERVATION_NAMES, center.tolist(), scale.tolist()
        if (tuple(seen["names"]), seen["center"], seen["scale"]) != known:
            raise ValueError(f"it was trained on another observation: {', '.join(seen['names'])}")
        sac = SacSettings(hidden_size=int(header["architecture"]["sizes"][1]), log_std_min=low, log_std_max=high)
        gain_range = GainRange(**header["gains"])
        check(sac)
        check(gain_range)
        policy = Policy(sac, size)
        for name, arrays in (("weight", policy.weights), ("bias", policy.biases)):
            check_shapes(tensors, {f"{name}_{k}": array.shape for k, array in enumerate(arrays)})
            for k, array in enumerate(arrays):
                array[:] = tensors[f"{name}_{k}"]
        return policy, gain_range, header["notes"]
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{path} cannot be used as a policy: {error}") from error
