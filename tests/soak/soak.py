# SPDX-License-Identifier: Apache-2.0
"""Faults drawn at random on a graph that trains, one after another, and how each was survived."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from random import Random

import numpy as np
from numpy.typing import NDArray

from hydro_bridge.process.endings import undisturbed
from tests.graph_probe import own_domain
from tests.soak.crew import Crew
from tests.soak.faults import Fault, Scene, drawn
from tests.soak.judge import Outcome, acting, count_lost, growth, invariants, read
from tests.soak.wire import Wire

_PATIENCE = 240.0  # s until a policy acts again: imports, a lease of 20 s of who was killed, a compiler
_CALM = 0.5  # s of samples that must all be armed
_TRACEBACK = "Traceback (most recent call last)"


class Soak:
    """A graph under faults; make it by `soaking`."""

    def __init__(self, folder: Path, seed: int, stack: ExitStack) -> None:
        self.outcomes: list[Outcome] = []
        self.broken: list[str] = []
        """What was unsafe, but for what is found in the trace and in memory at the end."""
        self.lost = 0
        self._random = Random(seed)
        trace = folder / "trace"
        trace.touch()
        wire = Wire(stack, folder / "box", folder / "port", seed, "--trace", str(trace))
        self.crew = Crew(folder, seed)  # after the wire, which stays until all has ended
        self._trace, self._scene = trace, Scene(self.crew, wire, self._random)
        self._acting = False

    @property
    def records(self) -> NDArray[np.void]:
        """All samples of the box."""
        return read(self._trace)

    def run(
        self,
        seconds: float,
        causes: tuple[str, ...] = (),
        tick: Callable[[float], None] = lambda _: None,
        slack: float = 1.0,
    ) -> None:
        """Strike until `seconds` are over; `tick` is told how many have passed, `slack`: see `violations`."""
        self._tick, self._begun = tick, time.monotonic()
        self.crew.revive()
        if not self._wait_until_acting([]):
            self.broken.append(f"no policy acted within {_PATIENCE:.0f} s: nothing was tried")
            return
        for fault in drawn(self._random, causes):
            if time.monotonic() - self._begun > seconds or (causes and len(self.outcomes) == len(causes)):
                break
            self._rest(self._random.uniform(1.0, 3.0))
            self.strike(fault, slack)

    def strike(self, fault: Fault, slack: float = 1.0) -> None:
        """One fault, and what comes of it; it lasts until the plant is safe, at most as long as that may take."""
        outcome = Outcome(fault.cause, time.monotonic(), fault.safe_within)
        self.outcomes.append(outcome)
        end = outcome.began + fault.lasts
        with fault.strike(self._scene) as again:
            while time.monotonic() < end:
                again()
                self._look()
            late = outcome.began + slack * (fault.safe_within or 0.0)
            while time.monotonic() < late and outcome.safe_after is None:
                again()
                self._rest(_CALM)
                outcome.look(self._since(outcome.began))
        self._rest(_CALM)
        outcome.look(self._since(outcome.began))
        self.crew.statuses.clear()
        back = self._wait_until_acting(outcome.restarted)
        outcome.back_after = time.monotonic() - outcome.began if back else None
        outcome.ended = dict(self.crew.statuses)
        if not back:
            self.broken.append(f"{fault.cause}: no policy acted again within {_PATIENCE:.0f} s")

    def close(self) -> None:
        """End everything, then look at what is left."""
        self.broken += [f"left behind: {process}" for process in self.crew.end()]
        text = self.crew.text
        if count := text.count(_TRACEBACK):
            self.broken.append(f"{count} tracebacks: {text[text.index(_TRACEBACK) :][:1500]}")
        self.lost = count_lost(self.records, self.crew.bags, self.outcomes)

    def violations(self, slack: float = 1.0) -> list[str]:
        """What was unsafe."""
        late = [sentence for outcome in self.outcomes for sentence in outcome.violations(slack)]
        return [*late, *invariants(self.records), *growth(self.crew.memory), *self.broken]

    def _wait_until_acting(self, restarted: list[str]) -> bool:
        end, self._acting = time.monotonic() + _PATIENCE, False
        while time.monotonic() < end:
            restarted += [name for name in self.crew.revive() if name not in restarted]
            self._rest(_CALM)
            if acting(self._since(time.monotonic() - _CALM)):
                self._acting = True
                return True
        return False

    def _rest(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            time.sleep(0.05)
            self._look()

    def _look(self) -> None:
        if self._acting:
            self.crew.look()
        self._tick(time.monotonic() - self._begun)

    def _since(self, moment: float) -> NDArray[np.void]:
        records = self.records
        return records[np.searchsorted(records["time"], moment) :]


@contextmanager
def soaking(folder: Path, seed: int) -> Iterator[Soak]:
    """A soak in a domain of its own, whose processes end with it."""
    with ExitStack() as stack:
        stack.enter_context(own_domain())
        soak = Soak(folder, seed, stack)
        try:
            yield soak
        finally:
            with undisturbed():
                soak.close()
