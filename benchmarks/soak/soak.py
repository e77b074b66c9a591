# SPDX-License-Identifier: Apache-2.0
"""Faults on a graph that trains, one after another, and how each was survived."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from random import Random

import numpy as np

from benchmarks.soak import wire
from benchmarks.soak.crew import Crew
from benchmarks.soak.faults import Fault
from benchmarks.soak.judge import Outcome, Records, acting, growth, invariants, read
from hydro_core.process.termination import signals_ignored
from tests.domains import own_domain

_PATIENCE = 240.0  # s until a policy acts again: imports, a lease of 20 s of who was killed, a compiler
_CALM = 0.5  # s of samples that must all be armed
_TRACEBACK = "Traceback (most recent call last)"


class Soak:
    """A graph under faults; make it by `soaking`."""

    def __init__(self, folder: Path, seed: int, stack: ExitStack) -> None:
        self.outcomes: list[Outcome] = []
        self.broken: list[str] = []
        """What was unsafe, but for what is found in the trace and in memory at the end."""
        self._random = Random(seed)
        self.orders, self._trace = wire.start(stack, folder, seed), folder / "trace"
        self.crew = Crew(folder, seed)  # after the wire, which stays until all has ended
        self._acting = False

    @property
    def records(self) -> Records:
        """All samples of the box."""
        return read(self._trace)

    def run(self, faults: Iterable[Fault], seconds: float, tick: Callable[[float], None]) -> None:
        """Strike until there is no fault more or `seconds` are over; `tick` is told how many have passed."""
        self._tick, self._begun = tick, time.monotonic()
        self.crew.revive()
        if not self._wait_until_acting():
            self.broken.append(f"no policy acted within {_PATIENCE:.0f} s: nothing was tried")
            return
        for fault in faults:
            if time.monotonic() - self._begun > seconds:
                break
            self._rest(self._random.uniform(1.0, 3.0))
            self._strike(fault)

    def _strike(self, fault: Fault) -> None:
        """One fault, and what comes of it; it lasts until the plant is safe, at most as long as that may take."""
        outcome = Outcome(fault.cause, time.monotonic(), fault.safe_within, fault.stays_armed)
        self.outcomes.append(outcome)
        end = outcome.began + fault.lasts
        late = outcome.began + (fault.safe_within or 0.0)
        with fault.strike(self) as again:
            while time.monotonic() < end:
                again()
                self._look()
            while time.monotonic() < late and outcome.safe_after is None:
                again()
                self._rest(_CALM)
                outcome.look(self._since(outcome.began))
        self._rest(_CALM)
        outcome.look(self._since(outcome.began))
        if self._wait_until_acting():
            outcome.back_after = time.monotonic() - outcome.began
        else:
            self.broken.append(f"{fault.cause}: no policy acted again within {_PATIENCE:.0f} s")

    def close(self) -> None:
        """End everything, then look at what is left."""
        try:
            self.orders.send("report")
            self.carried = self.orders.recv()
        finally:  # a wire that died leaves no armed graph behind
            self.broken += [f"left behind: {process}" for process in self.crew.end()]
        if count := self.carried["forged"]:
            self.broken.append(f"{count} states that answer a command which nobody sent")
        text = self.crew.text
        if count := text.count(_TRACEBACK):
            self.broken.append(f"{count} tracebacks: {text[text.index(_TRACEBACK) :][:1500]}")

    def violations(self) -> list[str]:
        """What was unsafe."""
        late = [sentence for outcome in self.outcomes for sentence in outcome.violations()]
        return [*late, *invariants(self.records), *growth(self.crew.memory), *self.broken]

    def _wait_until_acting(self) -> bool:
        end, self._acting = time.monotonic() + _PATIENCE, False
        while time.monotonic() < end and not self._acting:
            self.crew.revive()
            self._rest(_CALM)
            self._acting = acting(self._since(time.monotonic() - _CALM))
        return self._acting

    def _rest(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            time.sleep(0.05)
            self._look()

    def _look(self) -> None:
        if self._acting:
            self.crew.look()
        self._tick(time.monotonic() - self._begun)

    def _since(self, moment: float) -> Records:
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
            with signals_ignored():
                soak.close()
