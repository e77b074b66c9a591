# SPDX-License-Identifier: Apache-2.0
"""Signals become an orderly end, wherever they come, even where Python drops exceptions; cleaning up is left alone."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys

import pytest

from tests.checks import ran

BEGINNING = """
import os, signal, sys, time
from hydro_core.process import endings
from hydro_core.cli.console import command

def me(number):
    os.kill(os.getpid(), number)
"""


def run(program: str, **more: object) -> subprocess.CompletedProcess[str]:
    """In a session of its own: whatever it signals is not who runs the tests."""
    return ran(sys.executable, "-c", BEGINNING + program, timeout=20.0, start_new_session=True, **more)


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_unwinds_the_command_and_is_its_status_and_putting_in_order_is_not_disturbed(name: str) -> None:
    ended = run(f"""
@command()
def main():
    try:
        me(signal.{name})
        time.sleep(10)
    finally:
        with endings.signals_ignored():
            for number in endings.SIGNALS:
                me(number)
            print("put in order")
main()
""")
    assert (ended.returncode, ended.stdout, ended.stderr) == (128 + getattr(signal, name), "put in order\n", "")


def test_a_hangup_that_nohup_ignores_stays_ignored() -> None:
    ended = run(
        """
@command()
def main():
    me(signal.SIGHUP)
    print("goes on")
main()
""",
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )
    assert (ended.returncode, ended.stdout) == (0, "goes on\n")


def test_a_terminal_that_has_gone_is_no_error() -> None:
    ours, theirs = pty.openpty()
    script = (
        BEGINNING
        + """
@command()
def main():
    try:
        print("runs", flush=True)
        time.sleep(20)
    finally:
        print("nobody reads this any more", flush=True)
        print("nor this", file=sys.stderr, flush=True)
        open(sys.argv[1], "w").write("put in order")
main()
"""
    )
    read, write = os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-c", script, f"/dev/fd/{write}"],
        stdin=theirs, stdout=theirs, stderr=theirs, pass_fds=(write,), start_new_session=True,
        preexec_fn=lambda: os.close(os.open(os.ttyname(theirs), os.O_RDWR)),  # its controlling terminal
    )  # fmt: skip
    os.close(theirs)
    os.close(write)
    assert os.read(ours, 100).startswith(b"runs")
    os.close(ours)  # the ssh session closes: the kernel sends SIGHUP
    assert process.wait(10.0) == 128 + signal.SIGHUP
    assert os.read(read, 100) == b"put in order"
    os.close(read)


def test_an_exception_that_compiled_code_drops_comes_again_but_not_into_the_clean_up() -> None:
    ended = run("""
@command()
def main():
    try:
        try:
            me(signal.SIGTERM)  # as PyObject_HasAttr and PyDict_GetItem do with an exception of Python code below them
        except endings.Terminated:
            pass
        time.sleep(10)
    finally:
        time.sleep(1.2)
        print("put in order")
main()
""")
    assert (ended.returncode, ended.stdout, ended.stderr) == (128 + signal.SIGTERM, "put in order\n", "")
