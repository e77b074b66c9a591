# SPDX-License-Identifier: Apache-2.0
"""Training run on a live plant: prepare (folder, settings, agent, companions), train, evaluate, write the results."""

from __future__ import annotations

import argparse
import sys
import time
from contextlib import closing
from dataclasses import replace
from datetime import datetime
from functools import partial

from hydro_bridge.ros.node import declare_options, leave_graph, refuse_unknown_parameters
from hydro_bridge.safety.readiness import Readiness
from hydro_core.bench_scales import rescale
from hydro_core.cli.console import UserError, writable_folder
from hydro_policy.evaluation.controllers import Controller, FixedGains, PolicyController
from hydro_policy.evaluation.gain_search import coarse_grid
from hydro_policy.evaluation.runner import Phase, TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.learner_process.learner import write_run
from hydro_policy.learner_process.supervisor import LearnerSupervisor
from hydro_policy.nodes.evaluation import compare_on, conditions, remove_rejected, report_results
from hydro_policy.nodes.graph_node import CleanupStack, GraphNode
from hydro_policy.nodes.parameters import declare_settings, keep_overridden
from hydro_policy.nodes.plant_options import (
    NO_FILTER_WORDS,
    SCRATCH,
    box_mismatch,
    expected_box,
    load_cell,
    may_rearm,
    plant_options,
    plant_options_as_yaml,
    require_matching_agent,
)
from hydro_policy.nodes.plants import describe_policy, guard_range, requested_filter, start_plant
from hydro_policy.nodes.progress import TrainingProgress
from hydro_policy.pretraining.configurations import configuration
from hydro_policy.runs import report as curves
from hydro_policy.runs.digest import platform_description, run_digest
from hydro_policy.runs.initial_agent import AGENT_FILE, InitialAgent, load_initial_agent, shipped_agent
from hydro_policy.runs.run_directory import Checkpoint, RunDirectory, RunRecord, TrainingSettings, load_checkpoint
from hydro_policy.sac.agent import Agent, ReplayBuffer, actor_parameters
from hydro_policy.sac.policy import Policy
from hydro_policy.supervision import plant_supervisor
from hydro_policy.supervision.override import GainOverride
from hydro_policy.task.cases import EvaluationSettings
from hydro_policy.task.mdp import ACTION_SIZE, BASE_GAINS, OBSERVATION_SIZE
from hydro_policy.training_plan import TrainingPlan, training
from hydro_sim.files.pairing import BoxIdentity, Provenance, mismatch, raise_if_mismatched
from hydro_sim.model.bench import NOMINAL


def prepare(
    options: argparse.Namespace, node: GraphNode
) -> tuple[RunDirectory, TrainingSettings, Checkpoint | None, InitialAgent | None, bool]:
    """Prepare a new or resumed run; returns directory, settings, checkpoint, initial agent, whether its folder is new.

    Invalid input is refused before anything is created. With an external plant the box is awaited, since the gain
    changes for the configuration's range of total gains follow from its base gains.
    """
    start, checkpoint, box = None, None, expected_box(options)
    if options.plant != "external":
        if (words := plant_options(options).filter) == NO_FILTER_WORDS:
            raise UserError("--filter none is for the compensated law alone: a policy trains behind the filter")
        requested_filter(words, options.bench)
    node.box_fault = partial(box_mismatch, box)
    load_cell(options)
    new = options.resume is None
    run = RunDirectory(options.runs / (options.name or f"{datetime.now():%Y%m%d-%H%M%S}") if new else options.resume)
    writable_folder(run.path)
    if new:
        run.refuse_existing()
        if options.start is None:
            start = shipped_agent(options.configuration)
        elif str(options.start) != SCRATCH:
            start = load_initial_agent(options.start)
        require_matching_agent(start, box)
        updates = 1.0 if start else 8.0  # from scratch more than the paper's 1: bench time is costly
        settings = configuration(options.configuration, base=box.base_gains or BASE_GAINS, size=box.size or NOMINAL)
        settings = replace(settings, updates_per_step=updates)
        settings = start.adapt_settings(settings) if start else settings
    else:
        settings, checkpoint = run.load_settings(), load_checkpoint(run.latest)
    given = {name: getattr(options, name) for name in ("episodes", "updates_per_step", "seed")}
    settings = replace(settings, **{name: value for name, value in given.items() if value is not None})
    if options.seed is not None:
        settings = replace(settings, sac=replace(settings.sac, seed=options.seed))
    if options.exam_every is not None:
        settings = replace(settings, exam=replace(settings.exam, every=options.exam_every))
    settings = declare_settings(node, settings)
    declare_options(node, options)
    refuse_unknown_parameters(node)
    if options.plant == "external":
        if not node.wait_for_plant() or node.box is None:
            raise KeyboardInterrupt
        box = BoxIdentity.of_box(node.box)
        node.box_fault = partial(box_mismatch, box)
        require_matching_agent(start, box)
        if new:
            size = settings.task.size
            settings = keep_overridden(node, settings, rescale(settings, size, box.size or size))
        if new and start is None:
            base, gains = box.base_gains or BASE_GAINS, settings.task.gains
            shifted = gains.shifted(BASE_GAINS[0] - base[0], BASE_GAINS[1] - base[1])
            shifted = keep_overridden(node, gains, shifted, "task.gains.")
            settings = replace(settings, task=replace(settings.task, gains=shifted))
    if settings.made is not None and not new:
        remedy = "go on with it on its own box, or begin one here"
        raise_if_mismatched(mismatch(f"the run {run.path.name}", settings.made, box, remedy))
    kp, ki = box.base_gains or (None, None)
    settings = replace(settings, made=Provenance(box=box.digest, base_kp=kp, base_ki=ki, integral=box.integral))
    made = not run.path.exists()
    if new:
        run.create()
        write_initial_checkpoint(run, settings, start)
    run.save_settings(
        settings, plant_options_as_yaml(options)
    )  # last: a folder without it is not a run, and its name is free
    return run, settings, checkpoint, start, made


