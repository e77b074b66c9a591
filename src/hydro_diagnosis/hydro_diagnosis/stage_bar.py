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
LABEL = "diagnosing"
LINE_INTERVAL = 10.0
"""Interval [s] of the lines that replace the bar without a terminal."""
SIMULATOR_PREFIX = "simulator: "
"""Prefix of progress texts on the simulator's recordings, for which the bar starts anew."""


class StageBar:
    """Progress bar over `STAGES`, called with each stage as it begins, and with texts on the steps within it."""

    def __init__(self) -> None:
        shown = "{desc}: |{bar:20}| {n_fmt}/{total_fmt} [{elapsed}{postfix}]"
        self._bar: tqdm[Any] = progress(total=len(STAGES), label=LABEL, every=LINE_INTERVAL, bar_format=shown)
        self._simulator = False

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
        simulator, stage = text.startswith(SIMULATOR_PREFIX), text.removeprefix(SIMULATOR_PREFIX)
        if simulator != self._simulator:
            self._simulator = simulator
            self._bar.n = 0
            self._bar.set_description_str("diagnosing the simulator" if simulator else LABEL, refresh=False)
        done = max(STAGES.index(stage) if stage in STAGES else 0, int(self._bar.n))
        self._bar.set_postfix_str(stage, refresh=False)
        self._bar.update(done - self._bar.n)
        if self._bar.mininterval < LINE_INTERVAL:
            self._bar.refresh()
