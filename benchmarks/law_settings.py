# SPDX-License-Identifier: Apache-2.0
"""The compensated law as it is beside a variant of it, on drawn benches: which of its settings and terms pay.

    python -m benchmarks.law_settings --draw 8 --seed 5501 --set bandwidth=10
    python -m benchmarks.law_settings --draw 8 --seed 5501 --without b_2 b_3
    python -m benchmarks.law_settings --draw 8 --seed 5501 --commit HEAD~1        the law as it was, from git
    python -m benchmarks.law_settings --draw 8 --seed 5501 --overlap 1            the box knows its valve's overlap
    python -m benchmarks.law_settings --yielding --without c_0 c_1 c_2             benches with loads that yield

The six references of `evaluate`, no filter, both laws on the same benches and noise. A trip counts as the reference's
RMS. Needs 4 s a bench, and half a minute to compile.
"""

from __future__ import annotations

import importlib
import inspect
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._report import interquartile_mean, parser
from benchmarks._truths import drawn_truths, yielding
from benchmarks.controllers import SETTINGS, measure
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.cli.console import Table, command, progress
from hydro_core.settings import SettingsError, from_mapping
from hydro_core.signals import NEUTRAL_COEFFICIENTS
from hydro_policy.compensation.estimator import Compensator, CompensatorSettings
from hydro_policy.envs import vector_runs
from hydro_sim.emulator.truth.config import truth_from_mapping

TERMS = ("a_0", "a_1", "a_2", "a_3", "a_4", "b_0", "b_1", "b_2", "b_3", "c_0", "c_1", "c_2")
PINNED = 1e6
"""Weight in the fit with which a term stays at what it begins with."""
PACKAGE = "hydro_policy.compensation"
MODULES = ("estimator", "kernel")
HERE = Path(__file__).parent
Row = dict[str, Any]
Maker = Callable[[int], Compensator]


def variant(settings: CompensatorSettings, without: list[str]) -> Maker:
    """The law with these settings, some terms of its fit pinned to where they begin."""

    def make(count: int) -> Compensator:
        law = Compensator(count, settings)
        law._constants.weights[[TERMS.index(name) for name in without]] = PINNED
        return law

    return make


def law_of(commit: str, folder: Path) -> Maker:
    """The law of another commit, its two modules written into a package below `folder`.

    Raises SettingsError: git does not know the commit, or its law is none of this version's box.
    """
    package = f"law_of_{commit}"
    (folder / package).mkdir()
    for name in MODULES:
        path = f"{commit}:src/hydro_policy/{PACKAGE.replace('.', '/')}/{name}.py"
        found = subprocess.run(["git", "show", path], check=False, capture_output=True, text=True, cwd=HERE)
        if found.returncode:
            raise SettingsError(f"git shows no {path}: {found.stderr.strip()}")
        (folder / package / f"{name}.py").write_text(found.stdout.replace(PACKAGE, package))
    sys.path.insert(0, str(folder))
    made: Any = importlib.import_module(f"{package}.estimator").Compensator
    signals = len(inspect.signature(made.step).parameters) - 1  # f_r came later
    if made(1).coefficients.shape != (1, len(NEUTRAL_COEFFICIENTS)):
        raise SettingsError(f"the law of {commit} has other coefficients than a box of this version takes")

    class Law(made):  # type: ignore[valid-type]
        law = BoxLaw()  # its limits, which the law of some commits keeps to itself

        def step(self, *given):
            return super().step(*given[:signals])

    return Law


def run(
    makers: dict[str, Maker], count: int, seed: int, *, yields: bool = False, overlap: float = 0.0
) -> dict[str, list[Row]]:
    """Rows of `controllers.measure` by law, one for each bench and reference; `yields`: the benches' loads do.

    `overlap`: share of its valve's overlap that the box of a variant knows.
    """
    drawn = drawn_truths(count, seed)
    truths = [truth_from_mapping(contents) for contents in (yielding(drawn, seed) if yields else drawn).values()]
    rows: dict[str, list[Row]] = {name: [] for name in makers}
    for config in progress(truths, label="benches", unit="bench"):
        for name, make in makers.items():
            gains = vector_runs.fixed_gains(np.zeros(2), (0.0, 0.0))
            known = 0.0 if name == "as it is" else overlap
            rows[name] += measure(config, SETTINGS.cases, gains, make(len(SETTINGS.cases)), overlap=known)
    return rows


