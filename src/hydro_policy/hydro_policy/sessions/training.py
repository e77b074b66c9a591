# SPDX-License-Identifier: Apache-2.0
"""Training session: episodes, examinations, stops and pauses, driven by samples and ticks, without ROS.

    WAITING ────ready, then armed───> EVALUATING ──good──> TRAINING ──────episodes─────> EVALUATING ──last──> FINISHED
                                                              │  ^
             plant lost, disarmed, tripped; stopped by the    v  │  armed again, calm again: the interrupted part
             monitor: back to the last good policy          PAUSED  is restarted

A plant that goes by its own clock waits for the learner: each step acts on the weights after all updates that were due
at its beginning, and examinations and checkpoints are of that state.

An episode's end is a truncation: the next state's value is bootstrapped. Only a trip by the box or a stop by the
monitor is a termination.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from hydro_core.signals import Flag, FloatArray
from hydro_policy.evaluation.controllers import Controller, FixedGains, PolicyController
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.learner_process.supervisor import LearnerSupervisor
from hydro_policy.runs.run import RunRecord, TrainingSettings
from hydro_policy.sessions.episode import EpisodeRecord, Explorer, Phase
from hydro_policy.sessions.run_state import EXAMINED, LEAD, Progress, RunState, stop_reason
from hydro_policy.supervision.monitor import SafetyMonitor
from hydro_policy.supervision.plant_supervisor import FALLBACK, PlantSupervisor
from hydro_policy.task.mdp import Step, StepClock, events, terminations

UNDER_WAY = (Phase.TRAINING, Phase.EVALUATING)


class TrainingSession:
    """Schedules episodes and examinations, and handles stops and pauses.

    Parameters
    ----------
    settings
        Settings of the run.
    learner
        Running learner.
    watch
        Supervision of the plant, which also waits for the learner.
    state, best
        `state()` and best agent of the session to continue, or None.
    record
        Record of events.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        learner: LearnerSupervisor,
        watch: PlantSupervisor,
        *,
        state: dict[str, Any] | None = None,
        best: bytes | None = None,
        record: RunRecord | None = None,
    ) -> None:
        self.settings, self.learner = settings, learner
        self.watch, self.override, self._outputs = watch, watch.override, watch.outputs
        self.clock = StepClock()
        self.progress = Progress() if state is None else Progress(**state["progress"])
        self.run = RunState(settings, learner, self.progress, best, record)
        self.explorer, self.monitor = Explorer(settings, learner.replay, watch.outputs), SafetyMonitor(settings.monitor)
        self.policy, self.explorer.published = self.explorer.policy, self.progress.total_steps
        self.current = EpisodeRecord(episode=0)
        """The present episode, or the last one."""
        if state is not None:
            self.explorer.rng.bit_generator.state = state["random_state"]
        self.phase = Phase.WAITING
        self.exam: TrialRunner[Comparison] | None = None
        self._fresh = True  # no episode has passed since the box was armed

    @property
    def finished(self) -> bool:
        """Whether all episodes are done, or the run was given up."""
        return self.phase is Phase.FINISHED

    def state(self) -> dict[str, Any]:
        """Return the state for a checkpoint, as JSON types."""
        progress = self.progress
        summary = {"episode": progress.episode, "total_steps": progress.total_steps, "last_rmse": progress.last_rmse}
        return {**summary, "progress": asdict(progress), "random_state": self.explorer.rng.bit_generator.state}

    def on_sample(self, sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        """Process a sample [14]; returns True if gains were sent."""
        self.watch.on_sample(flags, now)
        self.run.exact = bool(flags & Flag.PACED)
        base = None if self.watch.mismatched else self.settings.base_gains
        step = self.clock.add(sequence, sample, flags, base)
        if self.finished:
            return False
        if self.run.exact and (step is not None or not flags & Flag.ARMED):
            self.learner.settle()
        if not flags & Flag.ARMED:
            if self.phase in UNDER_WAY:
                self._interrupt(sample, flags)
            return False
        if self.exam is not None:
            return self._examine(self.exam, sequence, sample, flags, now)
        return step is not None and self._act(step, now)

    def on_correction(self, after: float, status: int) -> None:
        """Process the filter's result of a sample: M_c [1/s] under its correction, and the status."""
        self.monitor.on_correction(after, status)
        self.watch.on_correction(status)

    def on_tick(self, now: float) -> None:
        """Handle a tick, some twenty times a second: arming, loss of the plant, death of the learner."""
        self.watch.on_tick(now)
        if self.watch.lost and self.phase in UNDER_WAY:
            self._pause("no samples", self._where)
        message = self.learner.restart_if_dead()
        if message is not None:
            self._outputs.say(message, warning=True)

    def _act(self, step: Step, now: float) -> bool:
        """Make one policy step of an armed plant outside of examinations; returns True if gains were sent."""
        held = self.override.gains(now)
        if held is not None:
            self._hold(held, step)
            return True
        if self.watch.calming:
            self.explorer.hold((0.0, 0.0))
            return True
        if self.watch.mismatched and not self.watch.unready(now):
            self.watch.acted(now)
            self._hold(FALLBACK, step)
            return True
        if self.phase is not Phase.TRAINING:
            if not self.watch.may_begin(now):
                return False
            self._begin()
        elif self.watch.unready(now):  # a person has held the gains: the watch disarms, and the episode is restarted
            return False
        self.watch.acted(now)
        if self.phase is Phase.TRAINING:
            self._step(step)
        return True

    def _begin(self) -> None:
        """Begin what is due: an examination, an episode, or the end."""
        self.run.start()
        if self.run.exam_due:
            self._begin_exam()
        elif self.run.trained:
            self.phase = Phase.FINISHED
        else:
            self._begin_episode()

    def _begin_episode(self) -> None:
        """Begin the episode after the finished ones, or restart it."""
        done = self.progress.episode
        signal = events.reference(self.settings.task, done, self.settings.seed)
        self._outputs.reference(signal)
        self.current = EpisodeRecord(episode=done + 1, amplitude=signal.amplitude, frequency=signal.frequency)
        self.monitor.reset()
        self.phase = Phase.TRAINING

    def _step(self, step: Step) -> None:
        """Make one step under the newest policy, unless the monitor requests a stop."""
        reason = self.monitor.add(step)
        if reason is not None:
            self._stop(reason, step.sample)
            return
        parameters = self.learner.new_weights()
        if parameters is not None:
            self.policy.load_flat(parameters)
        self._count(step, self.explorer.step(step))
        self.learner.wake()
        if self.current.steps >= self.settings.task.steps_per_episode:
            self._fresh = False
            self._go_on(best=self.run.add_episode(self.current))

    def _hold(self, gains: tuple[float, float], step: Step) -> None:
        """Make one step under gain changes that are not the policy's; in an episode it counts as one of its steps."""
        reward = self.explorer.hold(gains, step)
        if self.phase is Phase.TRAINING:
            self._count(step, reward)
            self.current.overridden_steps += 1
        self.monitor.reset()  # it assesses policies

    def _count(self, step: Step, reward: float | None) -> None:
        if reward is not None:
            self.current.add(step, reward)
            self.progress.total_steps += 1

    def _begin_exam(self) -> None:
        """Examine the learner's present state, and the fixed gains that its score is relative to where not yet known.

        Learning continues meanwhile, the acting policy does not change.
        """
        parameters = self.run.propose()
        if parameters is not None:
            self.policy.load_flat(parameters)
        settings, gains = self.settings.exam, self.settings.task.gains
        controllers: list[Controller] = [PolicyController(self.policy, gains, EXAMINED)]
        if reference_too := not self.progress.reference_rmse:
            controllers.append(FixedGains(settings.reference_kp, settings.reference_ki, self.override.base))
        lead = LEAD if self._fresh or reference_too else 0.0
        self.exam = TrialRunner(Comparison(settings.evaluation, controllers, lead), self.watch, monitor=self.monitor)
        self.explorer.forget()
        self.phase = Phase.EVALUATING

    def _examine(
        self, running: TrialRunner[Comparison], sequence: int, sample: FloatArray, flags: int, now: float
    ) -> bool:
        acted = running.on_sample(sequence, sample, flags, now)
        reason = stop_reason(running.scores)
        if reason:
            self._stop(reason, sample)
        elif running.finished:
            self.exam = None
            self._go_on(best=self.run.add_exam(running.scores, self.policy.digest()))
        return acted

    def _go_on(self, *, best: bool) -> None:
        """Continue after an episode or examination: save a checkpoint, and begin what is due."""
        self.learner.save(self.state(), best, exact=self.run.exact)
        self._begin()

    def _interrupt(self, sample: FloatArray, flags: int) -> None:
        """Handle a disarmed box. If the policy caused it, it learns the penalty and is rolled back."""
        where = self._where
        if terminations.tripped(flags) and self.override.active:
            self.watch.calm()
        elif terminations.tripped(flags):
            self._stop(f"the box {self.watch.condition}", sample)
        if not self.finished:
            self._pause(self.watch.condition, where)

    def _stop(self, reason: str, sample: FloatArray) -> None:
        """Stop the policy: base gains, calm, the last good policy; after too many stops, end the run."""
        where = self._where
        if self.exam is None:
            self.explorer.terminate(sample)
        else:
            self.progress.examined, self.exam = self.progress.episode, None
        self.explorer.hold((0.0, 0.0))
        self.watch.calm()
        good = self.run.roll_back()
        if good is not None:
            self.policy.load_flat(good)
        sentence = self.run.add_stop(reason, where, "" if good is None else self.policy.digest())
        self.phase = Phase.FINISHED if self.run.gave_up else Phase.PAUSED
        self._outputs.say(sentence, warning=True)

    def _pause(self, reason: str, where: str) -> None:
        sentence = f"paused in {where} at step {self.current.steps}: {reason}; it starts again once the plant is armed"
        self.phase, self.exam, self._fresh = Phase.PAUSED, None, True
        self.progress.interruptions += 1
        self.explorer.forget()
        self._outputs.say(sentence, warning=True)

    @property
    def _where(self) -> str:
        return "the examination" if self.exam is not None else f"episode {self.current.episode}"
