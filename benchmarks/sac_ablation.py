# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic with each of its choices changed: final returns over seeds that settings are chosen on.

Each variant is trained on as many benches side by side as there are seeds; bench and initial agent of seed s are those
of `sac_peers --seeds s`, its exploration is not. `base` are the settings before this ablation, by which learning starts
after 500 steps; `peers` is what stable-baselines3 has in their place. Needs gymnasium (`make bench-peers`):

    python -m benchmarks.sac_ablation --variants base uniform_warmup --json ablation.json
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks._report import interquartile_mean, parser, results
from benchmarks.sac_peers import EXAM, FREQUENCIES
from hydro_bridge.bags.writer import code_version
from hydro_core.cli.console import Table, command
from hydro_core.signals import FloatArray
from hydro_policy.sac.agent import ReplayBuffer
from hydro_policy.sac.sac import Sac
from hydro_policy.sac.settings import SacSettings

REWARD_SCALE = 0.02
EPISODE = 1800


def last_actor_layer(factor: float) -> Callable[[Sac], None]:
    """Scale the actor's last layer, so that every mean begins near zero and sigma near one."""

    def change(sac: Sac) -> None:
        for part in sac.parts("actor")[-2:]:
            part *= factor

    return change


def log_std(value: float) -> Callable[[Sac], None]:
    """Let log sigma begin at a value."""

    def change(sac: Sac) -> None:
        weights, biases = sac.parts("actor")[-2:]
        weights[..., 2:], biases[..., 2:] = 0.0, value

    return change


def no_biases(gain: float | None = None) -> Callable[[Sac], None]:
    """Let biases begin at zero; draw weights of deviation gain / sqrt(fan_in) (1: LeCun, sqrt(2): He)."""

    def change(sac: Sac) -> None:
        rng = np.random.default_rng((sac.settings.seed, 1))
        for name in ("actor", "critics"):
            parts = sac.parts(name)
            for weights, biases in zip(parts[::2], parts[1::2], strict=True):
                if gain is not None:
                    weights[:] = rng.normal(0.0, gain / math.sqrt(weights.shape[1]), weights.shape)
                biases[:] = 0.0
        sac.vectors["target_critics"][:] = sac.vectors["critics.parameters"]

    return change


def zero_critics(sac: Sac) -> None:
    """Let both critics begin at zero everywhere."""
    for part in sac.parts("critics")[-2:]:
        part[:] = 0.0
    sac.vectors["target_critics"][:] = sac.vectors["critics.parameters"]


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A training's settings."""

    uniform: bool = False
    """Uniform actions before learning starts, in place of the initial policy's."""
    starts: int = 500
    """Steps before learning starts."""
    updates: int = 1
    """Per step."""
    initial: tuple[Callable[[Sac], None], ...] = ()
    """Changes of the initial weights."""
    sac: dict[str, Any] = field(default_factory=dict)
    """Fields of `SacSettings`."""


HE = no_biases(math.sqrt(2.0))
VARIANTS = {
    "base": Variant(),
    "uniform_warmup": Variant(uniform=True),
    "log_std_min_-20": Variant(sac={"log_std_min": -20.0}),
    "peers": Variant(uniform=True, sac={"log_std_min": -20.0}),
    "learning_starts_1000": Variant(starts=1000),
    "learning_starts_1800": Variant(starts=1800),
    "uniform_1800": Variant(uniform=True, starts=1800),
    "uniform_3600": Variant(uniform=True, starts=3600),
    "uniform_1800_entropy_-1": Variant(uniform=True, starts=1800, sac={"target_entropy": -1.0}),
    "last_actor_layer_0.01": Variant(initial=(last_actor_layer(0.01),)),
    "log_std_-1": Variant(initial=(log_std(-1.0),)),
    "log_std_-2": Variant(initial=(log_std(-2.0),)),
    "zero_biases": Variant(initial=(no_biases(),)),
    "lecun": Variant(initial=(no_biases(1.0),)),
    "he": Variant(initial=(HE,)),
    "he_uniform_warmup": Variant(initial=(HE,), uniform=True),
    "he_small_actor": Variant(initial=(HE, last_actor_layer(0.01))),
    "zero_critics": Variant(initial=(zero_critics,)),
    "alpha_0.05": Variant(sac={"initial_entropy_coefficient": 0.05}),
    "alpha_0.5": Variant(sac={"initial_entropy_coefficient": 0.5}),
    "alpha_fixed": Variant(sac={"entropy_learning_rate": 0.0}),
    "target_entropy_0": Variant(sac={"target_entropy": 0.0}),
    "target_entropy_-1": Variant(sac={"target_entropy": -1.0}),
    "target_entropy_-4": Variant(sac={"target_entropy": -4.0}),
    "reward_scale_0.1": Variant(sac={"reward_scale": 0.1}),
    "reward_scale_0.01": Variant(sac={"reward_scale": 0.01}),
    "reward_scale_0.002": Variant(sac={"reward_scale": 0.002}),
    "tau_0.02": Variant(sac={"tau": 0.02}),
    "gamma_0.95": Variant(sac={"gamma": 0.95}),
    "actor_rate_0.0003": Variant(sac={"actor_learning_rate": 3e-4}),
    "critic_rate_0.003": Variant(sac={"critic_learning_rate": 3e-3}),
    "updates_2": Variant(updates=2),
    "updates_8": Variant(updates=8),
}


