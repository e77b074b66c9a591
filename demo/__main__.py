# SPDX-License-Identifier: Apache-2.0
"""A policy pretrained in a simulation that lacks an effect; what the diagnosis makes of it; the policy retrained.

    make demo                                    the whole story into runs/demo, a few minutes on two cores
    make demo ARGS="--truth my.yaml --seeds 5"   another bench: any truth.yaml of the emulator

Believed is the nominal bench without an amplifier in its load cell. The bench, by default, has one: a low-pass at
25 Hz. What is finished stays: run it again to go on.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from demo import page, stages, trial
from demo.stages import Plan
from demo.trial import Entry, Story
from hydro_core.cli.console import Table, add_json_argument, command, make_parser, progress, writable_folder
from hydro_policy.evaluation.controllers import Controller, FixedGains, policy_controller
from hydro_sim.model.bench import Bench

BEFORE, AFTER = "pretrained", "retrained"
PAPER = (90.0, 15.0)
COLUMNS = {
    "controller": "",
    "chosen in": "simulation that it was trained or tuned in: as believed, or as corrected by the diagnosis",
    "simulated": "N, mean RMSE over the four sines as that simulation foretells it",
    "0.5 Hz": "N, RMSE on the bench; nan: the box tripped",
    "1 Hz": "",
    "1.5 Hz": "",
    "2 Hz": "",
    "mean": "N, on the bench",
}


def parser() -> argparse.ArgumentParser:
    """The command line."""
    options = make_parser("demo", __doc__)
    options.add_argument("--out", type=writable_folder, default="runs/demo", metavar="DIR", help="default runs/demo")
    options.add_argument("--truth", type=Path, default=Path(__file__).parent / "truth.yaml", metavar="FILE",
                         help="the bench, a truth.yaml of the emulator (docs/manual/reference/truth.md)")  # fmt: skip
    options.add_argument("--seeds", type=int, default=Plan.seeds, help="policies trained in either simulation")
    options.add_argument("--episodes", type=int, default=Plan.episodes, help="of each training")
    options.add_argument("--configuration", choices=("wide", "paper"), default=Plan.configuration,
                         help="what policies may do: K_p up to 300, or up to 90")  # fmt: skip
    options.add_argument("--jobs", type=int, default=Plan.jobs, help="trainings side by side")
    add_json_argument(options)
    return options


@command(ValueError)
def main() -> int:
    """Tell the story."""
    chosen = parser().parse_args()
    plan = Plan(
        folder=chosen.out, truth=chosen.truth, seeds=chosen.seeds, episodes=chosen.episodes,
        configuration=chosen.configuration, jobs=chosen.jobs,
    )  # fmt: skip
    story = Story(plan)
    stages.believe(plan)
    _say(f"1  {plan.seeds} policies are pretrained in a simulation of {plan.believed}")
    stages.pretrain(plan, BEFORE, plan.believed)
    _try(story, BEFORE, "believed", plan.believed)
    _mismatch(story)
    _say(f"3  the bench is recorded under careful fixed gains: {len(stages.DRIVES)} runs of 20 s")
    bags = stages.record(plan)
    _say("4  what do the recordings hold that the simulation does not?")
    story.report = stages.diagnose(plan, bags)
    _named(story.report)
    _say(f"5  {plan.seeds} policies are trained in the corrected simulation, {plan.corrected}")
    stages.pretrain(plan, AFTER, plan.corrected)
    _try(story, AFTER, "corrected", plan.corrected)
    _fixed(story)
    _table(story).show(chosen.json or plan.folder / "demo.json")
    page.draw(story, plan.folder / "demo.png")
    print(f"{plan.folder / 'demo.png'}, demo.json, diagnosis/report.html")
    return 0


def _try(story: Story, name: str, chosen: str, file: Path) -> None:
    """Policies where they were trained, and on the bench."""
    for seed, run in enumerate(progress(story.plan.policies(name), label="trials")):
        story.entries.append(_entry(story, f"{name}, seed {seed}", chosen, file, policy_controller(run), seed))


def _fixed(story: Story) -> None:
    """The sceptic's rows: gains tuned in either simulation, and the paper's."""
    plan = story.plan
    believed = Bench.load(plan.believed)
    for chosen, file in (("believed", plan.believed), ("corrected", plan.corrected)):
        kp = trial.best_fixed(Bench.load(file), believed)
        controller = FixedGains(kp, trial.INTEGRAL)
        story.entries.append(_entry(story, f"best {controller.name}", chosen, file, controller, 0))
    controller = FixedGains(*PAPER)
    story.entries.append(_entry(story, f"paper's {controller.name}", "-", plan.corrected, controller, 0))


def _entry(story: Story, name: str, chosen: str, file: Path, controller: Controller, seed: int) -> Entry:
    believed = Bench.load(story.plan.believed)
    simulated = trial.in_simulation(controller, Bench.load(file), believed, seed)
    met = trial.on_bench(controller, story.plan.truth, believed, seed)
    return Entry(name=name, chosen=chosen, simulated=simulated, bench=met)


def _mismatch(story: Story) -> None:
    tried = story.tried(BEFORE)
    foretold = np.mean([entry.simulated.mean for entry in tried])
    trips, runs = sum(entry.bench.trips for entry in tried), len(tried) * len(trial.SETTINGS.cases)
    met = [entry.bench.mean for entry in tried if not entry.bench.trips]
    tracked = f"; where it does not, {np.mean(met):.2f} N" if met else ""
    _say(f"2  the simulation foretells {foretold:.2f} N; on the bench the box trips in {trips} of {runs} runs{tracked}")


def _named(report: dict[str, Any]) -> None:
    print(f"   verdict: {report['verdict']} ({report['seconds']:.0f} s)")
    for effect in report["effects"]:
        print(f"   {effect['id']}: {effect['sentence']}", flush=True)


def _table(story: Story) -> Table:
    table = Table(COLUMNS, title="Force RMSE [N] on sines of 300 N")
    for entry in story.entries:
        cells = {name: round(value, 2) for name, value in entry.bench.rmse.items()}
        means = {"simulated": round(entry.simulated.mean, 2), "mean": round(entry.bench.mean, 2)}
        table.add(**{"controller": entry.name, "chosen in": entry.chosen, **means, **cells})
    return table


def _say(sentence: str) -> None:
    print(sentence, flush=True)


if __name__ == "__main__":
    sys.exit(main())
