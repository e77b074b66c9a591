# SPDX-License-Identifier: Apache-2.0
"""How a program ends when somebody wants it to: SIGINT (Ctrl-C), SIGTERM, SIGHUP (the terminal or ssh session closed).

All three mean the same: disarm, write what is to be kept, end the companions, leave with status 128 + number. Before
anything has begun (imports) `leaves_at_once`; from then on each raises `Ended`, a KeyboardInterrupt, or is taken by
whoever spins; what puts things in order at the end is `undisturbed`.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import termios
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_INSIST_AFTER = 0.05  # s
Handlers = Mapping[int, Any]
"""What answered each signal, as `signal.signal` gives it."""


class Ended(KeyboardInterrupt):
    """Somebody wants this program to end, by the signal `number`; `sentence` says why, if that is not plain."""

    def __init__(self, number: int, sentence: str = "") -> None:
        super().__init__(sentence)
        self.number, self.sentence = number, sentence


def answer(handler: Callable[[int, FrameType | None], Any] | signal.Handlers) -> Handlers:
    """Let `handler` answer the three signals; what did so before, for `restore`. In other threads than main: nothing.

    A SIGHUP that is ignored stays so: whoever started us with nohup wants us to outlive the terminal.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    wanted = [n for n in SIGNALS if n is not signal.SIGHUP or signal.getsignal(n) is not signal.SIG_IGN]
    return {number: signal.signal(number, handler) for number in wanted}


def restore(before: Handlers) -> None:
    """Let what answered before answer again."""
    for number, handler in before.items():
        signal.signal(number, handler)


def end(number: int, _: FrameType | None = None) -> None:
    """Raise `Ended`: the answer of a program that runs. In a process that was forked off it: die, as by default."""
    if os.getpid() != _program:
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    let_go_of_terminal()
    raise Ended(number)


def ask() -> None:
    """End this program as Ctrl-C does: for those who ask it by a message."""
    os.kill(os.getpid(), signal.SIGINT)


def leave(number: int, _: FrameType | None = None) -> None:
    """Go at once, with a sentence: the answer while nothing has begun that would have to be put in order."""
    let_go_of_terminal()
    with suppress(OSError):
        os.write(2, f"ended by {signal.Signals(number).name} while starting: nothing had begun\n".encode())
    os._exit(128 + number)


@contextmanager
def raised() -> Iterator[None]:
    """Within, each of the signals raises `Ended`.

    Where Python cannot raise (finalizers, the compiler's callbacks into Python) it drops an exception: it comes again.
    """
    global _program
    _program = os.getpid()
    before, dropped = answer(end), sys.unraisablehook

    def insist(what: sys.UnraisableHookArgs) -> None:
        error = what.exc_value
        if not isinstance(error, Ended):
            dropped(what)
            return
        number = error.number
        signal.signal(signal.SIGALRM, lambda *_: end(number))
        signal.setitimer(signal.ITIMER_REAL, _INSIST_AFTER)

    sys.unraisablehook = insist
    try:
        yield
    finally:
        sys.unraisablehook = dropped
        restore(before)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Within, signals change nothing: for disarming and the last checkpoint, whose waits end by themselves."""
    before = answer(signal.SIG_IGN)
    try:
        yield
    finally:
        restore(before)


def let_go_of_terminal() -> None:
    """Put /dev/null in the place of a terminal that has gone: the next word to it would be an error."""
    for stream in (0, 1, 2):
        try:
            termios.tcgetattr(stream)
        except termios.error as error:
            if error.args[0] == errno.EIO:
                nothing = os.open(os.devnull, os.O_RDWR)
                os.dup2(nothing, stream)
                os.close(nothing)
        except OSError:
            continue


def complain(sentence: str) -> None:
    """Say on standard error what ends this program; where nobody reads that any more, nobody."""
    with suppress(OSError, ValueError):
        print(f"error: {sentence}", file=sys.stderr, flush=True)


_program = os.getpid()
