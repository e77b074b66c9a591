# SPDX-License-Identifier: Apache-2.0
"""Trains a policy on whichever plant publishes /hydro/state.

ros2 run hydro_policy trainer --plant emulator --episodes 8 --evaluate
"""

from __future__ import annotations

import argparse
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import rclpy
import torch

from hydro_bridge.console import UserError, command
from hydro_bridge.ros import Companion, CompanionError, refuse_unknown_parameters, ros_arguments, start_ros
from hydro_policy.checkpoint import Checkpoint, load_checkpoint
from hydro_policy.configurations import configuration
from hydro_policy.controllers import Controller, FixedGains, PolicyController
from hydro_policy.episode import Phase
from hydro_policy.nodes.companions import CompanionWatch, guard_range, start_companions
from hydro_policy.nodes.evaluate import evaluate_on, show_results
from hydro_policy.nodes.graph import GraphNode
from hydro_policy.nodes.options import add_plant_options, declare_settings, plant_options, rearms
from hydro_policy.nodes.progress import TrainingProgress
from hydro_policy.override import GainOverride
from hydro_policy.policy import Policy
from hydro_policy.record import RunRecord
from hydro_policy.run import RunDirectory, TrainingSettings, new_run
from hydro_policy.snapshot import actor_parameters
from hydro_policy.start import AGENT, Start, load_start, shipped_start
from hydro_policy.supervisor import LearnerError, LearnerSupervisor
from hydro_policy.training import TrainingSession

DEMO = {
    "plant": "emulator",
    "configuration": "wide",
    "episodes": 6,
    "exam_every": 2,
    "evaluate": True,
    "filter": "--metric constant",  # docs/results.md says what the learned one does to the wide agent on a busy machine
}
"""The main job: a short training on the emulator over the serial link, recorded and evaluated, within 6 minutes."""

SCRATCH = "scratch"
UPDATES_PER_STEP = {"scratch": 8.0, "agent": 1.0}
"""Bench time is dear: more than the paper's 1 from scratch. An agent that is good already unlearns by that."""

EPILOG = """\
examples:
  ros2 run hydro_policy trainer --demo                         a short training on the emulator, evaluated: 5 minutes
  ros2 run hydro_policy trainer --plant emulator --evaluate    the paper's 160 episodes: 49 minutes of bench time
  ros2 run hydro_policy trainer --plant bench --port /dev/ttyUSB0
  ros2 run hydro_policy trainer --resume runs/NAME             goes on after Ctrl-C, an error or a power cut
every setting is a ROS parameter, too: --ros-args -p sac.discount:=0.98 -p task.steps_per_episode:=900
(docs/training.md explains them). Ctrl-C disarms, writes a checkpoint and ends.
"""


@dataclass(frozen=True)
class Prepared:
    """What a run starts from."""

    run: RunDirectory
    settings: TrainingSettings
    checkpoint: Checkpoint | None
    start: Start | None

    @property
    def best(self) -> bytes | None:
        """The best agent of the run that is continued, if it had one."""
        path = self.run.best / AGENT
        return path.read_bytes() if self.checkpoint is not None and path.is_file() else None


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="trainer", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    result.add_argument("--demo", action="store_true", help="the main job: see the examples")
    add_plant_options(result)
    run = result.add_argument_group("run")
    run.add_argument(
        "--from",
        "--start",
        dest="start",
        type=Path,
        metavar="RUN",
        help=f"an agent to start from: a run's folder, or {SCRATCH} (default: the one pretrained in simulation)",
    )
    run.add_argument("--episodes", type=int, metavar="N", help="episodes of 18 s in all (default 160, the paper's)")
    run.add_argument(
        "--updates-per-step",
        type=float,
        metavar="N",
        help="gradient updates per policy step (default 1 from an agent, 8 from scratch)",
    )
    run.add_argument(
        "--configuration",
        choices=("paper", "wide"),
        help="paper: Table training_agent, K_p up to 90; wide: K_p up to 300 (default paper)",
    )
    run.add_argument("--exam-every", type=int, metavar="N", help="episodes between examinations, 0: none (default 4)")
    run.add_argument("--seed", type=int, metavar="N", help="of networks, exploration and references (default 0)")
    run.add_argument("--evaluate", action="store_true", help="afterwards compare the policy with fixed gains")
    files = result.add_argument_group("files")
    files.add_argument(
        "--runs", type=Path, default=Path("runs"), metavar="DIR", help="folder of all runs (default: runs)"
    )
    files.add_argument("--name", help="of the run's folder (default: date and time)")
    files.add_argument("--resume", type=Path, metavar="RUN", help="continue the run in this folder")
    files.add_argument("--no-record", dest="record", action="store_false", help="make no recording")
    return result


