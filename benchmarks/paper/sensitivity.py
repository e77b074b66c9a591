# SPDX-License-Identifier: Apache-2.0
"""What the paper leaves open of Soft Actor-Critic: II under the paper's authority with other choices, in simulation."""

from __future__ import annotations

from dataclasses import replace

from benchmarks.paper.agents import simulated
from benchmarks.paper.choices import CHOICES
from benchmarks.paper.store import PRINTED, Result, Store
from hydro_policy.pretraining.options import parser
from hydro_policy.pretraining.run import training_settings
from hydro_policy.pretraining.source import simulation_setup


def run(store: Store) -> None:
    """Each choice, each seed; ours is II itself."""
    for seed in range(store.size.seeds):
        simulated(store, "paper", seed)
        for name in CHOICES:
            store.piece(f"sensitivity-{name}-{seed}", lambda n=name, s=seed: _trained(store, n, s))  # type: ignore[misc]


def _trained(store: Store, name: str, seed: int) -> Result:
    steps, episodes = str(PRINTED["training_agent"]["steps"]), str(store.size.simulated_episodes)
    words = ["--out", "nowhere", "--configuration", "paper", "--seed", str(seed), "--steps", steps]
    options = parser().parse_args([*words, "--episodes", episodes])
    source = simulation_setup(options)
    settings = training_settings(options, source)
    training = source.pretraining(replace(settings, sac=replace(settings.sac, **CHOICES[name])))
    found = []
    while not training.finished:
        found.append(float(training.round(lambda transitions: None)["score"]))
    return {"scores": found}
