# SPDX-License-Identifier: Apache-2.0
"""Factory of filters: a metric of `learn_metric` on a bench file, and the command line that chooses them.

Guarantees and limits: filter.md.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

from hydro_bridge.arguments import parse_arguments
from hydro_bridge.safety.box_info import BoxDescription
from hydro_core.files import site
from hydro_core.settings import add_options
from hydro_filter.controller.loop_filter import LoopFilter, LoopFilterSettings, loop_filter
from hydro_filter.metric import ScheduledMetric, shipped_metric
from hydro_sim.files import learned_bench
from hydro_sim.files.pairing import BoxIdentity, mismatch, raise_if_mismatched
from hydro_sim.model.bench import Bench

SHIPPED_METRIC = "learned"
"""Name of the shipped metric."""


@dataclass(frozen=True, kw_only=True)
class FilterChoice:
    """Selection of a filter: its metric, model and bench files."""

    bench: Bench
    """Bench assumed by the box."""
    bench_file: Path | None = None
    """Path of the bench's file; None: the bench.yaml of hydro_sim."""
    metric: str = SHIPPED_METRIC
    """`learned` (the shipped one), or a file."""
    model: Path | None = None
    """Bench file of the model; None: the shipped one."""

    @classmethod
    def from_files(
        cls, *, metric: str | Path | None = None, model: str | Path | None = None, bench: str | Path | None = None
    ) -> FilterChoice:
        """Create the choice of these files; None: the shipped ones, and the bench.yaml of hydro_sim."""
        file = Path(bench) if bench else None
        assumed = Bench.load(file) if file else Bench.nominal()
        return cls(
            bench=assumed, bench_file=file, metric=str(metric or SHIPPED_METRIC), model=Path(model) if model else None
        )

    @property
    def files(self) -> dict[str, Path]:
        """Paths of the metric's and the model's file, by these names."""
        metric = shipped_metric() if self.metric == SHIPPED_METRIC else Path(self.metric)
        return {"metric": metric, "model": self.model or learned_bench.shipped_bench()}

    @property
    def modification_times(self) -> tuple[int, ...]:
        """Modification times [ns] of metric, model and bench file; 0 for a missing file."""
        files = [*self.files.values(), *([self.bench_file] if self.bench_file else [])]
        return tuple(path.stat().st_mtime_ns if path.is_file() else 0 for path in files)

    def describe(self) -> dict[str, str]:
        """Return the files with digests and the certified gains as text by name, for logs and /diagnostics."""
        digests = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in self.files.items()}
        told = {name: f"{path.name}, sha256 {digests[name][:12]}" for name, path in self.files.items()}
        ranges = ((one.velocity_compensation, one.gains) for one in self.stored_metric.all_metrics)
        certified = (f"K_p {gains[0]:g} to {gains[-1]:g} 1/s at C_1 = {c_1:g}" for c_1, gains in ranges)
        return {**told, "certified": ", ".join(certified)}

    def pairing_error(self, box: BoxIdentity | None = None) -> str:
        """Return an error message if metric, model and bench do not belong together; empty if they do.

        `box`: bench assumed by the box; None: this filter's own bench. Raises WeightsError: a file is missing or
        unreadable.
        """
        box = box or BoxIdentity(digest=self.bench.digest, source=self.source)
        learn = "make one of its recordings with `ros2 run hydro_diagnosis diagnose`, or take its bench.yaml (--model)"
        learn_metric = "make one with `ros2 run hydro_filter learn_metric` and its --bench and --model"
        stored, name = self.stored_metric, self.files["metric"].name
        return (
            learned_bench.box_mismatch(self.files["model"], box, learn)
            or mismatch(f"the metric {name}", stored.provenance, box, learn_metric, model=self._model_digest)
            or stored.validity_error(name)
        )

    @cached_property
    def _model_digest(self) -> str:
        return learned_bench.digest(self.files["model"])

    @cached_property
    def stored_metric(self) -> ScheduledMetric:
        """The metric's file, read at first access."""
        return ScheduledMetric.load(self.files["metric"])

    def box_mismatch(self, box: BoxDescription) -> str:
        """Return an error message if the filter is not for this running box; empty if it is, or if that is unknown."""
        theirs = BoxIdentity.of_box(box)
        if theirs.digest and theirs.digest != self.bench.digest:
            mine = f"the filter was started for bench {self.bench.digest} ({self.source})"
            return f"{mine}, the box believes {theirs.description}: start it with the bench.yaml of this box (--bench)"
        return self.pairing_error(theirs)

    @property
    def source(self) -> str:
        """Location of the bench file, as text."""
        return str(self.bench_file or "bench.yaml of hydro_sim")

    def make(self, settings: LoopFilterSettings) -> LoopFilter:
        """Create the filter.

        Raises WeightsError: a file is missing, unreadable, or of a model that has no certificate; ValueError: as
        `filter_record`.
        """
        metric = self.stored_metric
        return loop_filter(metric, learned_bench.load_model(self.files["model"]), self.bench, settings)


def parse_args(
    own: Sequence[str], ros: Sequence[str] = ()
) -> tuple[FilterChoice, LoopFilterSettings, argparse.Namespace]:
    """Parse the command line into the filter choice, its settings, and all options.

    `ros`: arguments from `--ros-args` on; options have the names and meanings of the ROS parameters. Raises
    PairingError: metric, model and bench do not belong together.
    """
    parser = argparse.ArgumentParser(
        prog="filter", description="Contraction filter: /hydro/state to /hydro/correction."
    )
    parser.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml; default: the nominal bench")
    parser.add_argument(
        "--metric", metavar="FILE", help=f"of `learn_metric`; default: {SHIPPED_METRIC}, the shipped one"
    )
    parser.add_argument(
        "--model", type=Path, metavar="FILE", help="bench file that the metric was made for; default: the shipped one"
    )
    site.add_site_option(parser, "--bench, --metric and --model")
    names = [field.name for field in fields(LoopFilterSettings)]
    add_options(parser, LoopFilterSettings(), names)
    parser.add_argument("--realtime", action="store_true", help="run by SCHED_FIFO, if permitted")
    asked = parse_arguments(parser, "filter", own, ros)
    site.apply_site_option(asked, bench=site.BENCH_FILE, metric=site.METRIC_FILE, model=site.MODEL_FILE)
    choice = FilterChoice.from_files(metric=asked.metric, model=asked.model, bench=asked.bench)
    raise_if_mismatched(choice.pairing_error())
    return choice, LoopFilterSettings(**{name: getattr(asked, name) for name in names}), asked
