# SPDX-License-Identifier: Apache-2.0
"""What a command line asks for and cannot have: one sentence, status 2, nothing left. Each is called as its executable.

The files differ in nothing but what they say they were made for: `own` is for another bench (another spring, cylinder
and supply), `other` for this bench and another model, `unmarked` does not say. A learned bench of one's own is for any
box; the shipped one is for the shipped box.
"""

from __future__ import annotations

import importlib
import json
import shlex
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from rclpy.serialization import serialize_message

from docs.generate_reference import executables
from hydro_bridge.bags.recording import BagWriter
from hydro_core.signals import STATE_DTYPE
from hydro_filter.metric import shipped_metric
from hydro_msgs.msg import BoxInfo
from hydro_policy.envs.simulation import SimulationSetup
from hydro_policy.nodes.plant_options import require_matching_agent, require_matching_policy
from hydro_policy.nodes.plants import requested_filter
from hydro_policy.runs.initial_agent import load_initial_agent, shipped_agent
from hydro_sim.files import learned_bench
from hydro_sim.files.pairing import BoxIdentity, Provenance, with_provenance
from hydro_sim.files.recordings import BOX_TOPIC
from hydro_sim.model.bench import Bench

FOREIGN = "was made for bench"
UNMARKED = "does not say which bench it was made for"
OWN = "--model @own_model.yaml --metric @own_metric.safetensors"
"""The filter of `own.yaml`."""
REFUSED: dict[str, tuple[tuple[str, str], ...]] = {
    "hydro_bridge bridge": (
        ("--ros-args -p guard.delta_kp_mx:=30.0", "no parameter guard.delta_kp_mx; is guard.delta_kp_max"),
        ("--ros-args -r /hydro/stat:=/mine/state", "--remap /hydro/stat:=/mine/state: bridge has no such name"),
        ("--port @plain.yaml", "plain.yaml is not a serial port"),
        ("--port=", "the port's name is empty: give the device"),
        ("--bench @corrected.yaml", "has effects or closures, it is a model: name the bench.yaml of the box"),
    ),
    "hydro_bridge recorder": (("--out @bag", "bag exists already: name a new folder"),),
    "hydro_filter filter": (
        ("--bench @own.yaml", f"the model learned_bench.yaml {FOREIGN}"),
        ("--bench @own.yaml --model @own_model.yaml", f"the metric default_metric.safetensors {FOREIGN}"),
        ("--metric @own_metric.safetensors", f"the metric own_metric.safetensors {FOREIGN}"),
        ("--model @other_model.yaml", "the metric default_metric.safetensors was made for model"),
        ("--metric @unmarked_metric.safetensors", UNMARKED),
        ("--metric /nowhere.safetensors", "cannot be read as weights"),
        ("--site @", "bench.yaml is not there: `ros2 run hydro_policy commission` has not got that far"),
    ),
    "hydro_filter learn_metric": (
        ("--out @new/m.safetensors --bench @own.yaml", f"the model learned_bench.yaml {FOREIGN}"),
        ("--out @new/m.safetensors --recording @own_bag", "the box of the recording own_bag believes bench"),
    ),
    "hydro_policy collect": (
        ("--out @new --schedule @seconds", "segments[1].seconds must be a number within [0.001, 36000] s, not 'abc'"),
        ("--out @new --schedule @pulse", "segments[1].delta_u is 0.01 A: only the emulator"),
    ),
    "hydro_policy commission": (
        ("--site @new", "which bench? Name its --port"),
        ("--site @new --port=", "which bench? Name its --port"),
    ),
    "hydro_policy evaluate": (
        ("--runs @new --fixed nan 5", "fixed gains are two finite numbers, not nan and 5"),
        ("--runs @new --plant sim --site @ --bench b.yaml", "--bench is told by --site"),
        ("--runs @new --plant sim --filter none", "--filter none leaves the compensated law"),
        ("--runs @new --plant sim --bench @own.yaml", f"the model learned_bench.yaml {FOREIGN}"),
        ("--runs @new --plant sim --policy @own", f"the policy own {FOREIGN}"),
        ("--runs @new --plant emulator --policy @unmarked", UNMARKED),
        ("--runs @new --plant sim --base-gains 30 8 --policy @shipped", "was made for a box with base K_p 15"),
    ),
    "hydro_policy pretrain": (
        ("--out @new --model nowhere.safetensors", "nowhere.safetensors"),
        ("--out @new --box @own.yaml", f"the model learned_bench.yaml {FOREIGN}"),
        ("--out @new --model @own.yaml --box @own.yaml --filter learned", FOREIGN),
    ),
    "hydro_policy trainer": (
        ("--runs @new --plant bench --port=", "name is empty: give the device"),
        ("--runs @new --resume /nowhere", "holds no run to resume"),
        ("--runs @new --ros-args -p sac.gama:=0.9", "no parameter sac.gama; is sac.gamma meant?"),
        ("--runs @new --plant sim --truth t.yaml", "--truth goes with --plant emulator, not with sim"),
        ("--runs @new --plant emulator --bench @own.yaml --configuration wide", FOREIGN),
        (f"--runs @new --plant sim --bench @own.yaml --filter='{OWN}'", f"the agent pretrained_paper {FOREIGN}"),
        ("--runs @new --plant sim --from @unmarked", UNMARKED),
        ("--runs @new --plant sim --base-gains 30 8", "was made for a box with base K_p 15, this one has 30"),
        ("--runs @new --plant bench --filter=--model=@other_model.yaml", "was made for model"),
        ("--runs @new --plant sim --filter none", "a policy trains behind the filter"),
    ),
    "hydro_sim emulator": (("--offline", "--offline needs --out"),),
    "hydro_sim export": (
        ("--bench @corrected.yaml", "one of the arguments --fmu --mujoco --simulink --c --box is required"),
    ),
    "hydro_sim learn": (("@bag --out @new", "a bench file's name ends in .yaml or .yml"),),
    "hydro_sim sim": (
        ("--model shipped --box-bench @own.yaml", f"the model learned_bench.yaml {FOREIGN}"),
        ("--ros-args -p box.load_force_limit:=-5.0", "parameter box.load_force_limit: "),
        ("--ros-args -p simulator:seed:=5", "parameters of /simulator reach no node, this is /sim"),
        ("--ros-args --params-file @every.params", "no parameter gaurd.delta_kp_max; is guard.delta_kp_max meant?"),
    ),
    "hydro_sim validate": (
        ("@nowhere", "nowhere does not exist"),
        ("@bag --bench @own.yaml", f"the model learned_bench.yaml {FOREIGN}"),
    ),
}
"""Words of each command, @ for the folder of `files`, with part of what is said."""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bench, models, metrics and policies, by what they say they were made for."""
    folder, nominal = tmp_path_factory.mktemp("files"), Bench.nominal()
    own = replace(nominal, spring_stiffness=4e4, piston_area=3e-4, supply_pressure=12e6)
    learned = learned_bench.load_model()
    almost = replace(learned, moving_mass=learned.moving_mass * (1.0 + 1e-9), learned=None)  # another by its digest
    corrected = replace(nominal, effects=({"id": "friction_coulomb", "parameters": {"force": 12.0}},))
    benches = {"plain": nominal, "corrected": corrected, "own": own, "other_model": almost, "own_model": almost}
    for name, bench in benches.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(bench.to_mapping()), encoding="utf-8")
    for name, second in (("seconds", {"seconds": "abc"}), ("pulse", {"seconds": 1, "delta_u": 0.01})):
        (folder / name).write_text(json.dumps({"segments": [{"seconds": 1.0, "amplitude": 200}, second]}))
    every = {"/**": {"ros__parameters": {"gaurd.delta_kp_max": 5}}}
    (folder / "every.params").write_text(json.dumps(every))
    with BagWriter(folder / "bag") as bag:
        bag.write_states(np.zeros(10, STATE_DTYPE))
    with BagWriter(folder / "own_bag") as bag:
        bag.add_topic(BOX_TOPIC, "hydro_msgs/msg/BoxInfo")
        bag.write(BOX_TOPIC, serialize_message(BoxInfo(bench_digest=own.digest)), 0)
    metric, other = shipped_metric().read_bytes(), learned_bench.digest(folder / "other_model.yaml")
    (folder / "own_metric.safetensors").write_bytes(with_provenance(metric, Provenance(box=own.digest, model=other)))
    (folder / "unmarked_metric.safetensors").write_bytes(with_provenance(metric, None))
    start = shipped_agent("paper")
    shutil.copytree(start.source, folder / "shipped")
    for name, made in (("own", Provenance(box=own.digest, base_kp=15.0, base_ki=5.0)), ("unmarked", None)):
        shutil.copytree(start.source, folder / name)
        for file in (folder / name).iterdir():
            file.write_bytes(with_provenance(file.read_bytes(), made))
    return folder


@pytest.mark.parametrize(
    ("command", "words", "sentence"), [(command, *row) for command, rows in REFUSED.items() for row in rows]
)
def test_it_is_refused_in_one_sentence_and_leaves_nothing_behind(
    command: str, words: str, sentence: str, files: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    package, name = command.split()
    before = set(files.rglob("*"))
    monkeypatch.setattr(sys, "argv", [name, *shlex.split(words.replace("@", f"{files}/"))])
    with pytest.raises(SystemExit) as ended:
        sys.exit(importlib.import_module(executables(package)[name]).main())
    *others, said = capfd.readouterr().err.splitlines()
    assert ended.value.code == 2, said
    assert "error: " in said and sentence in said, said
    assert "Traceback" not in "".join(others) and set(files.rglob("*")) == before


def test_policies_and_simulations_of_one_bench_throughout_are_taken(files: Path) -> None:
    nominal, own = (BoxIdentity.of_file(path, (15.0, 5.0)) for path in (None, files / "own.yaml"))
    for name, box in (("shipped", nominal), ("own", own)):
        require_matching_policy(files / name, box)
        require_matching_agent(load_initial_agent(files / name), box)
    bench = str(files / "own.yaml")
    assert SimulationSetup(model="shipped").pairing_error() == ""
    assert SimulationSetup(model="shipped", filter="learned").pairing_error() == ""
    assert SimulationSetup(model=bench).pairing_error() == "", "the plant may be another than believed"
    assert SimulationSetup(model=str(files / "own_model.yaml"), box=bench).pairing_error() == ""
    requested_filter(OWN.replace("@", f"{files}/").split(), files / "own.yaml")
