# SPDX-License-Identifier: Apache-2.0
"""The matrix of wrong pairings, each command called as its executable calls it.

The files differ in nothing but what they say they were made for: `own` is for another bench (another spring, cylinder
and supply), `other` for this bench and another model, `unmarked` does not say. A learned bench of one's own is for any
box; the shipped one is for the shipped box.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy")

from rclpy.serialization import serialize_message

from hydro_bridge.bags.recording import BagWriter
from hydro_filter.metric import ScheduledMetric
from hydro_filter.metric import shipped as shipped_metric
from hydro_msgs.msg import BoxInfo
from hydro_policy.nodes.startup.box_expectation import require_matching_agent, require_matching_policy
from hydro_policy.nodes.startup.companions import requested_filter
from hydro_policy.pretraining.run import SimulationSetup
from hydro_policy.runs.initial_agent import load_initial_agent, shipped_agent
from hydro_sim.files import learned_bench
from hydro_sim.files.pairing import BoxIdentity, MadeFor, PairingError, with_provenance
from hydro_sim.files.recordings import BOX_TOPIC
from hydro_sim.model.bench import Bench
from tests.checks import each

FOREIGN = "was made for bench"
UNMARKED = "does not say which bench it was made for"
OWN = "--model @own_model.yaml --metric @own_metric.safetensors"
"""The filter of `own.yaml`."""
WRONG: dict[str, tuple[tuple[str, str], ...]] = {
    "hydro_filter filter": (
        ("--bench @own.yaml", f"the model learned_bench.yaml {FOREIGN}"),
        ("--bench @own.yaml --model @own_model.yaml", f"the metric default_metric.safetensors {FOREIGN}"),
        ("--bench @own.yaml --metric @own_metric.safetensors", f"the model learned_bench.yaml {FOREIGN}"),
        ("--metric @own_metric.safetensors", f"the metric own_metric.safetensors {FOREIGN}"),
        ("--model @other_model.yaml", "the metric default_metric.safetensors was made for model"),
        ("--metric @other_metric.safetensors", "the metric other_metric.safetensors was made for model"),
        ("--metric @unmarked_metric.safetensors", UNMARKED),
    ),
    "hydro_filter validate": (
        ("--metric @own_metric.safetensors", f"the metric own_metric.safetensors {FOREIGN}"),
        ("--model @other_model.yaml", "was made for model"),
    ),
    "hydro_filter learn_metric": (
        ("--out @new/m.safetensors --bench @own.yaml", f"the model learned_bench.yaml {FOREIGN}"),
        ("--out @new/m.safetensors --recording @own_bag", "the box of the recording own_bag believes bench"),
    ),
    "hydro_sim sim": (
        ("--model shipped --box-bench @own.yaml", f"the model learned_bench.yaml {FOREIGN}"),
    ),
    "hydro_sim validate": (
        ("@bag --bench @own.yaml", f"the model learned_bench.yaml {FOREIGN}"),
    ),
    "hydro_policy pretrain": (
        ("--out @new --box @own.yaml", f"the model learned_bench.yaml {FOREIGN}"),
        ("--out @new --bench @own.yaml --box @own.yaml --filter learned", FOREIGN),
    ),
    "hydro_policy trainer": (
        ("--runs @new --plant emulator --bench @own.yaml --configuration wide", FOREIGN),
        (f"--runs @new --plant sim --bench @own.yaml --filter='{OWN}'", f"the agent pretrained_paper {FOREIGN}"),
        ("--runs @new --plant sim --from @own", f"the agent own {FOREIGN}"),
        ("--runs @new --plant sim --from @unmarked", UNMARKED),
        ("--runs @new --plant sim --base-gains 30 8", "was made for a box with base K_p 15, this one has 30"),
        ("--runs @new --plant sim --filter=--metric=@own_metric.safetensors", "the metric own_metric.safetensors"),
        ("--runs @new --plant bench --filter=--model=@other_model.yaml", "was made for model"),
    ),
    "hydro_policy evaluate": (
        ("--runs @new --plant sim --bench @own.yaml", f"the model learned_bench.yaml {FOREIGN}"),
        ("--runs @new --plant sim --policy @own", f"the policy own {FOREIGN}"),
        ("--runs @new --plant emulator --policy @unmarked", UNMARKED),
        (f"--runs @new --plant sim --bench @own.yaml --policy @shipped --filter='{OWN}'", FOREIGN),
        ("--runs @new --plant sim --base-gains 30 8 --policy @shipped", "was made for a box with base K_p 15"),
        ("--runs @new --plant sim --filter=--metric=@unmarked_metric.safetensors", UNMARKED),
    ),
}  # fmt: skip
"""Words of each command that pairs anything, @ for the folder of `make_files`, with part of what is said."""


def make_files(folder: Path) -> None:
    """Own bench, models, metrics and policies, by what they say they were made for."""
    nominal = Bench.nominal()
    own = replace(nominal, spring_stiffness=4e4, piston_area=3e-4, supply_pressure=12e6)
    (folder / "own.yaml").write_text(yaml.safe_dump(own.to_mapping()), encoding="utf-8")
    with BagWriter(folder / "own_bag") as writer:
        writer.add_topic(BOX_TOPIC, "hydro_msgs/msg/BoxInfo")
        writer.write(BOX_TOPIC, serialize_message(BoxInfo(bench_digest=own.digest)), 0)
    metric, learned = shipped_metric().read_bytes(), learned_bench.load_model()
    for name in ("other_model.yaml", "own_model.yaml"):  # a hair off the shipped one: another by its digest
        changed = replace(learned, moving_mass=learned.moving_mass * (1.0 + 1e-9), learned=None)
        (folder / name).write_text(yaml.safe_dump(changed.to_mapping()), encoding="utf-8")
    other = learned_bench.digest(folder / "other_model.yaml")
    (folder / "own_metric.safetensors").write_bytes(with_provenance(metric, MadeFor(box=own.digest, model=other)))
    (folder / "other_metric.safetensors").write_bytes(with_provenance(metric, MadeFor(box=nominal.digest, model=other)))
    (folder / "unmarked_metric.safetensors").write_bytes(with_provenance(metric, None))
    start = shipped_agent("paper")
    for name, made in (("own", MadeFor(box=own.digest, base_kp=15.0, base_ki=5.0)), ("unmarked", None)):
        shutil.copytree(start.source, folder / name)
        for file in (folder / name).iterdir():
            file.write_bytes(with_provenance(file.read_bytes(), made))
    shutil.copytree(start.source, folder / "shipped")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    make_files(folder)
    return folder


def test_a_wrong_pairing_is_one_sentence_and_status_2_and_leaves_nothing(
    files: Path, refused: Callable[..., None]
) -> None:
    each([(command, *row) for command, rows in WRONG.items() for row in rows], lambda wrong: refused(*wrong, files))


def test_policies_and_simulations_of_one_bench_throughout_are_taken(files: Path) -> None:
    nominal, own = (BoxIdentity.of_file(path, (15.0, 5.0)) for path in (None, files / "own.yaml"))
    for name, box in (("shipped", nominal), ("own", own)):
        require_matching_policy(files / name, box)
        require_matching_agent(load_initial_agent(files / name), box)
    bench = str(files / "own.yaml")
    assert SimulationSetup(model="shipped").trouble() == ""
    assert SimulationSetup(model="shipped", filter="learned").trouble() == ""
    assert SimulationSetup(model="analytic", bench=bench).trouble() == "", "the plant may be another than believed"
    assert SimulationSetup(model=str(files / "own_model.yaml"), box=bench).trouble() == ""
    requested_filter(OWN.replace("@", f"{files}/").split(), files / "own.yaml")


def test_files_of_two_sites_are_refused_wherever_they_are_mixed(files: Path, tmp_path: Path) -> None:
    """Bench file, model, metric and policy of two benches in every mixture; the residual's network is for any bench.

    A model does not say its bench; its metric does.
    """
    sites: dict[str, list[Path]] = {}
    blob, learned = shipped_metric().read_bytes(), learned_bench.load_model()
    for name, mass in (("one", 2.0), ("two", 3.0)):
        own = replace(Bench.nominal(), moving_mass=mass)
        bench, model, metric, policy = sites[name] = [
            tmp_path / f"{name}{end}" for end in (".yaml", "_model.yaml", ".safetensors", "")
        ]
        bench.write_text(yaml.safe_dump(own.to_mapping()), encoding="utf-8")
        model.write_text(
            yaml.safe_dump(replace(learned, moving_mass=mass, learned=None).to_mapping()), encoding="utf-8"
        )
        made = MadeFor(box=own.digest, model=learned_bench.digest(model))
        metric.write_bytes(with_provenance(blob, made))
        shutil.copytree(files / "shipped", policy)
        for file in policy.iterdir():
            file.write_bytes(with_provenance(file.read_bytes(), MadeFor(box=own.digest, base_kp=15.0, base_ki=5.0)))
    refused = set()
    for names in product(sites, repeat=4):
        bench, model, metric, policy = (sites[name][k] for k, name in enumerate(names))
        try:
            requested_filter(["--model", str(model), "--metric", str(metric)], bench)
            require_matching_policy(policy, BoxIdentity.of_file(bench, (15.0, 5.0)))
        except PairingError:
            refused.add(names)
    assert set(product(sites, repeat=4)) - refused == {(name,) * 4 for name in sites}


def test_what_is_shipped_is_for_the_shipped_bench(files: Path) -> None:
    digest = BoxIdentity.of_file(None).digest
    shipped = load_initial_agent(files / "shipped").made
    assert shipped is not None and (shipped.box, shipped.base_kp, shipped.base_ki) == (digest, 15.0, 5.0)
    metric = ScheduledMetric.load().made
    assert metric is not None and (metric.box, metric.model) == (digest, learned_bench.digest())
