# SPDX-License-Identifier: Apache-2.0
"""The processes of a soak, started as by a user, again when one has ended; their memory and words."""

from __future__ import annotations

import os
import secrets
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from hydro_bridge.ros.companion import Companion
from tests.graph_probe import SHORT, _children, _command_line
from tests.soak.wire import resident

_MARK = "HYDRO_SOAK"
LEARNER = "learner"
_SETTLED = 60.0  # s after a start from which memory counts: on a loaded machine a learner imports for half a minute


@dataclass
class Memory:
    """Of one process, from start to end."""

    process: str
    since: float
    first: float = 0.0
    last: float = 0.0
    seconds: float = 0.0


@dataclass
class Post:
    """One place in the graph, and who fills it now."""

    package: str
    words: Callable[[], list[str]]
    companion: Companion | None = None
    starts: int = 0


@dataclass
class Crew:
    """Emulator, bridge, filter, trainer and recorder.

    `folder`: of all their files. `seed`: of emulator and trainer.
    """

    folder: Path
    seed: int
    memory: list[Memory] = field(default_factory=list)
    statuses: dict[str, int] = field(default_factory=dict)
    """How those ended that have ended since `revive` was called last."""

    def __post_init__(self) -> None:
        """Open the logs; mark all that is started from here."""
        os.environ[_MARK] = self.mark = secrets.token_hex(8)
        self.run = self.folder / "runs" / "run"
        self._log = (self.folder / "log.txt").open("w+")
        self.posts = {
            "emulator": Post("hydro_sim", lambda: ["--link", f"{self.folder}/box", "--seed", str(self.seed)]),
            "bridge": Post("hydro_bridge", lambda: ["--port", f"{self.folder}/port", "--realtime"]),
            "filter": Post("hydro_filter", lambda: ["--realtime"]),
            "recorder": Post("hydro_bridge", lambda: ["--realtime", "--out", str(self.next_bag())]),
            "trainer": Post("hydro_policy", self._trainer),
        }

    def _trainer(self) -> list[str]:
        if (self.run / "checkpoints" / "latest").exists():
            return ["--resume", str(self.run), *SHORT]
        new = ["--from", "scratch", "--episodes", "100000", "--updates-per-step", "1", "--seed", str(self.seed)]
        place = ["--runs", str(self.run.parent), "--name", self.run.name]
        return ["--plant", "external", "--rearm", "auto", "--no-record", *new, *place, *SHORT]

    def next_bag(self) -> Path:
        """Where the next recording goes."""
        return self.folder / f"bag{self.posts['recorder'].starts}"

    @property
    def bags(self) -> list[Path]:
        """Recordings so far."""
        return sorted(path for path in self.folder.glob("bag*") if any(path.glob("*.mcap")))

    def revive(self) -> list[str]:
        """Start whoever is not there; their names."""
        started = []
        for name, post in self.posts.items():
            if post.companion is not None and post.companion.running:
                continue
            if post.companion is not None:
                self.statuses[name] = post.companion.stop()
            post.companion = Companion(post.package, name, post.words(), output=self._log.write)
            post.starts += 1
            started.append(name)
        return started

    def pid(self, name: str) -> int:
        """Process id of who fills a post, or of the trainer's learner; 0: nobody does."""
        trainer = self.posts["trainer" if name == LEARNER else name].companion
        assert trainer is not None
        if name != LEARNER:
            return trainer.process.pid if trainer.running else 0
        with suppress(FileNotFoundError, ProcessLookupError):
            return next((pid for pid in _children(trainer.process.pid) if "spawn_main" in _command_line(pid)), 0)
        return 0

    def signal(self, name: str, number: int) -> None:
        """Send a signal; to a learner that is not there none."""
        if pid := self.pid(name):
            with suppress(ProcessLookupError):
                os.kill(pid, number)
        if (name, number) == ("emulator", signal.SIGKILL):  # its terminal's number is the next one's who asks for one
            (self.folder / "box").unlink(missing_ok=True)

    def look(self) -> None:
        """Take note of the memory of each; call it while all of them work, for one that imports still grows."""
        now = time.monotonic()
        for name in (*self.posts, LEARNER):
            pid = self.pid(name)
            label = f"{name} {pid}"
            known = next((each for each in self.memory if each.process == label), None)
            if known is None and pid:
                known = Memory(label, now)
                self.memory.append(known)
            with suppress(OSError, StopIteration):  # it ends just now
                if known is not None and now - known.since > _SETTLED:
                    known.last = resident(pid)
                    known.first = known.first or known.last
                    known.seconds = now - known.since - _SETTLED

    def end(self) -> list[str]:
        """End all, the trainer first; who of them is left after that, or of what they had started."""
        for name in ("trainer", "recorder", "filter", "bridge", "emulator"):
            companion = self.posts[name].companion
            if companion is not None:
                self.signal(name, signal.SIGCONT)
                companion.stop(60.0 if name == "trainer" else 10.0)
        time.sleep(0.5)
        return [f"{pid} {_command_line(pid)}" for pid in _marked(self.mark) if pid != os.getpid()]

    @property
    def text(self) -> str:
        """What all have said."""
        self._log.flush()
        return Path(self._log.name).read_text(errors="replace")


def _marked(mark: str) -> list[int]:
    found = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if mark.encode() in path.read_bytes():
                found.append(int(path.parent.name))
    return found
