# SPDX-License-Identifier: Apache-2.0
"""The first start of every executable is the tenth: set-up has compiled what they need. (`.ci/run` asks the graph.)"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy")

from hydro_bridge.ros.companion import executable_path
from hydro_sim.jit import LOG_VARIABLE
from tests.checks import ran

OFFLINE = (
    "hydro_sim emulator --offline --seconds 6 --truth {out}/truth.yaml --out {out}/bag",
    "hydro_sim learn {out}/bag --out {out}/learnt.yaml --windows 4",
    "hydro_policy pretrain --out {out}/agent --episodes 1 --steps 20 --model analytic --filter learned",
    "hydro_diagnosis diagnose {out}/bag --out {out}/diagnosis",
)


@pytest.mark.slow
def test_offline_work_compiles_nothing(tmp_path: Path) -> None:
    leak = {"friction_viscous": {"coefficient": 60.0}}
    (tmp_path / "truth.yaml").write_text(yaml.safe_dump({"profile": "nominal", "effects": leak}))
    for words in OFFLINE:
        package, executable, *rest = words.format(out=tmp_path).split()
        done = ran(executable_path(package, executable), *rest, env=os.environ | {LOG_VARIABLE: f"{tmp_path}/log"})
        assert done.returncode == 0, done.stdout + done.stderr
        assert not (tmp_path / "log").exists(), (tmp_path / "log").read_text()
