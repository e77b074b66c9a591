# SPDX-License-Identifier: Apache-2.0
"""The plant's clock: an emulated or simulated plant takes its next sample once the graph has answered the last one.

::

    sample k ──> filter ────> correction for k ──────────────────────┐
             ──> commander ─> gains, law, reference; has answered k ─┼──> sample k + 1
             ──> recorder ──> has answered k - 99 or a later one ────┘

A peer is a node that reports which samples it has answered (Answered.msg); its window is the largest lead of the plant
over it: 1 sample for the filter, 10 for a commander, which answers each policy step, 100 for a recorder. Other nodes
are not waited for. Without a commander the plant goes no faster than real time.

=============================== =====================================================================================
nodes to be met (`peers`)       awaited before the first sample, `meet_max` s of wall clock
a peer that is silent           reported, and no longer waited for, after `silence_max` s of wall clock; a peer that
                                works for longer reports so each second
a peer that has left the graph  no longer waited for
arming, disarming               goes on without answers until the box has confirmed
=============================== =====================================================================================

All other times of a paced plant (ages, watchdogs, leases) are the plant's.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from typing import Annotated

from hydro_core.settings import SettingsError, check, described, quantity
from hydro_core.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP

FILTER_WINDOW, COMMANDER_WINDOW, RECORDER_WINDOW = 1, SAMPLES_PER_STEP, 100
"""Windows [samples] of a filter, of a commander, and of a recorder."""

_SEQUENCE_MASK = 0xFFFFFFFF
_PEER_CHECK_PERIOD = 0.1  # s of wall clock between two checks for silent peers
_RESEND_DELAY, _FIRST_RESEND_DELAY = 10.0, 0.5
"""s of wall clock after which an unanswered sample is published again; the first one, which peers may still miss."""
_PACE_HELP = "plant: each sample waits for the graph's answers; real: real time; a number: that many times real time"


@dataclass(frozen=True, kw_only=True)
class LockStepSettings:
    """Peers that a paced plant waits for, and time-outs."""

    peers: Annotated[str, described("Nodes that are met before the first sample, separated by blanks")] = ""
    silence_max: Annotated[float, quantity("s", 0.1, 3600.0, "Wall clock until a silent peer counts as dead")] = 60.0
    meet_max: Annotated[float, quantity("s", 0.1, 3600.0, "Wall clock that the nodes to be met are awaited")] = 300.0

    def __post_init__(self) -> None:
        check(self)


def parse_pace(text: str) -> float | None:
    """Return the speed given by `--pace`, relative to real time; None: the plant's clock.

    Raises SettingsError: it is neither `plant` nor `real` nor a number within (0, 100].
    """
    if text in ("plant", "real"):
        return None if text == "plant" else 1.0
    with suppress(ValueError):
        if 0.0 < (factor := float(text)) <= 100.0:
            return factor
    raise SettingsError(f"--pace {text}: say plant, real, or a factor of real time within (0, 100]; {_PACE_HELP}")


@dataclass
class _Peer:
    window: int
    answered: int
    """Newest sample that it has answered."""
    commands: int = 0
    heard: float = 0.0
    """Time of its last message, s of the monotonic clock."""


class LockStep:
    """Lock-step of plant and graph: tracks which peer has answered which sample, and releases the next one.

    `settings`: required peers and time-outs. `log`: called with a sentence when a peer comes or falls silent.
    """

    def __init__(self, settings: LockStepSettings, log: Callable[[str], None]) -> None:
        self.settings, self._log = settings, log
        self.on_release: Callable[[], None] = lambda: None
        """Called once for each sample when all its answers have arrived, in the thread that received the last one."""
        self._lock = threading.Lock()
        self._confirmed = threading.Condition()
        self._peers: dict[str, _Peer] = {}
        self._unmet = set(settings.peers.split())
        self._newest: int | None = None  # sample
        self._resend: Callable[[], None] | None = None  # of the newest sample while it has not all its answers
        self._began = self._sent = 0.0  # when it was published, and sent again, s of the monotonic clock
        self._deadline = -inf  # s of the monotonic clock before which the next sample does not follow
        self._commands = 0  # commands received since the present holder took the lease
        self._exempt: Callable[[], bool] | None = None
        self._exempt_left = 0
        self._closed = False
        self._patience = _FIRST_RESEND_DELAY

    @property
    def peer_names(self) -> str:
        """Names of the present peers, as text for /diagnostics."""
        return ", ".join(sorted(self._peers)) or "nobody"

    @property
    def pending(self) -> bool:
        """Whether answers to the newest sample are missing."""
        return self._resend is not None

    def on_answer(self, name: str, sequence: int | None, window: int, commands: int = 0) -> None:
        """Process a peer's Answered message; `sequence` None: the peer is ready."""
        with self._lock:
            if name not in self._peers:
                if self._unmet or self._newest is not None:  # else the plant may run in real time
                    self._log(f"under the plant's clock with {name}")
                # Once the plant has begun, all samples up to this step count as answered by a new peer.
                step = -window if self._newest is None else self._newest - self._newest % min(window, COMMANDER_WINDOW)
                self._peers[name] = _Peer(window, step)
                self._sent = -inf  # a plant that stands still has published its newest sample before this one listened
            peer = self._peers[name]
            peer.window, peer.commands, peer.heard = window, commands, time.monotonic()
            if sequence is not None:
                self._note_answer(peer, sequence)
            self._unmet.discard(name)
        self._check()

    def on_correction(self, sequence: int) -> None:
        """Process the arrival of a correction, which is the filter's answer to sample `sequence`."""
        with self._lock:
            for peer in self._peers.values():
                if peer.window == FILTER_WINDOW:
                    self._note_answer(peer, sequence)
                    peer.heard = time.monotonic()
        self._check()

    def _note_answer(self, peer: _Peer, sequence: int) -> None:
        """Note the answer to a sample, unless a later one is answered: a sign of life repeats the last answer."""
        newest = sequence if self._newest is None else self._newest
        if (newest - sequence) & _SEQUENCE_MASK <= (newest - peer.answered) & _SEQUENCE_MASK:
            peer.answered = sequence

    def on_command(self) -> None:
        """Count a command: gains, law or reference."""
        with self._lock:
            self._commands += 1
        self._check()

    def reset_commands(self) -> None:
        """Reset the command counts, as the lease has another holder."""
        with self._lock:
            self._commands = 0
            for peer in self._peers.values():
                peer.commands = 0

    def retain_peers(self, names: set[str]) -> None:
        """Remove the peers that are not among the nodes `names`."""
        for name in set(self._peers) - names:
            self._forget(name, "is gone")

    def release(self) -> None:
        """Release the present sample without further answers."""
        with self._lock:
            resend, self._resend = self._resend, None
        if resend is not None:
            self.on_release()

    def run_until(self, done: Callable[[], bool]) -> bool:
        """Run the plant without answers until `done` returns True, for half a second of plant time at most.

        Returns the last value of `done`. Call from another thread than the plant's.
        """
        with self._lock:
            self._exempt, self._exempt_left = done, 500
        self._check()
        give_up = time.monotonic() + self.settings.silence_max
        with self._confirmed:
            while self._exempt is not None and not self._closed and time.monotonic() < give_up:
                self._confirmed.wait(0.1)
        self._exempt = None
        return done()

    def close(self) -> None:
        """Release the plant for good: no more waiting."""
        self._closed = True
        self.release()

    def wait_for_peers(self, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Wait until all required peers are ready; called in the plant's thread before the first sample.

        `meanwhile`: called once a second.
        """
        give_up, told = time.monotonic() + self.settings.meet_max, time.monotonic() + 10.0
        looks = 0
        while self._unmet and not self._closed:
            time.sleep(0.02)
            looks += 1
            if looks % 50 == 0:
                meanwhile()
            if (now := time.monotonic()) >= give_up:
                self._log(f"{' and '.join(sorted(self._unmet))} did not come: beginning without")
                self._unmet.clear()
            elif now >= told:
                self._log(f"the first sample waits for {' and '.join(sorted(self._unmet))}")
                told = now + 30.0

    def begin_sample(self, sequence: int, resend: Callable[[], None]) -> None:
        """Begin waiting for the answers to sample `sequence`, about to be published; `resend` publishes it again.

        Without peers the plant goes on at once.
        """
        now = time.monotonic()
        with self._lock:
            # Any number, if the box was on before, or its line was unplugged or has lost samples.
            first = self._newest is None or sequence != (self._newest + 1) & _SEQUENCE_MASK
            self._patience = _FIRST_RESEND_DELAY if first else _RESEND_DELAY
            if first:  # a commander answers whole steps: the end of one may be among those that are missing
                for peer in self._peers.values():
                    if peer.window == COMMANDER_WINDOW:
                        peer.answered = (sequence - 1) // COMMANDER_WINDOW * COMMANDER_WINDOW
                    else:
                        peer.answered = sequence - peer.window
            self._newest, self._resend, self._began, self._sent = sequence, resend, now, now
            self._deadline = SAMPLE_PERIOD + (
                now if self._deadline == -inf else max(self._deadline, now - 0.1)  # no more is caught up
            )
        self._check()

    def poll(self) -> float:
        """Handle time-outs by the wall clock; return the time [s] until the next call is due."""
        now, resend = time.monotonic(), None
        with self._lock:
            waiting = self._resend is not None
            behind = self._behind() if waiting else []
            limit = self.settings.silence_max
            silent = [name for name in behind if now - max(self._peers[name].heard, self._began) > limit]
            if behind and now - self._sent > self._patience:
                resend, self._sent = self._resend, now
        for name in silent:
            self._forget(name, f"gave no answer to sample {self._newest} for {limit:g} s and counts as dead")
        if resend is not None:
            resend()
        self._check()
        if behind or not waiting:
            return _PEER_CHECK_PERIOD
        return max(0.0, min(_PEER_CHECK_PERIOD, self._deadline - time.monotonic()))

    def _check(self) -> None:
        """Go on if the newest sample has all its answers, or an arming or disarming is not confirmed yet."""
        with self._lock:
            if self._resend is None:
                return
            excused = self._exempt is not None
            if self._exempt is not None and (self._exempt() or self._exempt_left == 0):
                excused = False
                with self._confirmed:
                    self._exempt = None
                    self._confirmed.notify_all()
            self._exempt_left -= excused
            if self._behind() and not excused:
                return
            fast = excused or any(peer.window == COMMANDER_WINDOW for peer in self._peers.values())
            if fast:
                self._deadline = -inf
            elif time.monotonic() < self._deadline:
                return
        self.release()

    def _behind(self) -> list[str]:
        """Return the peers whose answer the newest sample waits for."""
        assert self._newest is not None
        return [
            name
            for name, peer in self._peers.items()
            if (self._newest - peer.answered) & _SEQUENCE_MASK >= peer.window or peer.commands > self._commands
        ]

    def _forget(self, name: str, why: str) -> None:
        with self._lock:
            known = self._peers.pop(name, None)
        if known is not None:
            self._log(f"{name} {why}: the plant goes on without it")
        self._check()
