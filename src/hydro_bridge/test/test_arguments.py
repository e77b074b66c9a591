# SPDX-License-Identifier: Apache-2.0
"""An option of a node is a parameter, too: in a run's graph.yaml, or by `-p`; the command line takes precedence."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from hydro_bridge.arguments import parse_arguments

GRAPH = """\
/**: {ros__parameters: {seed: 1}}
sim: {ros__parameters: {pace: real, realtime: true, files: [a, b c], guard.delta_kp_max: 50.0}}
filter: {ros__parameters: {pace: plant}}
"""


@pytest.mark.parametrize(
    ("own", "ros", "expected"),
    [
        ([], [], {"pace": "real", "seed": 1, "realtime": True, "files": ["a", "b c"]}),
        (["--pace", "2", "--seed", "7"], [], {"pace": "2", "seed": 7, "realtime": True, "files": ["a", "b c"]}),
        ([], ["-p", "sim:pace:=3.5"], {"pace": "3.5", "seed": 1, "realtime": True, "files": ["a", "b c"]}),
        ([], ["-p", "filter:pace:=3.5", "-p", "seed:=4"], {"pace": "real", "seed": 4, "realtime": True}),
        ([], ["-r", "__node:=filter"], {"pace": "plant", "seed": 1, "realtime": False, "files": []}),
        ([], ["-r", "sim:__node:=other"], {"pace": None, "seed": 1, "realtime": False, "files": []}),
    ],
)
def test_options_come_from_the_nodes_section_and_from_the_command_line(
    own: list[str], ros: list[str], expected: dict[str, object], tmp_path: Path
) -> None:
    file = tmp_path / "graph.yaml"
    file.write_text(GRAPH, encoding="utf-8")
    parser = argparse.ArgumentParser()
    parser.add_argument("--pace")
    parser.add_argument("--seed", type=int, choices=range(10))
    parser.add_argument("--realtime", action="store_true")
    parser.add_argument("--files", nargs="+", default=[])
    found = vars(parse_arguments(parser, "sim", own, ["--ros-args", "--params-file", str(file), *ros]))
    assert {name: found[name] for name in expected} == expected
    with pytest.raises(SystemExit):
        parse_arguments(parser, "sim", own, ["--ros-args", "-p", "seed:=11"])