class Actors:
    """The policies of several agents, evaluated at once."""

    def __init__(self, agents: Sequence[Sac]) -> None:
        self._agents, self._shapes = agents, agents[0].layers["actor"]
        self._bounds = agents[0].settings.log_std_min, agents[0].settings.log_std_max

    def distribution(self, observations: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (mu, log sigma), shape (agents, 2) each, of one observation each, shape (agents, 13)."""
        flat = np.stack([agent.vectors["actor.parameters"] for agent in self._agents])
        parts = np.split(flat, np.cumsum([math.prod(shape) for shape in self._shapes])[:-1], axis=1)
        layers = [part.reshape(len(flat), *shape[1:]) for part, shape in zip(parts, self._shapes, strict=True)]
        hidden = observations[:, np.newaxis]
        for k, (weights, biases) in enumerate(zip(layers[::2], layers[1::2], strict=True)):
            hidden = hidden @ weights + biases
            hidden = np.maximum(hidden, 0.0) if k < 2 else hidden
        return hidden[:, 0, :2], np.clip(hidden[:, 0, 2:], *self._bounds)


def train(name: str, seeds: Sequence[int], steps: int) -> list[float]:
    """Return the final return of each seed under one of `VARIANTS`."""
    from hydro_policy.env import ForceControlVector

    variant = VARIANTS[name]
    agents = [
        Sac(13, 2, SacSettings(**({"reward_scale": REWARD_SCALE, "seed": seed} | variant.sac)))  # type: ignore[arg-type]
        for seed in seeds
    ]
    for sac in agents:
        for change in variant.initial:
            change(sac)
    replays, actors = [ReplayBuffer(13, 2, steps + 100) for _ in agents], Actors(agents)
    rng = np.random.default_rng((seeds[0], 2))
    environment = ForceControlVector(len(seeds), bench="shipped", max_episode_steps=EPISODE, autoreset_mode="Disabled")
    environment.reset(seed=list(seeds))
    now, _ = environment.reset()
    for step in range(steps):
        if step < variant.starts and variant.uniform:
            action = rng.uniform(-1.0, 1.0, (len(seeds), 2))
        else:
            mean, spread = actors.distribution(now)
            action = np.tanh(mean + np.exp(spread) * rng.standard_normal(mean.shape))
        following, reward, terminated, truncated, _ = environment.step(action.astype(np.float32))
        ends = np.stack((reward, terminated), axis=1)
        rows = np.concatenate((now, following, action, ends), axis=1).astype(np.float32)
        for sac, replay, row in zip(agents, replays, rows, strict=True):
            replay.extend(row[np.newaxis])
            if step >= variant.starts:
                sac.learn(replay, variant.updates)
        now, over = following, terminated | truncated
        if over.any():
            now, _ = environment.reset(options={"reset_mask": over})
    return examine(actors, len(seeds)).tolist()


def examine(actors: Actors, count: int) -> FloatArray:
    """Return the returns of the mean actions over the four sines, as `sac_peers.examine`."""
    from hydro_policy.env import ForceControlVector

    total = np.zeros(count)
    for frequency in FREQUENCIES:
        reference = {"amplitude": 300.0, "frequency": frequency}
        environment = ForceControlVector(count, bench="shipped", reference=reference, autoreset_mode="Disabled")
        now, _ = environment.reset(seed=[0] * count)
        alive = np.ones(count, bool)
        for _ in range(EXAM):
            action = np.tanh(actors.distribution(now)[0]).astype(np.float32)
            now, reward, terminated, _, _ = environment.step(action)
            total += REWARD_SCALE * reward * alive
            alive &= ~terminated
    return total


@command()
def main() -> None:
    """Run."""
    options = parser("sac_ablation", __doc__, parallel=True)
    options.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="NAME")
    options.add_argument("--seeds", type=int, nargs="+", default=list(range(100, 120)), metavar="N", help="100 to 119")
    options.add_argument("--steps", type=int, default=9000, metavar="N", help="environment steps of a training (9000)")
    asked = options.parse_args()
    columns = {
        "variant": "",
        "middle": f"interquartile mean of the final returns of {len(asked.seeds)} seeds (`sac_peers`)",
        "median": "", "worst": "", "best": "",
        "poor": "seeds below the untrained mean action, -4970",
        "returns": "of each seed",
    }  # fmt: skip
    runs = {name: (name, asked.seeds, asked.steps) for name in asked.variants}
    version = asked.seeds, asked.steps, code_version()
    table = Table(columns, title=f"Soft Actor-Critic after {asked.steps} steps")
    for name, returns in results(train, runs, asked, version, label="ablation", unit="variant").items():
        table.add(
            variant=name, middle=round(float(interquartile_mean(returns))), median=round(float(np.median(returns))),
            worst=round(min(returns)), best=round(max(returns)), poor=sum(one < -4970 for one in returns),
            returns=[round(one) for one in returns],
        )  # fmt: skip
    if asked.json:
        table.write_json(asked.json)
    table.rows = [{**row, "returns": len(row["returns"])} for row in table.rows]
    table.show()


if __name__ == "__main__":
    main()