def write_initial_checkpoint(run: RunDirectory, settings: TrainingSettings, start: InitialAgent | None) -> None:
    """Write the first checkpoint: the initial agent, and an empty replay buffer."""
    agent = start.agent if start else Agent(OBSERVATION_SIZE, ACTION_SIZE, settings.sac).dump()
    nothing = ReplayBuffer(OBSERVATION_SIZE, ACTION_SIZE, settings.sac.batch_size + 128)
    write_run(run, settings, agent, nothing, {})


def paper_controllers(plan: TrainingPlan, start: InitialAgent | None) -> list[Controller]:
    """Return the paper's controllers: I trained on the bench, II pretrained, III fixed; without II the base gains.

    I is the best policy of the run, or the last one if none was better than the initial one.
    """
    gains, best = plan.settings.task.gains, plan.best
    name = "I: last policy, trained here"
    if best is not None and plan.improved:
        plan.policy.load_flat(best)
        name = "I: policy, trained here"
    controllers: list[Controller] = [PolicyController(plan.policy, gains, name)]
    if start is not None:
        before = Policy(start.sac, plan.settings.task.size)
        before.load_flat(actor_parameters(start.agent))
        controllers.append(PolicyController(before, gains, "II: policy it started from"))
    base = plan.settings.base_gains
    controllers.append(FixedGains(90.0, 15.0, base))
    return controllers if start is not None else [*controllers, FixedGains(15.0, 5.0, base)]


