# SPDX-License-Identifier: Apache-2.0
"""What docs/examples shows runs, and says what it is said to say."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).resolve().parents[3] / "docs" / "examples" / "diagnose_a_recording.py"


@pytest.mark.slow
def test_example_names_what_its_bench_has(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found, again = runpy.run_path(str(EXAMPLE))["main"](tmp_path)
    assert found.report.verdict == "explained"
    named = {effect.id: next(iter(effect.parameters.values())) for effect in found.report.effects}
    assert set(named) == {"leakage_internal", "friction_coulomb"}
    assert named["leakage_internal"].value == pytest.approx(2e-13, rel=0.01)
    assert named["friction_coulomb"].value == pytest.approx(8.0, rel=0.01)
    assert again.report.verdict == "no_mismatch"
    assert "verdict: explained" in capsys.readouterr().out
