# SPDX-License-Identifier: Apache-2.0
"""First stage: the estimation problem and its candidate effects, from recordings and the baseline bench.

The baseline is the assumed bench, as a `Bench` whose `effects` are known and are not claimed again. It comes from a
bench.yaml, from a diagnosis' corrected.yaml, or from `ros2 run hydro_sim learn`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from hydro_bridge.bags import is_bag
from hydro_bridge.bags.recording import RecordingError, stream_bag
from hydro_diagnosis import stage_bar
from hydro_diagnosis.bench_parameters import (
    PartialBench,
    applies,
    is_missing,
    mark_unknown,
    omission_notes,
    parse_bench,
    read_bench,
    recorded_size,
    require_parameters,
)
from hydro_diagnosis.effects import CANDIDATES
from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Effect, MachineScales, scale_bounds
from hydro_diagnosis.estimation.budget import Budget
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.unknown_parameters import estimated_claims, require_estimable, starting_bench
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.preprocessing.loading import RecordingReader, load_dataset
from hydro_diagnosis.recording import InputError, Segment, ambiguous_paths
from hydro_diagnosis.report.corrected_bench import claims_of
from hydro_diagnosis.wiring import PlausibilityCheck
from hydro_sim.files import learned_bench
from hydro_sim.model.bench import Bench


def recording_entries(paths: Sequence[str | Path]) -> list[dict[str, Any]]:
    """Entry of each recording: `name`, and `begin` [s since 1970] of a bag with /hydro/state, None for other files."""
    in_full, entries = ambiguous_paths(paths), []
    for path in map(Path, paths):
        name, begin = path.stem, None
        if is_bag(path):
            with suppress(RecordingError, StopIteration, IndexError):  # a bag of other topics
                begin = float(next(stream_bag(path, skip_damaged=True))["time"][0])
                name = path.name
        entries.append({"name": str(path) if path in in_full else name, "begin": begin})
    return entries


def baseline(
    bench: Bench | Mapping[str, Any] | str | Path | None,
    model: str | Path | None = None,
    estimated: Collection[str] = (),
) -> tuple[Bench, str]:
    """Baseline bench and its origin, from a bench, a bench file or its content (None: nominal), or a learned bench.

    The origin is `analytic`, or `learned` and the file's name. If the file lacks parameters, the baseline is a
    `PartialBench`; `estimated`: parameters to be estimated.

    Raises InputError if a file cannot be read, or if both are given.
    """
    if model is not None and bench is not None:
        raise InputError("give a bench file or a learned bench as baseline, not both")
    try:
        if model is not None:
            return learned_bench.read(model), f"learned {Path(model).name}"
        if bench is None or isinstance(bench, Bench):
            return bench or Bench.nominal(), "analytic"
        if isinstance(bench, Mapping):
            return parse_bench(bench, frozenset(estimated)), "analytic"
        return read_bench(bench, frozenset(estimated)), "analytic"
    except ValueError as error:
        raise InputError(str(error)) from None


ProgressCallback = Callable[[str], None]
BLOCK_EQUATIONS = {
    PRESSURE: ("pressure_a", "pressure_b", "actuation"), MOTION: ("motion",), LOAD: ("load",), HYDRAULIC: ("sensor",),
}  # fmt: skip
"""Equations that each block of residuals checks; `sensor`: the hydraulic force against the pressures."""


@dataclass(frozen=True, kw_only=True)
class DiagnosisInput:
    """Input of a diagnosis: recordings, baseline, and options."""

    recordings: Sequence[str | Path]
    holdout: Sequence[str | Path]
    bench: Bench | Mapping[str, Any] | str | Path | None
    model: str | Path | None
    columns: ColumnMap | Mapping[str, Any] | str | Path | None
    without: Sequence[str]
    estimate: Sequence[str]
    as_wired: bool
    budget: Budget = field(default_factory=Budget)
    reader: RecordingReader = field(default_factory=RecordingReader)
    """Reader that all wiring hypotheses share: none reads a file again that fits into its memory."""

    def prepare(self, progress: ProgressCallback, inspection: PlausibilityCheck | None = None) -> PreparedDiagnosis:
        """Read the recordings, check them against the bench file, initialise the parameters to be estimated.

        `inspection`: as of `load_dataset`.

        Raises InputError if no recording can be diagnosed, or the bench file lacks parameters that they require.
        """
        estimate = tuple(dict.fromkeys(self.estimate))
        require_estimable(estimate)
        given, origin = baseline(self.bench, self.model, estimate)
        candidates = _candidates(self.without)
        progress(stage_bar.READING)
        inspection = PlausibilityCheck() if inspection is None else inspection
        fitted, held_out, quality = load_dataset(
            self.recordings, self.holdout, mark_unknown(given, estimate), ColumnMap.load(self.columns),
            inspection, self.reader,
        )  # fmt: skip
        fitted, held_out = (
            [one for one in some if one.measured is None or len(SegmentModel(one, given).evaluated_time())]
            for some in (fitted, held_out)
        )
        if not fitted or not held_out:
            raise InputError("too many rows are missing: no stretch without a gap is long enough to be evaluated")
        channels = set.intersection(*(set(segment.channels) for segment in fitted))
        require_parameters(channels, given, estimate)
        if isinstance(given, PartialBench):
            given = replace(given, recorded=recorded_size(given, fitted))
        starting, baseline_claims = given, claims_of(given)
        if estimate:
            progress("estimating " + ", ".join(estimate))
            with threadpool_limits(1, "blas"):
                starting = starting_bench(fitted, given, baseline_claims, estimate)
        others = (effect for effect in CANDIDATES if effect not in candidates and effect.named)
        ruled_out = [effect.adapted(starting) for effect in others if applies(effect, starting)]
        self.budget.allow(sum(len(segment) for segment in fitted))
        problem = Problem(
            fitted, starting, baseline_claims,
            estimated=estimated_claims(starting, estimate), ruled_out=ruled_out, budget=self.budget,
        )  # fmt: skip
        if not np.isfinite(problem.residual(())).all():
            raise InputError(
                "the recordings and the bench file give residuals that are not finite: check units and numbers"
            )
        candidates = [effect.adapted(starting) for effect in candidates if applies(effect, starting)]
        candidates = [one for one in candidates if one.sensor_channel in ("", *channels)]
        if machine := _machine_scales(problem):
            candidates = [scale_bounds(effect, machine) for effect in candidates]
        limits = [f"--without {' '.join(self.without)}: these causes were not tried"] if self.without else []
        limits += [*omission_notes(channels, starting), *quality]
        if rings := problem.aliased_resonance:  # which the load cell hardly shows
            causes = {"bulk_modulus", "dead_volume", "entrained_air", "hoses_that_widen", "moving_mass", "sensor_lag"}
            candidates = [one for one in candidates if one.id not in causes or one.lagged_channel == "load_force"]
            limits.append(
                f"the mass rings on the oil at {rings:.3g} Hz, too fast for these rows, so that no cause of it is "
                f"sought: record at {math.ceil(2.0 * rings)} Hz or more"
            )
        if HYDRAULIC not in problem.blocks:  # without pressures the force cell's errors are not identifiable
            cell = {"load_cell_gain:hydraulic_force", "load_cell_bias:hydraulic_force"}
            candidates = [one for one in candidates if one.label not in cell]
        try:
            version = metadata.version("hydro_diagnosis")
        except metadata.PackageNotFoundError:
            version = "0.1.0"
        report_fields = {
            "checked": [name for block, names in BLOCK_EQUATIONS.items() if block in problem.blocks for name in names],
            "not_checked": [
                name for block, names in BLOCK_EQUATIONS.items() if block not in problem.blocks for name in names
            ],
            "recordings": recording_entries([*self.recordings, *self.holdout]),
            "data_quality": limits,
            "baseline": {"bench": given.to_mapping(), "model": origin},
            "versions": {"hydro_diagnosis": version},
        }
        estimated_parameters = {
            name: None if is_missing(given, name) else float(getattr(given, name)) for name in estimate
        }
        return PreparedDiagnosis(
            inputs=self, problem=problem, candidates=candidates, held_out=held_out, report_fields=report_fields,
            estimated_parameters=estimated_parameters, units=inspection.units,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class PreparedDiagnosis:
    """Input of a diagnosis after reading: estimation problem, candidate effects and held-out segments."""

    inputs: DiagnosisInput
    problem: Problem
    candidates: list[Effect]
    held_out: list[Segment]
    """Held-out segments."""
    report_fields: dict[str, Any]
    """Fields of the report that are known before the search."""
    estimated_parameters: dict[str, float | None]
    """Bench parameters to be estimated, with the bench file's values; None if it holds none."""
    units: Mapping[str, str]
    """Unit of a field's column before conversion to SI, if stated."""
    wiring: str = ""
    """Note on the wiring hypothesis taken, as recorded or repaired, if a mistake is suspected; else empty."""


def _machine_scales(problem: Problem) -> MachineScales | None:
    """Scales of the machine: force, speed and stroke; None without a recorded force or motion."""
    moving = [one for one in problem.models if one.has_position and MOTION in problem.blocks]
    if not moving:
        return None
    return MachineScales(
        force=max(float(np.max(np.abs(one.measured_force(())))) for one in moving),
        speed=max(float(np.percentile(np.abs(one.v), 99.0)) for one in moving),
        stroke=max(float(np.ptp(one.x)) for one in moving),
    )


def _candidates(without: Sequence[str]) -> list[Effect]:
    """Candidates of the search, except those ruled out."""
    names = {name for effect in CANDIDATES for name in (effect.id, effect.label)}
    for name in without:
        if name not in names:
            close = get_close_matches(name, names, 1)
            raise InputError(f"without: {name!r} is not an effect" + (f", did you mean {close[0]!r}?" if close else ""))
    return [effect for effect in CANDIDATES if not {effect.id, effect.label} & set(without)]
