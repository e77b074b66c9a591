# SPDX-License-Identifier: Apache-2.0
"""What a recording or a table says of where it comes from: plant, bench file, filter, digests of all weights."""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from hydro_bridge.safety.box_info import KnownBox
from hydro_filter.controller.factory import Choice
from hydro_policy.evaluation.conditions import Conditions
from hydro_policy.nodes.guarding import relied_on
from hydro_sim.files.pairing import Believed
from hydro_sim.files.weights import shipped

if TYPE_CHECKING:
    from hydro_policy.nodes.companions import PlantOptions


def bench_file(given: Path | None) -> Path:
    """The bench.yaml in force: the one given, or the nominal one that comes with hydro_sim."""
    return given or Path(str(resources.files("hydro_sim") / "data" / "bench.yaml"))


def weights(plant: str, bench: Path | None, policies: Iterable[Path]) -> list[str]:
    """key=value words: SHA-256 of the simulation's model and of each policy that the recording may show.

    The sim node runs the analytic model of a bench file that it is given, and else the weights that come with it.
    """
    words = [f"policy_sha256_{path.stem}={_digest(path)}" for path in policies if path.is_file()]
    if plant == "sim":
        words.append(f"model_sha256={_digest(shipped())}" if bench is None else "model=analytic")
    return words


def conditions(options: PlantOptions, box: KnownBox) -> Conditions:
    """What a table that is made on this plant was made under."""
    extra = {"truth": options.truth, "faults": options.faults, "port": options.port}
    told = [options.plant, *(f"{name} {value}" for name, value in extra.items() if value)]
    if options.truth is None and options.plant == "emulator":
        told.append("truth default")
    external = options.plant == "external"
    return Conditions(
        plant=", ".join(told), bench=Believed.of_box(box).told if box.bench_digest else "",
        filter="" if external else relied_on(options.filter), integral=box.integral, base_gains=box.base_gains,
    )  # fmt: skip


def of_filter(choice: Choice) -> list[str]:
    """key=value words: SHA-256 of the filter's metric and of the model it predicts with, or that it has none."""
    return [f"filter_{name}_sha256={_digest(path)}" for name, path in choice.files.items()] or [
        f"filter_metric={choice.metric}"
    ]


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()
