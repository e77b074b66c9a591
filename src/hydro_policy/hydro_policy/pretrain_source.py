# SPDX-License-Identifier: Apache-2.0
"""What a pretraining simulates: from the command line, and to and from the run's folder."""

from __future__ import annotations

import argparse
import os
from dataclasses import asdict, dataclass
from pathlib import Path

import yaml

from hydro_bridge.console import UserError
from hydro_policy.pretraining import Pretraining, PretrainSettings
from hydro_policy.randomisation import Randomisation
from hydro_policy.run import TrainingSettings
from hydro_sim.bench import Bench
from hydro_sim.box import BoxConfig, Integral
from hydro_sim.learned.model import Learned

SOURCE = "pretrain.yaml"
"""In a run's folder, beside config.yaml."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """What is simulated; all that `--resume` needs besides config.yaml."""

    model: str
    """shipped, analytic, or a weights file of `hydro_sim learn`."""
    bench: str | None = None
    """bench.yaml or corrected.yaml that is simulated by the analytic model; None: the nominal bench."""
    box: str | None = None
    """bench.yaml that the box believes in; None: the nominal bench."""
    randomise: bool = False
    filter: str = "none"
    """A name of `fleet_filter.FILTERS`."""
    benches: int = 8
    integral: Integral = "bumpless"
    """Form of the force law's integral, `BoxConfig.integral`."""

    def simulated(self) -> Bench | Learned:
        """The analytic bench or the learned model."""
        if self.model == "analytic":
            return Bench.load(self.bench) if self.bench else Bench.nominal()
        return Learned.load(None if self.model == "shipped" else self.model)

    def believed(self) -> Bench:
        """What the box's force law takes for true."""
        return Bench.load(self.box) if self.box else Bench.nominal()

    def pretraining(self, training: TrainingSettings) -> Pretraining:
        """A pretraining at its beginning."""
        randomisation = Randomisation() if self.randomise else None
        settings = PretrainSettings(
            training=training, benches=self.benches, randomisation=randomisation, filter=self.filter,
            box=BoxConfig(integral=self.integral),
        )  # fmt: skip
        return Pretraining(settings, self.simulated(), self.believed())

    def save(self, folder: Path) -> None:
        """Into a run's folder, beside config.yaml."""
        (folder / SOURCE).write_text(yaml.safe_dump(asdict(self), sort_keys=False))


def source_of(options: argparse.Namespace) -> Source:
    """What the command line asks to be simulated."""
    model = options.model or ("analytic" if options.bench else "shipped")
    if options.bench and model != "analytic":
        raise UserError("--bench is what the analytic model simulates; a learned model is a bench of its own")
    files = {key: path and os.path.abspath(path) for key, path in (("bench", options.bench), ("box", options.box))}
    model = model if model in ("analytic", "shipped") else os.path.abspath(model)
    chosen = {"randomise": options.randomise, "filter": options.filter, "benches": options.benches}
    chosen["integral"] = options.integral
    return Source(model=model, **chosen, **files)


def load_source(folder: Path) -> Source:
    """What a run simulates.

    Raises
    ------
    UserError
        The folder holds no pretraining.
    """
    try:
        return Source(**{"integral": "paper", **yaml.safe_load((folder / SOURCE).read_text())})  # what older runs had
    except (OSError, TypeError, yaml.YAMLError) as error:
        raise UserError(f"{folder} holds no pretraining to go on with: {error}") from error
