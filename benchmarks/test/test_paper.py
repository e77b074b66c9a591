# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.paper import report
from benchmarks.paper.store import FULL, RESULTS, Store


@pytest.mark.study
def test_paper_page_is_made_from_its_results(tmp_path: Path) -> None:
    page = (RESULTS.parents[2] / "docs/reports/paper.md").read_text(encoding="utf-8")
    assert page == report.text(Store(tmp_path, FULL, RESULTS))
