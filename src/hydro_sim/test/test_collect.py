# SPDX-License-Identifier: Apache-2.0
"""What `collect` refuses before it moves anything."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from hydro_sim.nodes.collect import main


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--seconds", "nan"], "--seconds nan: 1 to 36000 is meant"),
        (["--seconds", "-5"], "--seconds -5: 1 to 36000 is meant"),
        (["--seed", "-1"], "--seed -1: 0 or more is meant"),
        (["--seconds", "5", "--write-schedule", "/dev/null/s.yaml"], "/dev/null/s.yaml cannot be written"),
        (["--seconds", "5", "--out", "/dev/null/bag"], "/dev/null/bag cannot be made"),
    ],
)
def test_wrong_words_end_in_one_sentence_and_status_2(
    words: list[str], sentence: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(sys, "argv", ["collect", "--out", str(tmp_path / "bag"), *words])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert sentence in capfd.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "bag").exists()
