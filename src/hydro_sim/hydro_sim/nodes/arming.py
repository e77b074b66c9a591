# SPDX-License-Identifier: Apache-2.0
"""Requests to arm and disarm a plant: one at a time, without a person only where that is allowed."""

from __future__ import annotations

import queue
import sys
import threading
import time
from contextlib import suppress
from functools import partial

from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future
from tqdm import tqdm

from hydro_bridge.ros.commander import Commander

NOT_YET = "not armed, still waiting for {}: you are asked once all is ready"
TOO_EARLY = "the plant was armed before all was ready here: it is disarmed, so that nothing waits armed"
_ARM = "press Enter here, or in another terminal: ros2 run hydro_bridge arm"
HOW_TO_ARM = {False: f"the plant is disarmed: {_ARM}", True: f"the plant has tripped: {_ARM} --off, and then without"}
"""Instructions by whether the plant has tripped."""
_SETTLE = 0.1  # s, between two requests
_RETRY = 1.0  # s, after a refusal
_ANSWER_WITHIN = 3.0  # s; a plant that has gone does not answer any more
_DISARM_TIMEOUT = 2.0  # s, for the last word to the plant


def tell(sentence: str) -> None:
    """Print a message on the terminal, above a progress bar; do nothing if the terminal is closed."""
    with suppress(OSError, ValueError):
        tqdm.write(sentence, file=sys.stderr)


class Arming:
    """Arming of a plant on behalf of a commander. A plant that has tripped is disarmed first."""

    def __init__(self, node: Node, commander: Commander) -> None:
        self._node, self._commander = node, commander
        self._rearm, self._granted = False, False
        self._answer: Future | None = None
        self._ask_after, self._told, self._refusal = 0.0, "", ""
        self._keys: queue.SimpleQueue[str] = queue.SimpleQueue()

    def begin(self, *, rearm: bool) -> None:
        """Begin: Enter on the terminal arms from now on; with `rearm`, arming is automatic."""
        self._rearm = rearm
        if not rearm and sys.stdin is not None and sys.stdin.isatty():
            threading.Thread(target=self._read_keys, daemon=True).start()

    def rest(self) -> None:
        """Stop seeking: a person's consent was for one time only."""
        self._granted, self._told = False, ""

    def seek(self, *, tripped: bool, now: float) -> None:
        """Seek an armed plant: call several times a second while it is not armed; `now` by the monotonic clock [s]."""
        awaited = self._answer is not None and not self._answer.done() and now < self._ask_after + _ANSWER_WITHIN
        if awaited or not (self._rearm or self._may_arm(tripped)) or now < self._ask_after:
            return
        self._request(arm=not tripped, now=now)

    def wait(self, awaited: str, *, armed: bool, now: float) -> None:
        """Call instead while something is still `awaited`: requests to arm are refused, early arming is undone."""
        while not self._keys.empty():
            self._keys.get()
            tell(f"! {NOT_YET.format(awaited)}")
        if not armed:
            self._told = ""
        elif now >= self._ask_after:
            if self._told != TOO_EARLY:
                tell(f"! {TOO_EARLY}")
            self._told = TOO_EARLY
            self._request(arm=False, now=now)

    def give_back(self) -> bool:
        """Give the authority back, which disarms, while nobody else spins the node; return whether it is confirmed."""
        answer, executor = self._commander.give(), EventsExecutor()
        if answer is None:
            return False
        executor.add_node(self._node)
        executor.spin_until_future_complete(answer, timeout_sec=_DISARM_TIMEOUT)
        executor.remove_node(self._node)
        executor.shutdown()
        return answer.done() and bool(answer.result().success)

    def _request(self, *, arm: bool, now: float) -> None:
        self._ask_after = now + _SETTLE
        self._answer = self._commander.arm(arm)
        if self._answer is not None:
            self._answer.add_done_callback(partial(self._on_answer, arm))

    def _may_arm(self, tripped: bool) -> bool:
        """Return whether a person has said so since the plant was armed last; says how."""
        while not self._keys.empty():
            self._keys.get()
            self._granted = True
        if not self._granted and HOW_TO_ARM[tripped] != self._told:
            self._told = HOW_TO_ARM[tripped]
            tell(f"! {self._told}")
        return self._granted

    def _on_answer(self, arm: bool, answer: Future) -> None:
        refusal = "" if answer.result() is None or answer.result().success else answer.result().message
        if refusal:
            self._ask_after = time.monotonic() + _RETRY
            if refusal != self._refusal:
                what = "was not armed" if arm else "did not confirm that it is disarmed"
                tell(f"! the plant {what}: {refusal}")
        self._refusal = refusal

    def _read_keys(self) -> None:
        with suppress(OSError, ValueError):  # the terminal has gone
            for line in sys.stdin:
                self._keys.put(line)