def train(options: argparse.Namespace) -> int:
    """Run a training: prepare, train, evaluate; at any end disarm, write a checkpoint, stop companions, in order."""
    began = time.monotonic()
    with CleanupStack() as stack:
        node = GraphNode("trainer")
        stack.callback(leave_graph, node)
        run, settings, checkpoint, start, made = prepare(options, node)
        stack.enter_context(remove_rejected(run, node, made=made))
        node.announcer.log = stack.enter_context(run.log.open("a", buffering=1, encoding="utf-8"))
        node.report(f"run {run.path}, episodes {settings.episodes}, plant {options.plant}")
        gains, (kp, ki) = settings.task.gains, settings.base_gains
        ends = kp + gains.delta_kp_max, ki + gains.delta_ki_max
        node.report("the policy chooses K_p up to {:g} and K_i up to {:g}".format(*ends))
        if run.policy.is_file():
            node.report(("the best so far: " if checkpoint else "") + describe_policy(run.policy))
        record = RunRecord(run.record)

        def tell(sentence: str) -> None:
            node.report(sentence, warning=True)
            record.add("override", sentence)

        node.override = GainOverride(guard_range(settings.task.gains), tell, settings.base_gains)
        record.add("start", plant=options.plant, start=str(start.source) if start else None, resumed=bool(checkpoint))
        recording = run.next_recording if options.record and options.plant != "external" else None
        plant = plant_options(
            options, recording=recording, seed=settings.seed, controller="trainer",
            metadata=(f"run={run.path.name}", f"seed={settings.seed}"), attachments=(run.config,),
            policies=(run.policy,),
        )  # fmt: skip
        real_time = options.plant == "external" or plant.real_time
        learner = LearnerSupervisor(settings, run, checkpoint.produced if checkpoint else 0, real_time=real_time)
        if uncovered := start_plant(
            stack, node, plant, settings.task.gains, run.path, run.path, page=options.dashboard
        ):
            record.add("uncovered", uncovered)
        state = (checkpoint.trainer or None) if checkpoint else None
        best_file = run.best / AGENT_FILE
        best = actor_parameters(best_file.read_bytes()) if checkpoint and best_file.is_file() else None
        plan = TrainingPlan(settings, learner, node, state=state, best=best, record=record)
        supervisor = node.supervisor(
            plant_supervisor.learner_requirement(lambda: learner.ready), rearm=may_rearm(options)
        )
        session = training(plan, supervisor)
        node.listen_to_corrections()
        node.enable_step_publishing()
        stack.callback(lambda: learner.stop(plan.state()))
        stack.callback(node.disarm)
        finished, results = train_and_evaluate(options, node, session, start)
        timings = {"jitter": node.timing.jitter, "inference": plan.explorer.inference, "response": node.timing.response}
        timing = {f"{name}_p99": latency.percentile(99) for name, latency in timings.items()}
        record.add("end", plan.abort_reason, **timing, complete=finished)
    notes = conditions(options, run=str(run.path), seed=settings.seed)  # once disarmed: it asks git
    found = [] if results is None else report_results(results, run, notes)
    digest = ""
    if finished and node.paced:
        digest = run_digest(run.policy, run.recordings, results.scores if results else (), node.ended)
        record.add("digest", run_digest=digest, circumstances=platform_description())
    record.flush()
    try:
        curves.draw_curve(record, run.learning_curve)
    except OSError as error:
        print(f"no learning curve: {error.strerror or error}", file=sys.stderr)
    found += curves.sections(record, run.learning_curve)
    curves.write_page(run, f"Training {run.path.name}", notes, found)
    more = " --episodes 160 --evaluate" if finished else ""
    print(f"\n{'Done' if finished else 'Ended early'} after {time.monotonic() - began:.0f} s: {run.page}")
    print(f"Next: ros2 run hydro_policy trainer --resume {run.path}{more}")
    if found and options.demo:
        print(f"\n{curves.WHICH_CONTROLLER}")
    if digest:
        print(f"\nThe same seed gives the same digest {platform_description()}:\nrun digest: {digest}")
    if plan.abort_reason:
        print(f"Training was given up: {plan.abort_reason}; {run.record} has what happened.", file=sys.stderr)
        return 1
    return 0 if finished else 130


def train_and_evaluate(
    options: argparse.Namespace, node: GraphNode, session: TrialRunner[TrainingPlan], start: InitialAgent | None
) -> tuple[bool, TrialRunner[Comparison] | None]:
    """Train, then evaluate if requested; returns whether both were completed, and the evaluation's runner or None."""
    plan, rearm, cell = session.plan, may_rearm(options), load_cell(options)
    if not rearm:
        node.listen_for_enter()
    if not node.wait_for_plant():
        return False, None
    with closing(TrainingProgress(node, session)) as bar:
        finished = plan.trained or node.run_session(session, bar.tick)
    inference = plan.explorer.inference.summary()
    node.report(f"gains at 100 Hz: jitter {node.timing.jitter.summary()}; inference took {inference}")
    if plan.progress.exams and not plan.improved:
        node.report(curves.NONE_BETTER_MESSAGE)
    if not finished or plan.abort_reason or not options.evaluate:
        return finished and not plan.abort_reason, None
    readiness = Readiness([plant_supervisor.learner_requirement(lambda: plan.learner.ready)], node.report)
    while not readiness.complete:  # of a finished run that was resumed
        if warning := plan.poll():
            node.warn(warning)
        readiness.check(time.monotonic())
        time.sleep(0.05)
    plan.accept_initial_agent()
    bar.phase = lambda: Phase.EVALUATING
    grid = coarse_grid(plan.settings.task.gains, plan.settings.base_gains) if rearm else None
    if not rearm:
        node.report("best fixed gains and compensated law need further armings: compare them by `evaluate --grid`")
    force = node.size.force
    results = compare_on(
        node, paper_controllers(plan, start), node.supervisor(rearm=rearm, after=session.supervisor), rearm=rearm,
        settings=EvaluationSettings(amplitude=force), grid=grid, cell=cell,
        searched=EvaluationSettings(frequencies=(1.0, 2.0), amplitude=force),
        compensated=rearm, learned=cell is None, record=plan.record,
    )  # fmt: skip
    if results is None:
        return False, None
    node.disarm()  # now, not after the plots
    bar.phase = lambda: Phase.FINISHED
    bar.publish()
    return results.finished, results
