# SPDX-License-Identifier: Apache-2.0
"""Simulation set-up of a pretraining: from the command line, and to and from the run's folder."""

from __future__ import annotations

import argparse
import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from hydro_bridge.cli.console import UserError
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.files.settings_file import from_mapping, read_yaml
from hydro_bridge.settings import SettingsError
from hydro_filter.controller.factory import FilterChoice
from hydro_policy.envs.filter_kinds import FilterName
from hydro_policy.envs.randomisation import Randomisation
from hydro_policy.pretraining.training import Pretraining, PretrainSettings
from hydro_policy.runs.run import TrainingSettings
from hydro_sim.box.box import BoxConfig, Integral, with_base_gains
from hydro_sim.files import weights
from hydro_sim.files.pairing import BoxIdentity, MadeFor, mismatch
from hydro_sim.learned.any_model import is_bench_file
from hydro_sim.learned.model import Learned
from hydro_sim.model.bench import Bench

SOURCE = "pretrain.yaml"
"""File name in a run's folder, beside config.yaml."""


@dataclass(frozen=True, kw_only=True)
class SimulationSetup:
    """Simulated bench, model and filter; together with config.yaml all that `--resume` needs."""

    model: str
    """shipped, analytic, a bench file, or a weights file of `hydro_sim learn`."""
    bench: str | None = None
    """bench.yaml or corrected.yaml that is simulated by the analytic model; None: the nominal bench."""
    box: str | None = None
    """bench.yaml that the box believes in; None: the nominal bench."""
    base_gains: list[float] | None = None
    """K_p [1/s], K_i [1/s^2] of the box; None: the paper's."""
    randomise: bool = False
    filter: FilterName = "none"
    benches: int = 8
    integral: Integral = "bumpless"
    """Form of the force law's integral, `BoxConfig.integral`."""

    def simulated(self) -> Bench | Learned:
        """Analytic bench or learned model."""
        if is_bench_file(self.model):
            return Bench.load(self.model)
        if self.model == "analytic":
            return Bench.load(self.bench) if self.bench else Bench.nominal()
        return Learned.load(None if self.model == "shipped" else self.model)

    def believed(self) -> Bench:
        """Bench assumed by the box's force law."""
        return Bench.load(self.box) if self.box else Bench.nominal()

    def box_config(self) -> BoxConfig:
        """Base gains and limits of the box."""
        box = BoxConfig() if self.base_gains is None else with_base_gains(*self.base_gains)
        return replace(box, integral=self.integral)

    def made_for(self) -> MadeFor:
        """Box that its policies are made for: the simulated one, whatever the plant."""
        box, learned = self.box_config(), self.weights
        return MadeFor(
            box=self.believed().digest, model=weights.digest(learned) if learned else "", base_kp=box.base_kp,
            base_ki=box.base_ki, integral=box.integral, any_bench=self.randomise,
        )  # fmt: skip

    @property
    def weights(self) -> Path | None:
        """File of the learned model; None: a bench file is simulated."""
        if self.model == "analytic" or is_bench_file(self.model):
            return None
        return weights.shipped() if self.model == "shipped" else Path(self.model)

    def trouble(self) -> str:
        """Return why bench, model and filter do not belong together, in one sentence; empty if they do."""
        box, learned = BoxIdentity.of_file(self.box), self.weights
        remedy = "name the bench.yaml that its box believed by --box, or simulate a bench file: --bench FILE --box FILE"
        made = None if learned is None else Learned.load(learned).made
        wrong = "" if learned is None else mismatch(f"the model {learned.name}", made, box, remedy)
        if wrong or self.filter != "learned":
            return wrong
        return FilterChoice(bench=self.believed(), bench_file=Path(self.box) if self.box else None).trouble()

    def pretraining(self, training: TrainingSettings) -> Pretraining:
        """Return a new pretraining."""
        randomisation = Randomisation() if self.randomise else None
        settings = PretrainSettings(
            training=training, benches=self.benches, randomisation=randomisation, filter=self.filter,
            box=self.box_config(),
        )  # fmt: skip
        return Pretraining(settings, self.simulated(), self.believed())

    def save(self, folder: Path) -> None:
        """Save into a run's folder, beside config.yaml."""
        write_whole(folder / SOURCE, yaml.safe_dump(asdict(self), sort_keys=False).encode())


def simulation_setup(options: argparse.Namespace) -> SimulationSetup:
    """Return the simulation set-up of the command line."""
    model = options.model or ("analytic" if options.bench else "shipped")
    if options.bench and is_bench_file(model):
        raise UserError("--model names a bench file, and so does --bench: which of them is simulated?")
    if options.bench and model != "analytic":
        raise UserError("--bench is what the analytic model simulates; a learned model is a bench of its own")
    files = {key: path and os.path.abspath(path) for key, path in (("bench", options.bench), ("box", options.box))}
    model = model if model in ("analytic", "shipped") else os.path.abspath(model)
    chosen: dict[str, Any] = {
        "base_gains": options.base_gains,
        "integral": options.integral,
        "randomise": options.randomise,
        "filter": options.filter,
        "benches": options.benches,
    }
    return SimulationSetup(model=model, **chosen, **files)


def load_simulation_setup(folder: Path) -> SimulationSetup:
    """Return the simulation set-up of a run on disk.

    Raises
    ------
    UserError
        The folder holds no pretraining.
    """
    try:
        return from_mapping(
            SimulationSetup, {"integral": "paper", **read_yaml(folder / SOURCE)}, SOURCE
        )  # older runs had that
    except SettingsError as error:
        raise UserError(f"{folder} holds no pretraining to go on with: {error}") from error
