# SPDX-License-Identifier: Apache-2.0
"""`diagnose`: from recordings to a report. The stages in order; each is documented in its own module."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from hydro_diagnosis.estimation.budget import Budget
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.report.diagnosis import Diagnosis
from hydro_diagnosis.selection.search import Search, SearchSettings
from hydro_diagnosis.simulator_comparison import compare_reports
from hydro_diagnosis.stage_border import StageBorder
from hydro_diagnosis.stages.hypotheses import prepare_best_wiring, reconsider_wiring
from hydro_diagnosis.stages.naming import StageResult, model_remainder, name_causes, name_nothing
from hydro_diagnosis.stages.reading import DiagnosisInput, PreparedDiagnosis, ProgressCallback
from hydro_diagnosis.stages.reporting import build_report
from hydro_sim.model.bench import Bench


def diagnose(
    recordings: Sequence[str | Path],
    *,
    holdout: Sequence[str | Path] = (),
    bench: Bench | Mapping[str, Any] | str | Path | None = None,
    model: str | Path | None = None,
    columns: ColumnMap | Mapping[str, Any] | str | Path | None = None,
    without: Sequence[str] = (),
    estimate: Sequence[str] = (),
    as_wired: bool = False,
    simulated: Sequence[str | Path] = (),
    simulated_columns: ColumnMap | Mapping[str, Any] | str | Path | None = None,
    settings: SearchSettings | None = None,
    seconds: float | None = None,
    progress: ProgressCallback = lambda text: None,
) -> Diagnosis:
    """Locate, name, quantify and model the physics of a bench that its simulation lacks.

    Parameters
    ----------
    recordings
        rosbag2 folders, .mcap, or files of other loggers (see `table.read_table`).
    holdout
        Held-out recordings; by default the last recording, or a third of the only one.
    bench
        The baseline: a Bench, the path of a bench.yaml or corrected.yaml or its content, or None for the nominal one.
        A file or content needs only the parameters that the channels require (`bench_parameters.required_parameters`).
    model
        File of a learned bench as the baseline, in place of `bench`.
    columns
        Column map of a file, or of a bag's fields or topics: see `column_map`.
    without
        Causes that are ruled out, by id or by id and options (`friction_viscous:directional`): they are not tried.
    estimate
        Bench parameters that are unknown or uncertain: they are estimated, and are no causes.
    as_wired
        Take the recordings as they are: repairs of wiring are not tried (`stages.hypotheses`).
    simulated
        Recordings of a simulator that was driven with the bench's commands: they are diagnosed against the same bench
        file, and the results are compared (`simulator_comparison`).
    simulated_columns
        Column map of the simulator's recordings; default: `columns`.
    settings
        Settings of the search.
    seconds
        Budget of work [s of CPU, counted: `estimation.budget`], after which the best result so far is returned.
        Default: 24, in proportion beyond 60,000 samples.
    progress
        Called with the name of each stage as it begins, and with texts on its steps.

    Raises
    ------
    InputError
        If no recording can be diagnosed, or the bench file lacks parameters that they require.
    StageError
        If a stage fails without which there is no report, by an error of the program.
    """
    border = StageBorder()
    inputs = DiagnosisInput(
        recordings=recordings, holdout=holdout, bench=bench, model=model, columns=columns, without=without,
        estimate=estimate, as_wired=as_wired, budget=Budget(seconds),
    )  # fmt: skip
    settings = settings or SearchSettings()
    if not simulated:
        return _answered(_prepare(inputs, progress, border), settings, progress, border)

    def told(text: str) -> None:
        progress(f"simulator: {text}")

    beside = replace(
        inputs, recordings=simulated, holdout=(), columns=simulated_columns or columns, budget=Budget(seconds)
    )
    simulator = _prepare(beside, told, border)  # both before any search: what cannot be read is refused at once
    found = _answered(_prepare(inputs, progress, border), settings, progress, border)
    other = _answered(simulator, settings, told, border)
    if border.lost:  # a difference would rest on what is missing
        return found
    return replace(found, report=compare_reports(found.report, other.report))


def _prepare(
    inputs: DiagnosisInput, progress: ProgressCallback, border: StageBorder
) -> tuple[PreparedDiagnosis, float]:
    """Prepared diagnosis of an input, and the time taken to read it [s]."""
    begun = time.monotonic()
    with threadpool_limits(1, "blas"):  # the matrices are thin: more threads only wait for one another
        prepared = border.run("reading", lambda: prepare_best_wiring(inputs, progress))
    return prepared, time.monotonic() - begun


def _answered(
    read: tuple[PreparedDiagnosis, float], settings: SearchSettings, progress: ProgressCallback, border: StageBorder
) -> Diagnosis:
    prepared, begun = read[0], time.monotonic() - read[1]
    given = None not in prepared.estimated_parameters.values()

    def named() -> tuple[Search, StageResult]:
        """Search over the prepared problem, and its names; none if it fails."""
        search = Search(prepared.problem, prepared.candidates, settings, progress, given=given)
        return search, border.run(
            "naming", lambda: name_causes(prepared, search), lambda: name_nothing(prepared, search)
        )

    with threadpool_limits(1, "blas"):
        search, found = named()
        before = prepared
        prepared = border.run("wiring", lambda: reconsider_wiring(before, found, progress), lambda: before)
        prepared.inputs.reader.clear()  # no further hypothesis reads
        if prepared.problem is not before.problem:
            search, found = named()
        names = found
        found = border.run("modelling", lambda: model_remainder(names, prepared, search), lambda: names)
        return border.run(
            "report",
            lambda: build_report(prepared, search, found, begun, border),
            lambda: build_report(prepared, search, name_nothing(prepared, search), begun, border),
        )
