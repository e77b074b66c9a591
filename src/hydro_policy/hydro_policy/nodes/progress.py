# SPDX-License-Identifier: Apache-2.0
"""Progress of a session on terminal and topics: progress bar, TrainingStatus at 2 Hz, /diagnostics at 1 Hz."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rclpy.clock import Clock, ClockType
from tqdm import tqdm

from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Level, Status
from hydro_bridge.ros.topics import TRAINING, create_publisher
from hydro_core.cli.console import progress
from hydro_msgs.msg import TrainingStatus
from hydro_policy.evaluation.runner import Phase, TrialRunner
from hydro_policy.nodes.graph_node import GraphNode

if TYPE_CHECKING:  # evaluate does without
    from hydro_policy.training_plan import TrainingPlan

_BAR_FORMAT = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}{postfix}]"
"""Without a rate: waiting and examinations take their time too."""


class TrialProgress:
    """Progress bar of a plan's trials, until `close`.

    `label`: label of the bar. `total`: its full length; 0: the plan's total, if known. `bar_format`: as of tqdm.
    """

    def __init__(self, session: TrialRunner[Any], label: str, total: float = 0.0, bar_format: str = "") -> None:
        self._session, self._label, self._total = session, label, total or session.plan.total
        form = bar_format or (_BAR_FORMAT.replace("{elapsed}", "{elapsed}<{remaining}") if self._total else None)
        self._bar: tqdm[None] = progress(total=self._total or None, label=label, bar_format=form)

    def close(self) -> None:
        """Draw the final state, and close the bar."""
        self.tick()
        self._redraw()
        self._bar.close()

    def tick(self) -> None:
        """Redraw the bar; call every 50 ms."""
        self._redraw()

    def _redraw(self) -> None:
        session, now = self._session, self._session.supervisor.summary
        self._bar.n = round(session.plan.done)
        if (trial := session.plan.trial) is not None:
            self._describe(self._label + ("" if now == "armed" else f" ({now})"), [trial.name])
        self._bar.refresh()

    def _describe(self, label: str, figures: list[str]) -> None:
        override = self._session.override
        shown = [f"OVERRIDDEN {override.description}", *figures] if override.active else figures
        self._bar.set_description_str(label, refresh=False)
        self._bar.set_postfix_str(", ".join(shown), refresh=False)


class TrainingProgress(TrialProgress):
    """Progress bar, TrainingStatus and diagnostics of one training; reports each finished episode and examination."""

    def __init__(self, node: GraphNode, session: TrialRunner[TrainingPlan]) -> None:
        self._node, self._plan, self._learner = node, session.plan, session.plan.learner
        self._steps = self._plan.settings.task.steps_per_episode
        super().__init__(session, "waiting", self._plan.settings.episodes * self._steps, _BAR_FORMAT)
        self.phase: Callable[[], Phase] = lambda: session.phase
        self._ticks, self._told = 0, self._plan.progress.episode
        self._examined = len(self._plan.progress.exams)
        self._message = TrainingStatus()
        self._publisher = create_publisher(node, TRAINING)
        node.create_timer(0.5, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._diagnostics = DiagnosticsPublisher(node, self._status)

    def tick(self) -> None:
        """Redraw at intervals, and print a line for each finished episode and examination."""
        progress = self._plan.progress
        while self._told < progress.episode:
            record = progress.history[self._told]
            self._node.report(
                f"episode {record['episode']:.0f}/{self._plan.settings.episodes}: {record['amplitude']:.0f} N at "
                f"{record['frequency']:.2f} Hz, return {record['return']:.0f}, RMSE {record['force_rmse']:.1f} N (lag "
                f"{1e3 * record['lag']:.1f} ms), alpha {record['entropy_coefficient']:.4f}, "
                f"{record['updates']:.0f} updates"
            )
            self._told += 1
        while self._examined < len(progress.exams):
            self._node.report(_exam_line(progress.exams[self._examined], self._plan))
            self._examined += 1
        self._ticks += 1
        if self._ticks % 4 == 0:  # ticks of 50 ms
            self._redraw()

    def publish(self) -> None:
        """Publish TrainingStatus."""
        current, progress, message = self._plan.explorer.current, self._plan.progress, self._message
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.phase = int(self.phase())
        message.episode, message.step = current.episode, current.steps
        message.episode_return, message.force_rmse = progress.last_return, progress.last_rmse
        message.entropy_coefficient = self._learner.status.alpha
        losses = self._learner.status.losses
        message.critic_loss, message.actor_loss, message.temperature_loss = losses
        message.updates = self._learner.status.updates
        message.learner_alive = self._learner.alive
        self._publisher.publish(message)

    def _redraw(self) -> None:
        session, plan, bar = self._session, self._plan, self._bar
        now, done, trains = plan.explorer.current, plan.progress, session.phase is Phase.TRAINING
        bar.n = min(done.episode * self._steps + (now.steps if trains else 0), bar.total or 0)
        doing, state = session.phase.name.lower(), session.supervisor.summary
        if plan.examination is not None:
            doing = f"examining, {len(plan.scores) + 1} of {len(plan.examination)}"
        described = doing + ("" if state == "armed" else f" ({state})")
        figures: list[str] = []
        if trains:
            rmse = now.force_rmse if math.isfinite(now.force_rmse) else done.last_rmse
            figures = [f"return {now.episode_return:.0f}"]
            figures += [f"RMSE {rmse:.1f} N"] if math.isfinite(rmse) else []  # none before the first samples
            figures += [f"{self._learner.status.updates} updates" if self._learner.alive else "LEARNER DOWN"]
            figures += [f"latency p99 {1e3 * self._node.timing.age.percentile(99):.1f} ms"]
        self._describe(state if session.phase is Phase.WAITING else described, figures)
        bar.refresh()

    def _status(self) -> Status:
        session, plan, node, learner = self._session, self._plan, self._node, self._learner
        phase, done, monitor = self.phase(), plan.progress, session.monitor
        assert monitor is not None  # a training has one
        overridden = session.override.active
        unrecorded = node.companions.recording.startswith("LOST")
        fine = phase not in (Phase.PAUSED, Phase.WAITING) and learner.alive and not overridden and not unrecorded
        values = {
            "episode": plan.explorer.current.episode,
            "recording": node.companions.recording,
            "lost samples": session.clock.lost,
            "interruptions": done.interruptions,
            "rollbacks": done.rollbacks,
            "examination": _exam_line(done.exams[-1], plan) if done.exams else "none yet",
            "last stop": plan.last_stop_reason or "none",
            "override": session.override.description,
            "policy": f"blake2b {plan.policy.digest()}",
            "best score": done.best_score,
            "error peak [N]": monitor.peak,
            "chatter [A/s]": monitor.chatter,
            "certificate violations": monitor.violations,
            "updates": learner.status.updates,
            "transitions": learner.appended,
            "inference": plan.explorer.inference.summary(),
            "response": node.timing.response.summary(),
            "state to gains": node.timing.age.summary(),
            "jitter": node.timing.jitter.summary(),
        }
        message = f"{phase.name.lower()}, plant {session.supervisor.summary}"
        message += "" if learner.alive else ", learner down"
        message += ", UNRECORDED" if unrecorded else ""
        message += f", OVERRIDDEN by hand: {session.override.description}" if overridden else ""
        return Status(level=Level.OK if fine else Level.WARN, message=message, values=values)


def _exam_line(result: dict[str, Any], plan: TrainingPlan) -> str:
    """Return an examination's result: RMSE at each sine, and relative to the fixed gains."""
    settings = plan.settings.exam
    rmse = " ".join(f"{value:.1f}" for value in result["rmse"])
    fixed = f"fixed ({settings.reference_kp:g}, {settings.reference_ki:g})"
    error = f" +- {result['error']:.3f}" if result.get("error") else ""
    of = f", policy {result['policy']}" if result.get("policy") else ""
    ends = ", the best so far" if result["best"] else ""
    ends += ", the machine was held up" if result.get("spoilt") else ""
    told = f"RMSE {rmse} N, {result['score']:.3f}{error} of {fixed}{ends}"
    return f"examined after episode {result['episode']}{of}: {told}"