def table(rows: dict[str, list[Row]]) -> Table:
    """Interquartile mean (worst) RMSE [N] by reference, and of the ratios to the law as it is, pair by pair."""
    cases = [case.name for case in SETTINGS.cases]
    made = Table(
        {"law": "", **dict.fromkeys(cases, "N"), "mean": "N, of the references", "ratio": "to the law as it is",
         "u' RMS": "A/s", "trips": ""}, title="Force RMSE: interquartile mean (worst)",
    )  # fmt: skip
    today = np.array([row["rmse"] for row in rows["as it is"]])
    for name, own in rows.items():
        rmse = np.array([row["rmse"] for row in own]).reshape(-1, len(cases))
        means = [interquartile_mean(column) for column in rmse.T]
        ratio = rmse.ravel() / today
        made.add(
            law=name, **{c: f"{m:.2f} ({w:.1f})" for c, m, w in zip(cases, means, rmse.max(axis=0), strict=True)},
            mean=f"{np.mean(means):.2f}", ratio=f"{interquartile_mean(ratio):.3f} ({ratio.max():.2f})",
            **{"u' RMS": f"{interquartile_mean([row['current_rate_rms'] for row in own]):.3f}"},
            trips=str(sum(row["tripped"] for row in own)),
        )  # fmt: skip
    return made


def changed(words: list[str]) -> CompensatorSettings:
    """Settings of NAME=VALUE words. Raises SettingsError: unknown, no number, or out of range."""
    known = [field.name for field in fields(CompensatorSettings)]
    pairs = [word.partition("=") for word in words]
    try:
        values = {name: float(value) for name, _, value in pairs}
    except ValueError:
        raise SettingsError(f"--set takes NAME=NUMBER, NAME one of {', '.join(known)}") from None
    return from_mapping(CompensatorSettings, values, "--set")


@command(ValueError, OSError)
def main() -> None:
    """Run both, print, write."""
    options = parser("law_settings", __doc__)
    options.add_argument("--draw", type=int, default=8, metavar="COUNT", help="drawn benches; default: %(default)s")
    options.add_argument("--seed", type=int, default=5501, help="of the draw; default: %(default)s")
    options.add_argument("--set", nargs="+", default=[], metavar="NAME=VALUE", help="settings of the variant")
    options.add_argument("--without", nargs="+", default=[], choices=TERMS, metavar="TERM", help="of a_0 to c_2")
    options.add_argument("--yielding", action="store_true", help="benches whose loads yield, with hysteresis")
    options.add_argument("--overlap", type=float, default=0.0, metavar="SHARE",
                         help="of each valve's overlap, which the variant's box knows")  # fmt: skip
    options.add_argument("--commit", metavar="COMMIT", help="the variant is the law of that commit")
    asked = options.parse_args()
    known = [f"{asked.overlap:g} of the overlap known"] if asked.overlap else []
    told = asked.commit or " ".join([*asked.set, *(f"without {name}" for name in asked.without), *known])
    if not told or (asked.commit and (asked.set or asked.without)):
        raise SettingsError("say what the variant is: --set, --without and --overlap, or --commit")
    with tempfile.TemporaryDirectory() as folder:
        other = law_of(asked.commit, Path(folder)) if asked.commit else variant(changed(asked.set), asked.without)
        found = run(
            {"as it is": Compensator, told: other}, asked.draw, asked.seed, yields=asked.yielding, overlap=asked.overlap
        )
        table(found).show(asked.json)


if __name__ == "__main__":
    main()
