# SPDX-License-Identifier: Apache-2.0
"""Engines for a batch's loss and gradient: the compiled kernels on the CPU, or torch on a GPU."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numba

from hydro_bridge.signals import FloatArray
from hydro_sim.neural import network
from hydro_sim.neural.engine import Engine
from hydro_sim.structured import rollout

DEVICES = ("auto", "cpu", "cuda")


class CompiledEngine:
    """The kernels of this package, on numba's threads."""

    name = "cpu"

    def network(self, *batch: Any) -> tuple[float, FloatArray]:
        """See `Engine`."""
        return network.loss_and_gradient(*batch, numba.get_num_threads())

    def structured(self, *batch: Any) -> tuple[float, FloatArray, FloatArray]:
        """See `Engine`."""
        return rollout.loss_and_gradients(*batch, numba.get_num_threads())


class TorchEngine:
    """torch on one of its devices."""

    def __init__(self, device: str) -> None:
        from hydro_sim.identification import torch_gradients

        self.name = device
        self._network: Callable[..., tuple[float, FloatArray]] = partial(torch_gradients.network_loss, device=device)
        self._structured: Callable[..., tuple[float, FloatArray, FloatArray]] = partial(
            torch_gradients.structured_loss, device=device
        )

    def network(self, *batch: Any) -> tuple[float, FloatArray]:
        """See `Engine`."""
        return self._network(*batch)

    def structured(self, *batch: Any) -> tuple[float, FloatArray, FloatArray]:
        """See `Engine`."""
        return self._structured(*batch)


def engines(device: str) -> tuple[Engine, ...]:
    """Engines for `cpu`, `cuda`, or `auto`, which is both where there is a GPU.

    Raises
    ------
    ValueError
        If it is none of these, or a GPU is asked for and there is none.
    """
    if device not in DEVICES:
        raise ValueError(f"device is {device!r}, known are {', '.join(DEVICES)}")
    if device == "cpu" or (device == "auto" and not _has_gpu()):
        return (CompiledEngine(),)
    if not _has_gpu():
        raise ValueError("device is cuda, but torch finds no GPU here")
    return (TorchEngine("cuda"),) if device == "cuda" else (CompiledEngine(), TorchEngine("cuda"))


def _has_gpu() -> bool:
    try:
        import torch
    except ImportError:
        return False
    return bool(torch.cuda.is_available())


def fastest_engine(choice: tuple[Engine, ...], gradient: Callable[[Engine], object]) -> Engine:
    """The engine with the fastest gradient; each is run twice, because the first call compiles or initialises."""
    if len(choice) == 1:
        return choice[0]
    taken = []
    for engine in choice:
        gradient(engine)
        began = time.perf_counter()
        gradient(engine)
        taken.append(time.perf_counter() - began)
    return choice[taken.index(min(taken))]
