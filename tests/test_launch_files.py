# SPDX-License-Identifier: Apache-2.0
"""The launch files name executables that exist, with options that they take. (Launching itself needs a full ROS 2.)"""

from __future__ import annotations

import ast
import os
import re
import subprocess
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix

ROOT = Path(__file__).resolve().parent.parent
FILES = sorted(ROOT.glob("src/*/launch/*.launch.py"))


def calls(path: Path) -> list[ast.Call]:
    return [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]


def executables(path: Path) -> set[tuple[str, str]]:
    """Return the (package, executable) pairs that a launch file names."""
    found = set()
    for call in calls(path):
        words = {
            word.arg: ast.literal_eval(word.value) for word in call.keywords if isinstance(word.value, ast.Constant)
        }
        if "executable" in words:
            found.add((words["package"], words["executable"]))
    return found


def options(path: Path) -> set[str]:
    constants = [node.value for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Constant)]
    return {value for value in constants if isinstance(value, str) and re.fullmatch(r"--[a-z-]+", value)}


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_executables_take_the_options_given(path: Path) -> None:
    help_texts = ""
    for package, executable in executables(path):
        program = Path(get_package_prefix(package), "lib", package, executable)
        assert os.access(program, os.X_OK), f"{package} has no executable {executable}"
        answer = subprocess.run([program, "--help"], capture_output=True, text=True, check=True, timeout=60)
        help_texts += answer.stdout
    assert {option for option in options(path) if not re.search(rf"{option}\b", help_texts)} == set()
