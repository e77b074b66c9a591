# SPDX-License-Identifier: Apache-2.0
"""The matrix of wrong pairings, each command called as its executable calls it; `benchmarks.pairings` has the table."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from benchmarks.pairings import WRONG, Wrong, make_files
from hydro_filter.nodes.options import arguments
from hydro_policy.nodes.startup.box_expectation import require_matching_agent, require_matching_policy
from hydro_policy.nodes.startup.companions import requested_filter
from hydro_policy.pretraining.run import SimulationSetup
from hydro_policy.runs.initial_agent import load_initial_agent
from hydro_sim.files import weights
from hydro_sim.files.pairing import BoxIdentity
from hydro_sim.learned.model import Learned

MODULES = {
    "hydro_filter filter": "hydro_filter.nodes.filter",
    "hydro_filter validate": "hydro_filter.validation.validate",
    "hydro_filter learn_metric": "hydro_filter.training.learn_metric",
    "hydro_sim sim": "hydro_sim.nodes.sim",
    "hydro_sim validate": "hydro_sim.identification.validate",
    "hydro_policy pretrain": "hydro_policy.pretraining.pretrain",
    "hydro_policy trainer": "hydro_policy.nodes.trainer",
    "hydro_policy evaluate": "hydro_policy.nodes.evaluate",
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    make_files(folder)
    return folder


def test_a_wrong_pairing_is_one_sentence_and_status_2_and_leaves_nothing(
    files: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], each: Callable[..., None]
) -> None:
    before = set(files.rglob("*"))

    def check(wrong: Wrong) -> None:
        monkeypatch.setattr(sys, "argv", [wrong.executable, *wrong.arguments(files)])
        with pytest.raises(SystemExit) as ended:
            importlib.import_module(MODULES[f"{wrong.package} {wrong.executable}"]).main()
        said = capfd.readouterr().err.splitlines()[-1]
        assert ended.value.code == 2
        assert said.startswith("error: ") and wrong.sentence in said
        assert set(files.rglob("*")) == before, "nothing is left behind"

    each(WRONG, check, lambda wrong: f"{wrong.executable} {wrong.words}")


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("--metric", "constant"),
        ("--bench", "@own.yaml", "--metric", "constant"),
        ("--bench", "@own.yaml", "--model", "@own_model.safetensors", "--metric", "@own_metric.safetensors"),
        ("--model", "@other_model.safetensors", "--metric", "@other_metric.safetensors"),
    ],
)
def test_a_filter_of_one_bench_throughout_is_taken(words: Sequence[str], files: Path) -> None:
    choice, _, _ = arguments([word.replace("@", f"{files}/") for word in words])
    assert choice.trouble() == ""


def test_policies_and_simulations_of_one_bench_throughout_are_taken(files: Path) -> None:
    nominal, own = (BoxIdentity.of_file(path, (15.0, 5.0)) for path in (None, files / "own.yaml"))
    for name, box in (("shipped", nominal), ("own", own)):
        require_matching_policy(files / name, box)
        require_matching_agent(load_initial_agent(files / name), box)
    bench = str(files / "own.yaml")
    assert SimulationSetup(model="shipped").trouble() == ""
    assert SimulationSetup(model="shipped", filter="learned").trouble() == ""
    assert SimulationSetup(model="analytic", bench=bench).trouble() == "", (
        "another plant than the box believes may be simulated"
    )
    assert SimulationSetup(model=str(files / "own_model.safetensors"), box=bench).trouble() == ""
    requested_filter(("--metric", "constant"), files / "own.yaml")


def test_what_is_shipped_is_for_the_shipped_bench(files: Path) -> None:
    digest = BoxIdentity.of_file(None).digest
    shipped = load_initial_agent(files / "shipped").made
    model = Learned.load().made
    assert model is not None and model.box == digest
    assert shipped is not None and (shipped.box, shipped.base_kp, shipped.base_ki) == (digest, 15.0, 5.0)
    assert shipped.model == weights.digest(weights.shipped())
