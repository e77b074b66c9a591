# SPDX-License-Identifier: Apache-2.0
"""The processes of a soak, started as by a user, again when one has ended; their memory and words."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

from hydro_bridge.ros.companion import Companion
from tests.graph_probe import SHORT, children

_MARK = "HYDRO_SOAK"
LEARNER = "learner"
PACKAGES = {
    "emulator": "hydro_sim", "bridge": "hydro_bridge", "filter": "hydro_filter", "recorder": "hydro_bridge",
    "trainer": "hydro_policy",
}  # fmt: skip
"""In the order in which they are started."""
_SETTLED = 60.0  # s after a start from which memory counts: on a loaded machine a learner imports for half a minute
_PATIENCE = 60.0  # s for a command on a loaded machine


@dataclass
class Memory:
    """Of one process: when it was seen first [s]; its MiB when it had settled, and last, for how many s."""

    since: float
    first: float = 0.0
    last: float = 0.0
    seconds: float = 0.0


class Crew:
    """Emulator, bridge, filter, trainer and recorder.

    `folder`: of all their files. `seed`: of emulator and trainer.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        """Open the log; mark all that is started from here."""
        os.environ[_MARK] = self.mark = secrets.token_hex(8)
        self.folder, self.seed, self.run = folder, seed, folder / "runs" / "run"
        self.memory: dict[str, Memory] = {}
        self._log = (folder / "log.txt").open("w+")
        self._companions: dict[str, Companion] = {}

    def _words(self, name: str) -> list[str]:
        """What one is started with."""
        if name == "trainer" and (self.run / "checkpoints" / "latest").exists():
            return ["--resume", str(self.run), *SHORT]
        new = ["--from", "scratch", "--episodes", "100000", "--updates-per-step", "1", "--seed", str(self.seed)]
        place = ["--runs", str(self.run.parent), "--name", self.run.name]
        return {
            "emulator": ["--link", f"{self.folder}/box", "--seed", str(self.seed), "--pace", "real"],
            "bridge": ["--port", f"{self.folder}/port", "--realtime"],
            "filter": ["--realtime"],
            "recorder": ["--realtime", "--out", f"{self.folder}/bag{time.monotonic_ns()}"],
            "trainer": ["--plant", "external", "--rearm", "auto", "--no-record", *new, *place, *SHORT],
        }[name]

    def revive(self) -> None:
        """Start whoever is not there."""
        for name, package in PACKAGES.items():
            if not self.pid(name):
                if name in self._companions:
                    self._companions[name].stop()
                self._companions[name] = Companion(package, name, self._words(name), output=self._log.write)

    def pid(self, name: str) -> int:
        """Process id of one of them, or of the trainer's learner; 0: it is not there."""
        companion = self._companions.get("trainer" if name == LEARNER else name)
        if companion is None or not companion.running:
            return 0
        found = [companion.process.pid]
        return next(iter(children(found[0], "spawn_main") if name == LEARNER else found), 0)

    def signal(self, name: str, number: int) -> None:
        """Send a signal; to one that is not there none."""
        if pid := self.pid(name):
            with suppress(ProcessLookupError):
                os.kill(pid, number)
        if (name, number) == ("emulator", signal.SIGKILL):  # its terminal's number is the next one's who asks for one
            (self.folder / "box").unlink(missing_ok=True)

    def arm(self) -> None:
        """Arm the plant for the trainer, as a person does; where nobody commands it now, whoever comes arms it."""
        subprocess.run(["ros2", "run", "hydro_bridge", "arm", "--for", "trainer"], timeout=_PATIENCE, check=False)

    def look(self) -> None:
        """Take note of the memory of each; call it while all of them work, for one that imports still grows."""
        now = time.monotonic()
        for name in (*PACKAGES, LEARNER):
            if pid := self.pid(name):
                known = self.memory.setdefault(f"{name} {pid}", Memory(now))
                with suppress(psutil.NoSuchProcess):  # it ends just now
                    if now - known.since > _SETTLED:
                        known.last = psutil.Process(pid).memory_info().rss / 2**20
                        known.first = known.first or known.last
                        known.seconds = now - known.since - _SETTLED

    def end(self) -> list[str]:
        """End all, the trainer first; who of them is left after that, or of what they had started."""
        for name, companion in reversed(self._companions.items()):
            self.signal(name, signal.SIGCONT)
            companion.stop(60.0 if name == "trainer" else 10.0)
        time.sleep(0.5)
        others = [one for one in psutil.process_iter(["environ", "cmdline"]) if one.pid != os.getpid()]
        left = [one for one in others if (one.info["environ"] or {}).get(_MARK) == self.mark]
        return [f"{one.pid} {one.info['cmdline']}" for one in left]

    @property
    def text(self) -> str:
        """What all have said."""
        self._log.flush()
        return Path(self._log.name).read_text(errors="replace")
