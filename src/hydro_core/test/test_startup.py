# SPDX-License-Identifier: Apache-2.0
"""A command starts from the code of the workspace that is sourced, or says that it would not."""

from __future__ import annotations

from pathlib import Path

import pytest

import hydro_core
from hydro_core.process.startup import copied_workspace

ROOT = Path(str(hydro_core.__file__)).resolve().parents[3]


def test_a_copied_checkout_that_still_runs_the_old_folders_code_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = tmp_path / "install/hydro_core"
    copy.mkdir(parents=True)
    told = f"{tmp_path} was copied and still runs the code of {ROOT}: run `make setup` in it first"
    for prefixes, said in (
        (f"/opt/ros/jazzy:{copy}:{tmp_path}/install/hydro_sim", told),
        (f"{ROOT}/install/hydro_core:/opt/ros/jazzy", ""),
        ("/opt/ros/jazzy", ""),
        ("", ""),
    ):
        monkeypatch.setenv("AMENT_PREFIX_PATH", prefixes)
        assert copied_workspace() == said
