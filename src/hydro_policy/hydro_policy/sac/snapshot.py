# SPDX-License-Identifier: Apache-2.0
"""Serialization of `Sac`: the same bytes go to shared memory twice a second and into checkpoints.

The bytes are a safetensors file: each network and each Adam moment as one flat float32 tensor, the generator's state as
uint8, and the counters as JSON under the header key "hydro". No pickle.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from hydro_core.files.tensors import UnsoundError, check_numbers, check_shapes
from hydro_core.settings import check
from hydro_core.signals import FloatArray
from hydro_policy.sac.algorithm import FlatAdam, Sac
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import ACTIONS, OBSERVATIONS

_NETWORKS = ("actor", "critics", "entropy")


def dump(sac: Sac) -> bytes:
    """Serialize everything that the next update depends on."""
    tensors = {"generator": sac.generator.get_state(), "target_critics": sac.target_critics.parameters}
    counters = {"updates": sac.updates}
    for name, optimizer in _optimizers(sac).items():
        tensors |= {f"{name}.{key}": tensor for key, tensor in _tensors(optimizer).items()}
        counters[f"{name}.steps"] = optimizer.steps
    header = {"counters": counters, "settings": asdict(sac.settings)}
    return bytes(save(tensors, {"hydro": json.dumps(header)}))


def restore(sac: Sac, blob: bytes) -> None:
    """Restore from `dump`: later updates are bit-identical.

    Raises ValueError: the bytes are not a dump, are of networks of another shape, or hold invalid numbers.
    """
    tensors, header = _opened(blob)
    counters = header["counters"]
    _copy("target_critics", sac.target_critics.parameters, tensors)
    sac.generator.set_state(tensors["generator"])
    sac.updates = counters["updates"]
    for name, optimizer in _optimizers(sac).items():
        for key, tensor in _tensors(optimizer).items():
            _copy(f"{name}.{key}", tensor, tensors)
        optimizer.steps = counters[f"{name}.steps"]


def actor_parameters(blob: bytes) -> FloatArray:
    """Return the actor's flat parameters in a dump, float64, for `Policy.load_flat`."""
    return np.asarray(_opened(blob)[0]["actor.parameters"].numpy(), np.float64)


def as_beginning(blob: bytes) -> bytes:
    """Return the same agent with its counters at zero, so that a new run counts its own transitions only."""
    sac = Sac(OBSERVATIONS, ACTIONS, settings_of(blob))
    restore(sac, blob)
    sac.updates = 0
    return dump(sac)


def settings_of(blob: bytes) -> SacSettings:
    """Return the settings that a dump was made with."""
    settings = SacSettings(**_opened(blob)[1]["settings"])
    check(settings)
    return settings


def _opened(blob: bytes) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Return tensors and header; raises ValueError if they are truncated or damaged."""
    try:
        tensors = load(blob)
        length = int.from_bytes(blob[:8], "little")
        header: dict[str, Any] = json.loads(json.loads(blob[8 : 8 + length])["__metadata__"]["hydro"])
        if missing := {"generator", "actor.parameters"} - tensors.keys():
            raise UnsoundError(f"{min(missing)} is missing")
        counted = [header["counters"]["updates"], *(header["counters"][f"{name}.steps"] for name in _NETWORKS)]
        if not all(isinstance(count, int) and count >= 0 for count in counted):
            raise UnsoundError(f"its counters are {counted}")
    except (SafetensorError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"not a whole agent: {' '.join(str(error).split())}") from error
    check_numbers(tensors)
    return tensors, header


def _optimizers(sac: Sac) -> dict[str, FlatAdam]:
    return {"actor": sac.actor_optimizer, "critics": sac.critic_optimizer, "entropy": sac.entropy_optimizer}


def _tensors(optimizer: FlatAdam) -> dict[str, Tensor]:
    return {
        "parameters": optimizer.parameters,
        "first_moment": optimizer.first_moment,
        "second_moment": optimizer.second_moment,
    }


def _copy(name: str, target: Tensor, tensors: dict[str, Tensor]) -> None:
    check_shapes(tensors, {name: tuple(target.shape)})
    target.copy_(tensors[name])
