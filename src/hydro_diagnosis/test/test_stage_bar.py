# SPDX-License-Identifier: Apache-2.0
"""The bar has a bound, tells what is tried, and stands still where a diagnosis ends early."""

from __future__ import annotations

import pytest

from hydro_diagnosis import stage_bar
from hydro_diagnosis.stage_bar import STAGES, StageBar


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a terminal a line is due every ten seconds: here at once."""
    monkeypatch.setattr(stage_bar, "LINES", 0.0)


def test_each_stage_moves_it_and_what_is_tried_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with StageBar() as bar:
        for stage in STAGES:
            bar(stage)
        bar("add friction_coulomb")
    said = capsys.readouterr().err.splitlines()
    assert f"{len(STAGES)}/{len(STAGES)}" in said[-1]
    assert any("1/5" in line and "searching" in line for line in said)


def test_it_stands_still_where_the_diagnosis_is_interrupted(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyboardInterrupt), StageBar() as bar:
        bar(stage_bar.SEARCHING)
        raise KeyboardInterrupt
    last = capsys.readouterr().err.splitlines()[-1]
    assert "1/5" in last and "searching" in last
