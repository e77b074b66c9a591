# SPDX-License-Identifier: Apache-2.0
"""Repeating graph tests counts what pytest reports."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.graph_repeat import read_report

SUITE = """
import pytest
def test_good(): pass
def test_bad(): assert False
@pytest.fixture
def broken(): raise OSError
def test_without_its_fixture(broken): pass
@pytest.mark.skip
def test_left_out(): pass
"""


def test_what_passed_and_what_did_not_is_read_from_the_report(tmp_path: Path) -> None:
    (tmp_path / "test_suite.py").write_text(SUITE)
    report = tmp_path / "report.xml"
    words = ["-q", "-p", "no:cacheprovider", f"--rootdir={tmp_path}", f"--junitxml={report}", str(tmp_path)]
    subprocess.run([sys.executable, "-m", "pytest", *words], capture_output=True, check=False)
    found = {name.rpartition("::")[2]: passed for name, passed in read_report(report).items()}
    assert found == {"test_good": True, "test_bad": False, "test_without_its_fixture": False}
