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
from hydro_policy.evaluation.runner import Phase, TrialRunner
from hydro_policy.nodes.graph.node import GraphNode

if TYPE_CHECKING:  # evaluate does without
    from hydro_policy.sessions.plan import TrainingPlan

_REDRAW = 4  # ticks of 50 ms
_BAR = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}{postfix}]"
"""Without a rate: waiting and examinations take their time too."""


class TrainingProgress:
    """Progress bar, topic and diagnostics of one training."""

    def __init__(self, node: GraphNode, session: TrialRunner[TrainingPlan]) -> None:
        self._node, self._session, self._plan, self._learner = node, session, session.plan, session.plan.learner
        self.phase: Callable[[], Phase] = lambda: session.phase
        self._steps = self._plan.settings.task.steps_per_episode
        total = self._plan.settings.episodes * self._steps
        self._bar: tqdm[None] = progress(total=total, label="waiting", bar_format=_BAR)
        self._ticks, self._told = 0, self._plan.progress.episode
        self._examined = len(self._plan.progress.exams)
        self._message = TrainingStatus()
        self._publisher = create_publisher(node, TRAINING)
        node.create_timer(0.5, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._diagnostics = DiagnosticsPublisher(node, self._status)

    def tick(self) -> None:
        """Redraw at intervals, and print a line for each finished episode."""
        progress = self._plan.progress
        while self._told < progress.episode:
            self._node.say(_episode_line(progress.history[self._told], self._plan.settings.episodes))
            self._told += 1
        while self._examined < len(progress.exams):
            self._node.say(_exam_line(progress.exams[self._examined], self._plan))
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
        current, progress, message = self._plan.explorer.current, self._plan.progress, self._message
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.phase = int(self.phase())
        message.episode, message.step = current.episode, current.steps
        message.episode_return, message.force_rmse = progress.last_return, progress.last_rmse
        message.entropy_coefficient = self._learner.entropy_coefficient
        losses = self._learner.losses
        message.critic_loss, message.actor_loss, message.temperature_loss = losses
        message.updates = self._learner.updates
        message.learner_alive = self._learner.alive
        self._publisher.publish(message)

    def _redraw(self) -> None:
        session, plan, bar = self._session, self._plan, self._bar
        under_way = plan.explorer.current.steps if session.phase is Phase.TRAINING else 0
        bar.n = min(plan.progress.episode * self._steps + under_way, bar.total or 0)
        now = session.watch.summary
        doing, state = session.phase.name.lower(), "" if now == "armed" else f" ({now})"
        if plan.exam is not None:
            doing = f"examining, {len(plan.scores) + 1} of {len(plan.exam)}"
        bar.set_description_str(now if session.phase is Phase.WAITING else f"{doing}{state}", refresh=False)
        bar.set_postfix_str(self._figures(), refresh=False)
        bar.refresh()

    def _figures(self) -> str:
        held = f"OVERRIDDEN {self._session.override.description}" if self._session.override.active else ""
        if self._session.phase is not Phase.TRAINING:
            return held
        now, done = self._plan.explorer.current, self._plan.progress
        rmse = now.force_rmse if math.isfinite(now.force_rmse) else done.last_rmse
        learner = f"{self._learner.updates} updates" if self._learner.alive else "LEARNER DOWN"
        error = f"RMSE {rmse:.1f} N" if math.isfinite(rmse) else ""  # none before the first samples
        latency = f"latency p99 {1e3 * self._node.timing.age.percentile(99):.1f} ms"
        return ", ".join(filter(None, (held, f"return {now.episode_return:.0f}", error, learner, latency)))

    def _status(self) -> Status:
        session, plan, node, learner = self._session, self._plan, self._node, self._learner
        phase, done, monitor = self.phase(), plan.progress, session.monitor
        assert monitor is not None  # a training has one
        overridden = session.override.active
        fine = phase not in (Phase.PAUSED, Phase.WAITING) and learner.alive and not overridden
        values = {
            "episode": plan.explorer.current.episode,
            "lost samples": session.clock.lost,
            "interruptions": done.interruptions,
            "rollbacks": done.rollbacks,
            "examination": _exam_line(done.exams[-1], plan) if done.exams else "none yet",
            "last stop": plan.run.last_stop or "none",
            "override": session.override.description,
            "policy": f"blake2b {plan.policy.digest()}",
            "best score": done.best_score,
            "error peak [N]": monitor.peak,
            "chatter [A/s]": monitor.chatter,
            "certificate violations": monitor.violations,
            "learner restarts": learner.restarts,
            "updates": learner.updates,
            "transitions": learner.replay.produced,
            "inference": plan.explorer.inference.sentence(),
            "response": node.timing.response.sentence(),
            "state to gains": node.timing.age.sentence(),
            "jitter": node.timing.jitter.sentence(),
        }
        message = f"{phase.name.lower()}, plant {session.watch.summary}"
        message += "" if learner.alive else ", learner down"
        message += f", OVERRIDDEN by hand: {session.override.description}" if overridden else ""
        return Status(level=Level.OK if fine else Level.WARN, message=message, values=values)


class TrialProgress:
    """Progress bar of a plan's trials; use as context manager."""

    def __init__(self, session: TrialRunner[Any], label: str) -> None:
        self._session, self._label = session, label
        form = _BAR.replace("{elapsed}", "{elapsed}<{remaining}") if session.plan.total else None
        self._bar: tqdm[None] = progress(total=session.plan.total or None, label=label, bar_format=form)

    def __enter__(self) -> TrialProgress:
        return self

    def __exit__(self, *_: object) -> None:
        self.tick()
        self._bar.close()

    def tick(self) -> None:
        """Redraw."""
        session = self._session
        self._bar.n = round(session.plan.done)
        if (trial := session.plan.trial) is not None:
            state = "" if (now := session.watch.summary) == "armed" else f" ({now})"
            held = f"OVERRIDDEN {session.override.description}, " if session.override.active else ""
            self._bar.set_description_str(f"{self._label}{state}", refresh=False)
            self._bar.set_postfix_str(f"{held}{trial.name}", refresh=False)
        self._bar.refresh()


def _exam_line(result: dict[str, Any], plan: TrainingPlan) -> str:
    """Return an examination's result: RMSE at each sine, and relative to the fixed gains."""
    settings = plan.settings.exam
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
