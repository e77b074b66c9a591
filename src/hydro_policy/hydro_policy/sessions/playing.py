# SPDX-License-Identifier: Apache-2.0
"""A session that plays a schedule of references and gains, without ROS; after `TRIPS_IN_A_ROW` it ends.

The schedule goes on with armed samples, and begins again where it was after a trip. Which filter acts, and whether its
model is this bench's, is not asked: recordings are also made where the model is still to be learned.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hydro_bridge.safety.readiness import Requirement
from hydro_core.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, Flag, FloatArray
from hydro_policy.supervision.plant_supervisor import PlantSupervisor
from hydro_sim.excitation import Playback, Segment

TRIPS_IN_A_ROW = 3
REST = 1.0
"""s recorded before arming: the still bench."""


class PlayingSession:
    """Plays one schedule, once a second of the bench at rest is recorded.

    Parameters
    ----------
    schedule
        Segments with total gains.
    base
        Base gains of the box, K_p [1/s] and K_i [1/s^2].
    supervise
        Makes the supervision of the plant from what this session requires before arming.
    recorded
        Whether the recorder has samples.
    """

    def __init__(
        self,
        schedule: Sequence[Segment],
        base: tuple[float, float],
        supervise: Callable[[Requirement], PlantSupervisor],
        recorded: Callable[[], bool] = lambda: True,
    ) -> None:
        self.playback, self.ended = Playback(schedule), ""
        """Reason for ending before the schedule did; empty if it did not."""
        self._base, self._recorded = base, recorded
        self._still = self._steps = 0
        self._changes = (0.0, 0.0)
        rest = "a second of the still bench"
        self.watch = supervise(
            Requirement(name=rest, ready=self._rested, hint=f"{rest} is recorded first", within=600.0,
                        missing=f"{rest} was not recorded: somebody else arms it")
        )  # fmt: skip
        self.override = self.watch.override

    def _rested(self) -> bool:
        return self._still * SAMPLE_PERIOD >= REST

    @property
    def finished(self) -> bool:
        """Whether the schedule has been played, or has to end."""
        return bool(self.ended) or self.playback.finished

    def end(self, why: str) -> None:
        """End before the schedule does."""
        self.ended = self.ended or why

    def on_sample(self, sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        """Take a sample [14]; True if gains went out."""
        self.watch.on_sample(flags, now)
        self.playback.on_sample(flags)
        if not self._rested():
            self._still = 0 if flags & Flag.ARMED or not self._recorded() else self._still + 1
            return False
        segment = self.playback.next()
        if segment is not None:
            self.watch.outputs.reference(segment.signal)
            self._changes = segment.kp - self._base[0], segment.ki - self._base[1]
        if self.playback.trips_in_a_row >= TRIPS_IN_A_ROW:
            self.end(f"the plant tripped {TRIPS_IN_A_ROW} times in a row: it is left disarmed")
        if flags & Flag.ARMED and not self.watch.unready(now):
            self.watch.acted(now)
        if self.finished or sequence % SAMPLES_PER_STEP:
            return False
        self.watch.outputs.gains(*(self.override.gains(now) or self._changes), self._steps)
        self._steps += 1
        return True

    def on_correction(self, after: float, status: int) -> None:
        """See `hydro_policy.supervision.plant_supervisor.Session`: nothing is made of it."""

    def on_tick(self, now: float) -> None:
        """Handle a tick, some twenty times a second."""
        self.watch.on_tick(now)
