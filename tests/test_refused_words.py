# SPDX-License-Identifier: Apache-2.0
"""What a command line asks for and cannot have: one sentence, status 2, nothing left; wrong pairings of files first.

Each command is called as its executable calls it.

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
from collections.abc import Callable
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
from hydro_filter.metric import shipped_metric as shipped_metric
from hydro_msgs.msg import BoxInfo
from hydro_policy.envs.simulation import SimulationSetup
from hydro_policy.nodes.plant_options import require_matching_agent, require_matching_policy
from hydro_policy.nodes.plants import requested_filter
from hydro_policy.runs.initial_agent import load_initial_agent, shipped_agent
from hydro_sim.files import learned_bench
from hydro_sim.files.pairing import BoxIdentity, MadeFor, with_provenance
from hydro_sim.files.recordings import BOX_TOPIC
from hydro_sim.model.bench import Bench
from tests.checks import each

SINE = "{seconds: 1.0, amplitude: 200}"
SCHEDULES = {
    "seconds": f"[{SINE}, {{seconds: abc}}]",
    "pulse": f"[{SINE}, {{seconds: 1, delta_u: 0.01}}]",
}
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
        ("--out @new --model @own.yaml --box @own.yaml --filter learned", FOREIGN),
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
REFUSED = {
    "hydro_bridge bridge": (
        ("--ros-args -p guard.delta_kp_mx:=30.0", "no parameter guard.delta_kp_mx; is guard.delta_kp_max"),
        ("--port @plain.yaml", "plain.yaml is a file, not a serial port"),
        ("--bench @corrected.yaml", "has effects, which no force law believes"),
    ),
    "hydro_bridge recorder": (("--out @bag", "exists already; a recording is never overwritten"),),
    "hydro_bridge view": (("@bag --no-open --from 3 --to 2", "the end must come behind the begin"),),
    "hydro_policy collect": (
        ("--out @new --schedule @seconds", "segments[1].seconds must be a number in s, not 'abc'"),
        ("--out @new --schedule @pulse", "segments[1].delta_u is 0.01 A: only the emulator"),
    ),
    "hydro_sim emulator": (
        ("--offline", "--offline needs --out"),
        ("--speed 1", "--speed is now --pace"),
        ("--pace fast", "--pace fast: say plant, real, or a factor of real time"),
        ("--offline --out /dev/null/x", "/dev/null is not a folder: choose another place"),
    ),
    "hydro_sim export": (
        ("--bench @corrected.yaml", "one of the arguments --fmu --mujoco --simulink --c --box is required"),
        ("--c @model.c --name mine", "--name and --integral go with --box, not with --c"),
        ("--fmu @bench.xml", "bench.xml: a file of --fmu ends in .fmu"),
        ("--simulink @1st.c", "1st.c: the name of an S-function is made of letters, digits and _"),
        ("--c @model.c --bench @nowhere.yaml", "nowhere.yaml"),
        ("--fmu /dev/null/x.fmu", "/dev/null/x.fmu cannot be written"),
    ),
    "hydro_sim export_c": (("--out @box.h", "export_c is now `ros2 run hydro_sim export --box FILE.h`"),),
    "hydro_sim collect": (("--out @new", "collect is now `ros2 run hydro_policy collect`"),),
    "hydro_sim learn": (
        ("@bag --out @new", "a bench file's name ends in .yaml or .yml"),
        ("@bag --out /dev/null/x", "/dev/null/x cannot be written"),
    ),
    "hydro_sim validate": (("@nowhere", "nowhere does not exist"),),
    "hydro_sim sim": (
        ("--speed 0", "--speed is now --pace"),
        ("--pace -1", "--pace -1: say plant, real, or a factor of real time within (0, 100]"),
        ("--ros-args -p box.load_force_limit:=-5.0", "parameter box.load_force_limit: "),
        ("--ros-args -p simulator:seed:=5", "parameters of /simulator reach no node, this is /sim; is /sim meant?"),
        ("--ros-args --params-file @simulator.params", "parameters of /simulator reach no node, this is /sim"),
        ("--ros-args -r __node:=mine --params-file @sim.params", "parameters of /sim reach no node, this is /mine"),
        ("--ros-args --params-file @far.params", "parameters of /lab/sim reach no node, this is /sim; is /sim meant?"),
        ("--ros-args --params-file @both.params", "parameters of /flter reach no node, this is /sim"),
        ("--ros-args --params-file @every.params", "no parameter gaurd.delta_kp_max; is guard.delta_kp_max meant?"),
    ),
    "hydro_filter filter": (
        ("--metric /nowhere.safetensors", "cannot be read as weights"),
        ("--site @", "bench.yaml is not there: `ros2 run hydro_policy commission` has not got that far"),
    ),
    "hydro_policy pretrain": (("--out @new --model nowhere.safetensors", "nowhere.safetensors"),),
    "hydro_policy trainer": (
        ("--runs @new --resume /nowhere", "holds no run to resume"),
        ("--runs @new --ros-args -p sac.gama:=0.9", "no parameter sac.gama; is sac.gamma meant?"),
        ("--runs @new --plant sim --truth t.yaml", "--truth is of no use with --plant sim; it goes with emulator"),
    ),
    "hydro_policy evaluate": (
        ("--runs @new --fixed nan 5", "fixed gains are two finite numbers, not nan and 5"),
        ("--runs @new --plant sim --site @ --bench b.yaml", "--bench is told by --site"),
        ("--runs @new --plant sim --filter none", "--filter none leaves the compensated law"),
    ),
    "hydro_policy commission": (
        ("--site @new", "which bench? Name its --port"),
        ("--site @new --port /dev/null", "which bench.yaml does the box believe?"),
    ),
}
"""The same of other words."""


PARAMETERS = {"simulator": ("simulator",), "sim": ("sim",), "both": ("sim", "flter"), "every": ("/**",)}
"""Files of parameters: the nodes that they name."""


def make_files(folder: Path) -> None:
    """Own bench, models, metrics and policies, by what they say they were made for."""
    nominal = Bench.nominal()
    (folder / "plain.yaml").write_text(yaml.safe_dump(nominal.to_mapping()))
    effects = [{"id": "friction_coulomb", "parameters": {"force": 12.0}}]
    (folder / "corrected.yaml").write_text(yaml.safe_dump(nominal.to_mapping() | {"effects": effects}))
    for name, segments in SCHEDULES.items():
        (folder / name).write_text(f"segments: {segments}\n")
    for name, nodes in PARAMETERS.items():
        told = {"ros__parameters": {"gaurd.delta_kp_max" if name == "every" else "seed": 5}}
        (folder / f"{name}.params").write_text(json.dumps(dict.fromkeys(nodes, told)))
    far = {"lab": {"sim": {"ros__parameters": {"seed": 5}}}}
    (folder / "far.params").write_text(yaml.safe_dump(far))
    with BagWriter(folder / "bag") as bag:
        bag.write_states(np.zeros(10, STATE_DTYPE))
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


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., None]:
    """Call `package executable` as its entry point does: one sentence, status 2, nothing left in the folder, its @."""

    def check(command: str, words: str, sentence: str, folder: Path) -> None:
        package, name = command.split()
        before = set(folder.rglob("*"))
        monkeypatch.setattr(sys, "argv", [name, *shlex.split(words.replace("@", f"{folder}/"))])
        with pytest.raises(SystemExit) as ended:
            sys.exit(importlib.import_module(executables(package)[name]).main())
        *others, said = capfd.readouterr().err.splitlines()
        assert ended.value.code == 2, said
        assert "error: " in said and sentence in said, said
        assert "Traceback" not in "".join(others) and set(folder.rglob("*")) == before, "nothing is left behind"

    return check


@pytest.mark.parametrize("command", sorted(WRONG.keys() | REFUSED.keys()))
def test_it_is_refused_in_one_sentence(command: str, files: Path, refused: Callable[..., None]) -> None:
    rows = (*WRONG.get(command, ()), *REFUSED.get(command, ()))
    each(rows, lambda row: refused(command, *row, files))


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
