# SPDX-License-Identifier: Apache-2.0
"""The first start of every executable is the tenth: set-up has compiled what they need."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy")

from hydro_bridge.ros.companion import executable_path
from hydro_sim.compiled import VARIABLE, read_compilations
from tests.graph_probe import own_domain


def run(words: str, folder: Path, *more: str) -> set[str]:
    """Run `package executable words`, {out} being `folder`; what was compiled meanwhile, by all its processes."""
    log = folder / "compilations.jsonl"
    package, executable, *rest = words.format(out=folder).split()
    command = [str(executable_path(package, executable)), *rest, *more]
    environment = {**os.environ, VARIABLE: str(log)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return {f"{line['program']}: {line['function']}" for line in read_compilations(log)}


@pytest.fixture(scope="module", autouse=True)
def apart() -> Iterator[None]:
    with own_domain():
        yield


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    leak = {"leakage_internal": {"coefficient": 3e-13}, "friction_viscous": {"coefficient": 60.0}}
    (folder / "truth.yaml").write_text(yaml.safe_dump({"profile": "nominal", "effects": leak}))
    words = "hydro_sim emulator --offline --seconds 8 --truth {out}/truth.yaml --out {out}/bag"
    assert run(words, folder) == set()
    return folder / "bag"


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        "hydro_sim learn {bag} --out {out}/learnt.yaml --windows 4",
        "hydro_policy pretrain --out {out}/agent --episodes 1 --steps 20 --model analytic --filter learned",
        "hydro_diagnosis diagnose {bag} --out {out}/diagnosis",
    ],
)
def test_offline_work_compiles_nothing(words: str, recording: Path, tmp_path: Path) -> None:
    assert run(words.replace("{bag}", str(recording)), tmp_path) == set()
