# SPDX-License-Identifier: Apache-2.0
"""A page of results: everything in one file, nothing taken for markup."""

from __future__ import annotations

import base64
from pathlib import Path

from hydro_bridge.cli.console import Table
from hydro_bridge.pages import Section, results_page


def page(tmp_path: Path) -> str:
    table = Table({"controller": "", "0.5 Hz": "N, RMSE"}, title="Force RMSE")
    table.add(controller="policy <I>", **{"0.5 Hz": 3.14159})
    table.add(controller="fixed", **{"0.5 Hz": "stopped 1/1"})
    picture = tmp_path / "tracking.png"
    picture.write_bytes(b"picture")
    sections = [
        Section(heading="Force RMSE", text="a & b", table=table),
        Section(heading="Tracking", picture=picture),
        Section(heading="Gains", picture=tmp_path / "none.png"),
    ]
    return results_page("Evaluation <run>", {"plant": "emulator", "truth": None, "score": 0.123456}, sections)


def test_a_page_holds_what_it_shows(tmp_path: Path) -> None:
    text = page(tmp_path)
    assert "Evaluation &lt;run&gt;" in text and "policy &lt;I&gt;" in text and "a &amp; b" in text
    assert '<td class="n">3.142</td>' in text and "<td>stopped 1/1</td>" in text
    assert "0.5 Hz: N, RMSE" in text and "<td>0.1235</td>" in text and ">None<" not in text
    assert base64.b64encode(b"picture").decode() in text
    assert text.count("<img") == 1, "a picture that is not there is left out"
    assert "http" not in text, "nothing is fetched"
