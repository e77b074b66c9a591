# SPDX-License-Identifier: Apache-2.0
"""A launch argument that no launch file declares is refused: `ros2 launch` ignores it."""

from __future__ import annotations

import sys

import pytest

from hydro_bridge.ros.launch_arguments import refuse_unknown_arguments
from hydro_core.errors import UserError

FILE = "src/hydro_policy/launch/train.launch.py"


def test_a_misspelt_argument_of_this_launch_file_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "hydro_policy", "train.launch.py", "sed:=3"])
    with pytest.raises(UserError, match=r"sed:= is no argument of train\.launch\.py; is seed:= meant\?"):
        refuse_unknown_arguments(FILE, ("plant", "seed"))
    refuse_unknown_arguments("src/hydro_sim/launch/sim.launch.py", ("pace",))  # which the other one includes
    refuse_unknown_arguments(FILE, ("plant", "sed"))
