# SPDX-License-Identifier: Apache-2.0
"""Progress on the terminal and on topics: TrainingStatus at 2 Hz, /diagnostics at 1 Hz."""

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
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.nodes.graph.node import GraphNode
from hydro_policy.sessions.episode import Phase

if TYPE_CHECKING:  # evaluate does without
    from hydro_policy.learner_process.supervisor import LearnerSupervisor
    from hydro_policy.sessions.training import TrainingSession

_REDRAW = 4  # ticks of 50 ms
_BAR = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}{postfix}]"
"""Without a rate: waiting and examinations take their time too."""


class TrainingProgress:
    """Progress bar, topic and diagnostics of one training session."""

    def __init__(self, node: GraphNode, session: TrainingSession, learner: LearnerSupervisor) -> None:
        self._node, self._session, self._learner = node, session, learner
        self.phase: Callable[[], Phase] = lambda: session.phase
        steps = session.settings.task.steps_per_episode
        self._bar: tqdm[None] = progress(total=session.settings.episodes * steps, label="waiting", bar_format=_BAR)
        self._ticks, self._told = 0, session.progress.episode
        self._examined = len(session.progress.exams)
        self._message = TrainingStatus()
        self._publisher = create_publisher(node, TRAINING)
        node.create_timer(0.5, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._diagnostics = DiagnosticsPublisher(node, self._status)

    def tick(self) -> None:
        """Redraw at intervals, and print a line for each finished episode."""
        progress = self._session.progress
        while self._told < progress.episode:
            self._node.say(_episode_line(progress.history[self._told], self._session.settings.episodes))
            self._told += 1
        while self._examined < len(progress.exams):
            self._node.say(_exam_line(progress.exams[self._examined], self._session))
            self._examined += 1
        self._ticks += 1
        if self._ticks % _REDRAW == 0:
            self._redraw()

    def close(self) -> None:
        """Take the bar away."""
        self.tick()
        self._redraw()
        self._bar.close()

    def publish(self) -> None:
        """Publish TrainingStatus."""
        session, message = self._session, self._message
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.phase = int(self.phase())
        message.episode, message.step = session.current.episode, session.current.steps
        message.episode_return = session.progress.last_return
        message.force_rmse = session.progress.last_rmse
        message.entropy_coefficient = self._learner.entropy_coefficient
        losses = self._learner.losses
        message.critic_loss, message.actor_loss, message.temperature_loss = losses
        message.updates = self._learner.updates
        message.learner_alive = self._learner.alive
        self._publisher.publish(message)

    def _redraw(self) -> None:
        session, bar = self._session, self._bar
        steps = session.settings.task.steps_per_episode
        under_way = session.current.steps if session.phase is Phase.TRAINING else 0
        bar.n = min(session.progress.episode * steps + under_way, bar.total or 0)
        now = session.watch.summary
        doing, state = session.phase.name.lower(), "" if now == "armed" else f" ({now})"
        if (exam := session.exam) is not None and not exam.finished:
            doing = f"examining, {len(exam.scores) + 1} of {len(exam.plan)}"
        bar.set_description_str(now if session.phase is Phase.WAITING else f"{doing}{state}", refresh=False)
        bar.set_postfix_str(self._figures(), refresh=False)
        bar.refresh()

    def _figures(self) -> str:
        held = f"OVERRIDDEN {self._session.override.description}" if self._session.override.active else ""
        if self._session.phase is not Phase.TRAINING:
            return held
        now, done = self._session.current, self._session.progress
        rmse = now.force_rmse if math.isfinite(now.force_rmse) else done.last_rmse
        learner = f"{self._learner.updates} updates" if self._learner.alive else "LEARNER DOWN"
        error = f"RMSE {rmse:.1f} N" if math.isfinite(rmse) else ""  # none before the first samples
        latency = f"latency p99 {1e3 * self._node.timing.age.percentile(99):.1f} ms"
        return ", ".join(filter(None, (held, f"return {now.episode_return:.0f}", error, learner, latency)))

    def _status(self) -> Status:
        session, node, learner = self._session, self._node, self._learner
        phase = self.phase()
        overridden = session.override.active
        fine = phase not in (Phase.PAUSED, Phase.WAITING) and learner.alive and not overridden
        values = {
            "episode": session.current.episode,
            "lost samples": session.clock.lost,
            "interruptions": session.progress.interruptions,
            "rollbacks": session.progress.rollbacks,
            "examination": _exam_line(exams[-1], session) if (exams := session.progress.exams) else "none yet",
            "last stop": session.run.last_stop or "none",
            "override": session.override.description,
            "policy": f"blake2b {session.explorer.policy.digest()}",
            "best score": session.progress.best_score,
            "error peak [N]": session.monitor.peak,
            "chatter [A/s]": session.monitor.chatter,
            "certificate violations": session.monitor.violations,
            "learner restarts": learner.restarts,
            "updates": learner.updates,
            "transitions": learner.replay.produced,
            "inference": session.explorer.inference.sentence(),
            "response": node.timing.response.sentence(),
            "state to gains": node.timing.age.sentence(),
            "jitter": node.timing.jitter.sentence(),
        }
        message = f"{phase.name.lower()}, plant {session.watch.summary}"
        message += "" if learner.alive else ", learner down"
        message += f", OVERRIDDEN by hand: {session.override.description}" if overridden else ""
        return Status(level=Level.OK if fine else Level.WARN, message=message, values=values)


class EvaluationProgress:
    """Progress bar of one evaluation."""

    def __init__(self, session: TrialRunner[Comparison]) -> None:
        self._session = session
        form = _BAR.replace("{elapsed}", "{elapsed}<{remaining}")
        self._bar: tqdm[None] = progress(total=len(session.plan), label="evaluating", bar_format=form)

    def tick(self) -> None:
        """Redraw."""
        session = self._session
        self._bar.n = len(session.scores)
        if (trial := session.plan.trial) is not None:
            state = "" if (now := session.watch.summary) == "armed" else f" ({now})"
            held = f"OVERRIDDEN {session.override.description}, " if session.override.active else ""
            self._bar.set_description_str(f"evaluating{state}", refresh=False)
            self._bar.set_postfix_str(f"{held}{trial.controller.name} at {trial.case.name}", refresh=False)
        self._bar.refresh()

    def close(self) -> None:
        """Take the bar away."""
        self.tick()
        self._bar.close()


def _exam_line(result: dict[str, Any], session: TrainingSession) -> str:
    """Return an examination's result: RMSE at each sine, and relative to the fixed gains."""
    settings = session.settings.exam
    rmse = " ".join(f"{value:.1f}" for value in result["rmse"])
    fixed = f"({settings.reference_kp:g}, {settings.reference_ki:g})"
    error = f" +- {result['error']:.3f}" if result.get("error") else ""
    of = f", policy {result['policy']}" if result.get("policy") else ""
    ends = "; the best so far" if result["best"] else ""
    ends += "; the machine was held up, and nothing is concluded" if result.get("spoilt") else ""
    return (
        f"examined after episode {result['episode']}{of}: "
        f"RMSE {rmse} N, {result['score']:.3f}{error} of fixed {fixed}, "
        f"better at {result['beaten']} of {len(result['rmse'])} sines{ends}"
    )


def _episode_line(record: dict[str, float], episodes: int) -> str:
    return (
        f"episode {record['episode']:.0f}/{episodes}: {record['amplitude']:.0f} N at {record['frequency']:.2f} Hz, "
        f"return {record['return']:.0f}, RMSE {record['force_rmse']:.1f} N (lag {1e3 * record['lag']:.1f} ms), "
        f"alpha {record['entropy_coefficient']:.4f}, {record['updates']:.0f} updates"
    )
