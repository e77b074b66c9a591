# SPDX-License-Identifier: Apache-2.0
"""Base class of the plants behind a plant node: the bridge's `Link` and the simulation, each in a thread. No ROS."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from hydro_bridge.clock import HostClock
from hydro_bridge.plant_clock import LockStep, LockStepSettings
from hydro_bridge.safety.guard import CommandGuard
from hydro_core.signals import Flag, flag_names

LogFunction = Callable[[str], None]


class PlantInterface(ABC):
    """Plant behind a plant node: arming, commands by the guard, and time stamps of its samples.

    `guard`: source of all commands. `log`, `warn`: loggers of changes and of faults; `warn` is `log` by default.
    `lock_step`: lock-step of plant and graph.
    """

    absence_reason = ""
    """Reason why the plant is absent; empty: it is present."""
    no_sample_message = ""
    """Reason why a present plant sends no samples; empty: it sends them."""

    def __init__(
        self, guard: CommandGuard, log: LogFunction, warn: LogFunction | None = None, lock_step: LockStep | None = None
    ) -> None:
        self.guard, self.lock_step = guard, lock_step or LockStep(LockStepSettings(), log)
        self.lock = threading.Lock()
        """Lock of the guard."""
        self.flags = self.samples = 0
        """Flags of the last sample; number of samples."""
        self.host_clock = HostClock()
        self._log, self._warn = log, warn or log
        self._flags_condition, self._awaiting = threading.Condition(), False

    @property
    @abstractmethod
    def real_time(self) -> bool:
        """Whether stamps are ROS time, and commands age by the host's clock."""

    @property
    @abstractmethod
    def paced(self) -> bool:
        """Whether plant and graph run in lock-step: each sample waits for the answers to the previous one."""

    @abstractmethod
    def now(self) -> float:
        """Time [s] by which commands and leases age: the host's monotonic clock, or the plant's own."""

    @abstractmethod
    def send(self, corrected: int | None = None) -> None:
        """Send the guard's present command; `corrected` is the sample whose correction has just arrived."""

    def status(self) -> Any:
        """Return the status for /diagnostics, without flags and guard counts."""
        raise NotImplementedError

    @abstractmethod
    def run(self) -> None:
        """Run the plant until `stop`; the body of its thread."""

    @abstractmethod
    def stop(self) -> None:
        """End `run`."""

    def arm(self, arm: bool, timeout: float = 0.5) -> str:
        """Arm or disarm, and await the box's confirmation; return the reason of a failure. Not for `run`'s thread."""
        with self.lock:
            if arm and self.absence_reason:
                return f"there is no box: {self.absence_reason}"
            if arm and self.flags & Flag.TRIPPED:
                return f"the box has tripped ({flag_names(self.flags)}): disarm it, then arm it"
            self.guard.set_arm(arm)
            before = self.samples

        def done() -> bool:
            return bool(self.absence_reason) or self._confirms(arm, before)

        if self.paced:
            confirmed = self.lock_step.run_until(done)
        else:
            with self._flags_condition:
                self._awaiting = True  # wake up at each sample
                confirmed = self._flags_condition.wait_for(done, timeout)
                self._awaiting = False
        if self.absence_reason:
            return "the box has gone while it was to be armed: it is not armed" if arm else ""
        if confirmed:
            return ""
        with self.lock:
            self.guard.set_arm(False)
        if self.no_sample_message:
            return f"the box sends no samples: {self.no_sample_message}"
        return f"the box did not confirm within {timeout:g} s ({flag_names(self.flags)})"

    def _confirms(self, arm: bool, before: int) -> bool:
        """Return whether the last sample confirms an arming or disarming requested after `before` samples."""
        return bool(self.flags & Flag.ARMED) == arm

    def _update_flags(self, flags: int) -> None:
        changed, self.flags = flags ^ self.flags, flags
        if changed & (Flag.ARMED | Flag.TRIPPED) or self._awaiting:
            with self._flags_condition:
                self._flags_condition.notify_all()

    def _ros_time(self, monotonic_ns: int) -> int:
        """Return the ROS time [ns] of a monotonic time [ns], after a check whether the host's clock was set."""
        if step := self.host_clock.detect_step():
            self._warn(f"the host's clock was set by {1e-9 * step:+.3f} s: the samples' stamps follow at once")
        return monotonic_ns + self.host_clock.offset
