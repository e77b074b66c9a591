# SPDX-License-Identifier: Apache-2.0
"""proof.html holds the standards, the pictures and the failures, and nothing that it says is markup."""

from __future__ import annotations

from pathlib import Path

from hydro_bridge.cli.console import Table
from hydro_diagnosis.blind_benchmark import pictures

PNG = b"\x89PNG\r\n"


def written(tmp_path: Path, failed: list[dict[str, object]]) -> str:
    table = Table({"standard": "", "held": ""})
    table.add(standard="named rightly, of <all>", held="19 of 20")
    (tmp_path / "errors.png").write_bytes(PNG)
    pictures.write_page(tmp_path / "proof.html", table, {"errors": tmp_path / "errors.png"}, failed, {"seed": "3"})  # type: ignore[arg-type]
    return (tmp_path / "proof.html").read_text(encoding="utf-8")


def test_standards_pictures_and_failures_stand_on_the_page(tmp_path: Path) -> None:
    failure = {"case": "case_07", "kind": "single", "truth": {"leak": {"size": 1.23456e-12}}, "verdict": "unknown",
               "claimed": {}, "why": "missed & silent"}  # fmt: skip
    shown = written(tmp_path, [failure])
    assert "<td>named rightly, of &lt;all&gt;</td><td>19 of 20</td>" in shown
    assert "{leak: {size: 1.235e-12}}" in shown and "missed &amp; silent" in shown
    assert 'src="data:image/png;base64,iVBORw0K"' in shown


def test_no_failure_is_said(tmp_path: Path) -> None:
    assert "<p>None.</p>" in written(tmp_path, [])
