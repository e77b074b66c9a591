# SPDX-License-Identifier: Apache-2.0
"""What a command line asks for and cannot have: one sentence, status 2, nothing left behind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.signals import STATE_DTYPE
from hydro_sim.model.bench import Bench
from tests.checks import each

SINE = "{seconds: 1.0, amplitude: 200}"
SCHEDULES = {
    "seconds": f"[{SINE}, {{seconds: abc}}]",
    "pulse": f"[{SINE}, {{seconds: 1, delta_u: 0.01}}]",
    "none": "3",
}
REFUSED = {
    "hydro_bridge bridge": (
        ("--ros-args -p guard.delta_kp_mx:=30.0", "no parameter guard.delta_kp_mx; is guard.delta_kp_max"),
        ("--ros-args --nonsense", "--nonsense"),
        ("--port @plain.yaml", "plain.yaml is a file, not a serial port"),
        ("--port /dev/null", "/dev/null is another device, not a serial port"),
        ("--bench @corrected.yaml", "has effects, which no force law believes"),
    ),
    "hydro_bridge recorder": (
        ("--out /dev/null/bag", "/dev/null is not a folder: choose another place"),
        ("--out @bag", "exists already; a recording is never overwritten"),
    ),
    "hydro_bridge arm": (("--timeout=nan", "argument --timeout: nan: must be 0.01 or more"),),
    "hydro_bridge view": (
        ("@bag --no-open --from 3 --to 2", "the end must come behind the begin"),
        ("@bag --no-open --from 60", "no samples from 60"),
    ),
    "hydro_bridge dashboard": (("--port 65536", "65536"), ("--port http", "http")),
    "hydro_sim collect": (
        ("--out @new --seconds nan", "argument --seconds: nan: must be 1 to 36000"),
        ("--out /dev/null/bag --seconds 5", "/dev/null/bag cannot be made"),
        ("--out @new --bench nowhere.yaml", "nowhere.yaml cannot be read: "),
        ("--out @new --schedule @seconds", "segments[1].seconds must be a number in s, not 'abc'"),
        ("--out @new --schedule @pulse", "segments[1].delta_u is 0.01 A: only the emulator"),
        ("--out @new --schedule @none", "must hold one list of segments under the key segments"),
    ),
    "hydro_sim emulator": (
        ("--offline", "--offline needs --out"),
        ("--out @new", "add --offline"),
        ("--offline --out @new --truth none.yaml", "none.yaml cannot be read"),
        ("--offline --out /dev/null/x", "/dev/null is not a folder: choose another place"),
        ("--seconds nan", "--seconds nan"),
    ),
    "hydro_sim learn": (
        ("@bag --out @new", "a bench file's name ends in .yaml or .yml"),
        ("@bag --out @new.yaml --windows 0", "argument --windows: 0: must be a whole number, 1 or more"),
        ("@bag --out /dev/null/x", "/dev/null/x cannot be written"),
    ),
    "hydro_sim validate": (("@nowhere", "nowhere does not exist"),),
    "hydro_sim sim": (
        ("--bench nowhere.yaml", "nowhere.yaml cannot be read: "),
        ("--speed -1", "speed must be within [0, 100], not -1"),
        ("--ros-args -p box.load_force_limit:=-5.0", "parameter box.load_force_limit: "),
    ),
    "hydro_filter filter": (
        ("--metric /nowhere.safetensors", "cannot be read as weights"),
        ("--site @", "bench.yaml is not there: `ros2 run hydro_policy commission` has not got that far"),
    ),
    "hydro_filter export_c": (("--out @new --contraction-rate -1", "contraction_rate"),),
    "hydro_filter learn_metric": (("--out /dev/null/x", "/dev/null"),),
    "hydro_policy export_c": (("--out @new --policy @plain.yaml", "cannot be read as weights"),),
    "hydro_policy pretrain": (
        ("--out @new --model nowhere.safetensors", "nowhere.safetensors"),
        ("--out @new --bench b.yaml --model shipped", "a bench of its own"),
        ("--out @new --bench b.yaml --model c.yaml", "which of them is simulated?"),
        ("--out @new --episodes 0", "episodes must be within"),
        ("--out /dev/null/run", "/dev/null is not a folder: choose another place"),
    ),
    "hydro_policy trainer": (
        ("--runs @new --resume /nowhere", "holds no run to resume"),
        ("--runs @new --ros-args -p sac.discont:=0.9", "no parameter sac.discont; is sac.discount meant?"),
        ("--runs @new --plant sim --truth t.yaml", "--truth is of no use with --plant sim; it goes with emulator"),
        ("--runs @new --plant external --filter=--bypass", "--filter is of no use with --plant external"),
        ("--runs @new --plant sim --model /nowhere", "--model /nowhere: there is no such file"),
        ("--runs /dev/null", "cannot be made"),
    ),
    "hydro_policy evaluate": (
        ("--runs @new --fixed nan 5", "fixed gains are two finite numbers, not nan and 5"),
        ("--runs @new --repeats 0", "repeats must be within [1, 1000], not 0"),
        ("--runs @new --json /dev/null/figures.json", "/dev/null is not a folder: choose another place"),
        ("--runs @new --record @new", "--record is of no use where the plant runs already"),
        ("--runs @new --plant sim --site @ --bench b.yaml", "--bench is told by --site"),
        ("--runs @new --plant sim --filter none", "--filter none leaves the compensated law"),
    ),
    "hydro_policy commission": (
        ("--site @new", "which bench? Name its --port"),
        ("--site @new --port /dev/null", "which bench.yaml does the box believe?"),
        ("--site @new --port /dev/null --truth t.yaml", "--truth is of the emulated bench"),
    ),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    (folder / "plain.yaml").write_text(yaml.safe_dump(Bench.nominal().to_mapping()))
    effects = [{"id": "friction_coulomb", "parameters": {"force": 12.0}}]
    (folder / "corrected.yaml").write_text(yaml.safe_dump(Bench.nominal().to_mapping() | {"effects": effects}))
    for name, segments in SCHEDULES.items():
        (folder / name).write_text(f"segments: {segments}\n")
    with BagWriter(folder / "bag") as bag:
        bag.write_states(np.zeros(10, STATE_DTYPE))
    return folder


@pytest.mark.parametrize("command", REFUSED)
def test_it_is_refused_in_one_sentence(command: str, files: Path, refused: Callable[..., None]) -> None:
    each(REFUSED[command], lambda row: refused(command, *row, files))
