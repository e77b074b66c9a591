# SPDX-License-Identifier: Apache-2.0
"""Simulation set-up by names and files: bench, box and filter of a pretraining or a Gymnasium environment."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from hydro_filter.controller.factory import FilterChoice
from hydro_policy.envs import FilterName
from hydro_sim.box.box import BoxConfig, Integral, with_base_gains
from hydro_sim.files import learned_bench
from hydro_sim.files.pairing import BoxIdentity, Provenance
from hydro_sim.model.bench import Bench


@dataclass(frozen=True, kw_only=True)
class SimulationSetup:
    """Simulated bench, box and filter of a pretraining; with config.yaml the complete input of `--resume`."""

    model: str
    """Simulated bench: shipped, analytic (the nominal bench), or a bench file."""
    box: str | None = None
    """bench.yaml assumed by the box; None: the nominal bench."""
    base_gains: list[float] | None = None
    """K_p [1/s], K_i [1/s^2] of the box; None: the paper's."""
    randomise: bool = False
    filter: FilterName = "none"
    benches: int = 8
    integral: Integral = "bumpless"
    """Form of the force law's integral, `BoxConfig.integral`."""

    def simulated(self) -> Bench:
        """Return the simulated bench."""
        if self.model == "analytic":
            return Bench.nominal()
        return learned_bench.read(None if self.model == "shipped" else self.model)

    def box_bench(self) -> Bench:
        """Return the bench assumed by the box's force law."""
        return Bench.load(self.box) if self.box else Bench.nominal()

    def box_config(self) -> BoxConfig:
        """Return the box's settings: base gains, limits, form of the integral."""
        box = BoxConfig() if self.base_gains is None else with_base_gains(*self.base_gains)
        return replace(box.of_bench(self.box_bench()), integral=self.integral)

    def provenance(self) -> Provenance:
        """Return the provenance of trained policies: bench assumed by the box, base gains, integral, learned bench."""
        box, model = self.box_config(), learned_bench.digest() if self.model == "shipped" else ""
        return Provenance(
            box=self.box_bench().digest, model=model, base_kp=box.base_kp,
            base_ki=box.base_ki, integral=box.integral, any_bench=self.randomise,
        )  # fmt: skip

    def pairing_error(self) -> str:
        """Return the reason why bench, box and filter are incompatible, in one sentence; empty if they are not."""
        box = BoxIdentity.of_file(self.box)
        remedy = "name the bench.yaml that its box believed by --box, or simulate a bench file: --model FILE --box FILE"
        wrong = learned_bench.box_mismatch(None, box, remedy) if self.model == "shipped" else ""
        if wrong or self.filter != "learned":
            return wrong
        return FilterChoice(bench=self.box_bench(), bench_file=Path(self.box) if self.box else None).pairing_error()
