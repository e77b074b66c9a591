# SPDX-License-Identifier: Apache-2.0
"""What the paper leaves open of Soft Actor-Critic: II under the paper's authority with other choices, in simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.paper.agents import pretrained
from benchmarks.paper.store import CHOICES, PRINTED, Result, Store
from hydro_bridge.signals import FloatArray
from hydro_policy.pretraining.pretrain import parser
from hydro_policy.pretraining.run import simulation_setup, training_settings
from hydro_policy.pretraining.training import Pretraining
from hydro_policy.task import mdp

NORMALISERS: Mapping[str, float | None] = {"observation-standardised": None, "observation-a-fifth": 5.0}
"""Factor on the observation's scales, which are the reach of normal runs; None: mean 0 and deviation 1 under the first
actor, as a running normaliser has it."""


def run(store: Store, seed: int) -> None:
    """Each choice; ours is II itself."""
    pretrained(store, "paper", seed)
    for name in CHOICES:
        store.piece(f"sensitivity-{name}-{seed}", lambda n=name: _trained(store, n, seed))  # type: ignore[misc]


def _trained(store: Store, name: str, seed: int) -> Result:
    with observed(name, lambda: _pretraining(store, {}, seed)):
        training = _pretraining(store, CHOICES[name], seed)
        found = []
        while not training.finished:
            found.append(float(training.round()["score"]))
    return {"scores": found}


def _pretraining(store: Store, chosen: Mapping[str, Any], seed: int) -> Pretraining:
    """What `pretrain --configuration paper` runs, with these settings of Soft Actor-Critic."""
    steps, episodes = str(PRINTED["training_agent"]["steps"]), str(store.size.simulated_episodes)
    words = ["--out", "nowhere", "--configuration", "paper", "--seed", str(seed), "--steps", steps]
    options = parser().parse_args([*words, "--episodes", episodes])
    source = simulation_setup(options)
    settings = training_settings(options, source)
    return source.pretraining(replace(settings, sac=replace(settings.sac, **chosen)))


@contextmanager
def observed(name: str, first: Callable[[], Pretraining]) -> Iterator[None]:
    """The observation by another normaliser, for as long as this lasts; as it is where the choice is another."""
    before = mdp.OBSERVATION_CENTER.copy(), mdp.OBSERVATION_SCALE.copy()
    if name in NORMALISERS:
        factor = NORMALISERS[name]
        mean, deviation = _seen(first()) if factor is None else (0.0, factor)
        mdp.OBSERVATION_CENTER += mean * before[1]
        mdp.OBSERVATION_SCALE *= deviation
    try:
        yield
    finally:
        mdp.OBSERVATION_CENTER[:], mdp.OBSERVATION_SCALE[:] = before


def _seen(training: Pretraining) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation, shape (13,), of the normalised observations of the first round."""
    found: list[FloatArray] = []
    training.round(lambda transitions: found.append(transitions.observation.copy()))
    seen = np.concatenate(found)
    return seen.mean(axis=0), np.maximum(seen.std(axis=0), 1e-3)