@command(ValueError, FileExistsError, CompanionError, LearnerError)
def main() -> int:
    """Entry point."""
    own, ros = ros_arguments()
    options = parser().parse_args(own)
    if options.demo:
        for name, value in DEMO.items():
            if getattr(options, name) in (None, False, "", "external"):
                setattr(options, name, value)
    options.configuration = options.configuration or "paper"
    torch.set_num_threads(1)
    start_ros(ros)
    try:
        return train(options)
    finally:
        rclpy.try_shutdown()


def train(options: argparse.Namespace) -> int:
    """Prepare, train, evaluate; whatever happens: disarm, checkpoint, end the companions, in this order."""
    began = time.monotonic()
    with ExitStack() as stack:
        node = GraphNode("trainer")
        stack.callback(node.destroy_node)
        prepared = prepare(options, node)
        run, settings = prepared.run, prepared.settings
        log = stack.enter_context(run.log.open("a", buffering=1, encoding="utf-8"))
        node.log = log
        node.say(f"run {run.path}, episodes {settings.episodes}, plant {options.plant}")
        record = begin_record(node, prepared, options)
        learner = LearnerSupervisor(
            settings, run, prepared.checkpoint, prepared.start.agent if prepared.start else None
        )
        recording, companions = _start_plant(stack, options, prepared, log)
        node.companions = CompanionWatch(companions)
        state = prepared.checkpoint.trainer if prepared.checkpoint else None
        session = TrainingSession(
            settings,
            learner,
            node,
            rearm=rearms(options),
            state=state,
            best=prepared.best,
            override=node.override,
            record=record,
        )
        node.listen_to_corrections()
        stack.callback(lambda: learner.stop(session.state()))
        stack.callback(node.disarm)
        finished, results = drive(options, node, session, learner, prepared.start)
        record.add("end", session.gave_up, **timing(node, session), complete=finished)
        if results is not None:
            show_results(results, run.evaluation, run.tracking_plot, {"run": str(run.path), "plant": options.plant})
    tell_files(run, recording, finished, options, time.monotonic() - began)
    if session.gave_up:
        print(f"Training was given up: {session.gave_up}; {run.record} has what happened.", file=sys.stderr)
        return 1
    return 0 if finished else 130


def begin_record(node: GraphNode, prepared: Prepared, options: argparse.Namespace) -> RunRecord:
    """run.json, with the run's beginning in it; overrides go there, too."""
    record = RunRecord(prepared.run.record)

    def tell(sentence: str) -> None:
        node.say(sentence, warning=True)
        record.add("override", sentence)

    node.override = GainOverride(guard_range(prepared.settings.task.gains), tell)
    source = str(prepared.start.source) if prepared.start else None
    record.add("start", plant=options.plant, start=source, resumed=prepared.checkpoint is not None)
    return record


def timing(node: GraphNode, session: TrainingSession) -> dict[str, float]:
    """Percentiles [s] that docs/training.md promises something about."""
    measured = {"jitter": node.jitter, "inference": session.explorer.inference, "response": node.response}
    return {f"{name}_p99": latency.percentile(99) for name, latency in measured.items()}


def drive(
    options: argparse.Namespace,
    node: GraphNode,
    session: TrainingSession,
    learner: LearnerSupervisor,
    start: Start | None,
) -> tuple[bool, Any]:
    """Train, then evaluate if asked for: (whether all came to its end, the evaluation or None)."""
    if not rearms(options):
        node.listen_for_enter()
    bar = TrainingProgress(node, session, learner)
    try:
        finished = session.progress.episode >= session.settings.episodes or node.drive(session, bar.tick)
    finally:
        bar.close()
    inference = session.explorer.inference.sentence()
    node.say(f"gains at 100 Hz: jitter {node.jitter.sentence()}; of which inference {inference}")
    if not finished or session.gave_up or not options.evaluate:
        return finished and not session.gave_up, None
    while not learner.ready and learner.alive:  # a finished run that was resumed: nobody has waited for it yet
        time.sleep(0.05)
    session.keeper.start()
    bar.phase = lambda: Phase.EVALUATING
    results = evaluate_on(node, compared(session, start), rearm=rearms(options))
    node.disarm()  # now, not after the plots
    bar.phase = lambda: Phase.FINISHED
    bar.publish()
    return results.finished, results


