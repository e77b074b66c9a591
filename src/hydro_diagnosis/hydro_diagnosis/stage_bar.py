# SPDX-License-Identifier: Apache-2.0
"""Progress bar of a diagnosis: its stages, and the step within a stage."""

from __future__ import annotations

from typing import Any

from tqdm import tqdm

from hydro_core.cli.console import progress

READING = "reading"
CURVES = "reading curves off"
SEARCHING = "searching"
SELECTING = "selecting effects"
CHECKING = "checking on held-out recordings"
MODELLING = "modelling what has no name"
FORECASTING = "forecasting control"
STAGES = (READING, CURVES, SEARCHING, SELECTING, CHECKING, MODELLING, FORECASTING)
"""Stages of a diagnosis, in order; `MODELLING` is skipped if named effects explain everything."""
LINE_INTERVAL = 10.0
"""Interval [s] of the lines that replace the bar without a terminal."""


class StageBar:
    """Progress bar over `STAGES`, called with each stage as it begins, and with texts on the steps within it."""

    def __init__(self) -> None:
        shown = "{desc}: |{bar:20}| {n_fmt}/{total_fmt} [{elapsed}{postfix}]"
        self._bar: tqdm[Any] = progress(total=len(STAGES), label="diagnosing", every=LINE_INTERVAL, bar_format=shown)

    def __enter__(self) -> StageBar:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the bar, full unless something was raised."""
        if kind is None:
            self._bar.set_postfix_str("", refresh=False)
            self._bar.n = len(STAGES)
        self._bar.close()

    def __call__(self, text: str) -> None:
        """Show a text; one of `STAGES` moves the bar, never back: a stage may be repeated (`stages.hypotheses`)."""
        done = max(STAGES.index(text) if text in STAGES else 0, int(self._bar.n))
        self._bar.set_postfix_str(text, refresh=False)
        self._bar.update(done - self._bar.n)
        if self._bar.mininterval < LINE_INTERVAL:
            self._bar.refresh()