def compared(session: TrainingSession, start: Start | None) -> list[Controller]:
    """The paper's three controllers: I trained here, II as it came, III fixed; without II the base gains."""
    gains = session.settings.task.gains
    best = session.keeper.best
    if best is not None:
        session.policy.load_flat(best)
    controllers: list[Controller] = [PolicyController(session.policy, gains, "I: policy, trained here")]
    if start is not None:
        before = Policy(start.sac.hidden_size)
        before.load_flat(actor_parameters(start.agent))
        controllers.append(PolicyController(before, gains, "II: policy it started from"))
    controllers.append(FixedGains(90.0, 15.0))
    return controllers if start is not None else [*controllers, FixedGains(15.0, 5.0)]


def prepare(options: argparse.Namespace, node: GraphNode) -> Prepared:
    """A new run with its folder, or one to continue."""
    start = None
    if options.resume is not None:
        run = RunDirectory(options.resume)
        settings, checkpoint = run.load_settings(), load_checkpoint(run.latest)
    else:
        run, checkpoint = new_run(options.runs, options.name), None
        start = find_start(options)
        updates = UPDATES_PER_STEP["agent" if start else "scratch"]
        settings = replace(configuration(options.configuration), updates_per_step=updates)
        settings = start.adopted(settings) if start else settings
    given = {name: getattr(options, name) for name in ("episodes", "updates_per_step", "seed")}
    settings = replace(settings, **{name: value for name, value in given.items() if value is not None})
    if options.seed is not None:
        settings = replace(settings, sac=replace(settings.sac, seed=options.seed))
    if options.exam_every is not None:
        settings = replace(settings, exam=replace(settings.exam, every=options.exam_every))
    settings = declare_settings(node, settings)
    refuse_unknown_parameters(node)
    if options.resume is None:
        try:
            run.create()
        except (NotADirectoryError, PermissionError) as error:
            raise UserError(f"{run.path} cannot be made: {error.strerror}") from None
    run.save_settings(settings)
    return Prepared(run, settings, checkpoint, start)


def find_start(options: argparse.Namespace) -> Start | None:
    """The agent named by --from; without it the one that is shipped for this authority, if there is one."""
    if options.start is not None:
        return None if str(options.start) == SCRATCH else load_start(options.start)
    return shipped_start(options.configuration)


def _start_plant(
    stack: ExitStack, options: argparse.Namespace, prepared: Prepared, log: IO[str]
) -> tuple[Path | None, list[Companion]]:
    """Start the companions; returns where the recording goes, and them."""
    run = prepared.run
    recording = _free(run.bag) if options.record and options.plant != "external" else None
    metadata = (f"run={run.path.name}", f"seed={prepared.settings.seed}")
    kept = {"metadata": metadata, "attachments": (run.config,), "policies": (run.policy,)}
    plant = plant_options(options, recording=recording, seed=prepared.settings.seed, **kept)
    return recording, start_companions(stack, plant, prepared.settings.task.gains, run.path, log)


def _free(folder: Path) -> Path:
    """`folder`, or the first of folder-2, folder-3 ... that is not there: a resumed run has a recording of its own."""
    candidates = (folder.with_name(f"{folder.name}-{n}") for n in range(2, 10_000))
    return folder if not folder.exists() else next(path for path in candidates if not path.exists())


def tell_files(
    run: RunDirectory, recording: Path | None, finished: bool, options: argparse.Namespace, seconds: float
) -> None:
    """Say where each file is and what to run next."""
    listed = [
        ("policy", run.policy),
        ("checkpoint", run.latest),
        ("best agent", run.best / AGENT),
        ("what happened", run.record),
        ("recording", recording),
        ("evaluation", run.evaluation),
        ("tracking plot", run.tracking_plot),
        ("log", run.log),
    ]
    print(f"\n{'Done' if finished else 'Ended early'} after {seconds:.0f} s. Files:")
    for name, path in listed:
        if path is not None and path.exists():
            print(f"  {name:22s} {path}")
    plant = f"--plant {options.plant}" + (f" --port {options.port}" if options.port else "")
    print("Next:")
    if not finished and run.latest.exists():
        print(f"  go on            ros2 run hydro_policy trainer {plant} --resume {run.path}")
    print(f"  full training    ros2 run hydro_policy trainer {plant} --resume {run.path} --episodes 160 --evaluate")
    print(f"  compare again    ros2 run hydro_policy evaluate {plant} --policy {run.path} --fixed 90 15 --fixed 15 5")
