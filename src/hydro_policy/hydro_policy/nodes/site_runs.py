# SPDX-License-Identifier: Apache-2.0
"""Trials and executables of a commissioning on a site.

Trials run on one plant: emulator (of an emulated bench), bridge, and commanding node. The emulator runs until the end;
bridge, with the filter in its process, and node until another filter, the free port or the free machine is needed. Each
motion has its own recording, and leaves the plant disarmed.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import IO

from hydro_bridge.bags.writer import code_version
from hydro_bridge.ros.companion import Companion, RecorderMonitor
from hydro_bridge.ros.node import leave_graph
from hydro_bridge.safety.guard import LAW_NOT_OFFERED_MESSAGE
from hydro_bridge.safety.readiness import NotReadyError, Requirement
from hydro_core.cli.console import UserError, print_above_progress
from hydro_core.files import site
from hydro_policy.commissioning.record import GateError, Record
from hydro_policy.evaluation.controllers import Controller
from hydro_policy.evaluation.runner import Rest, TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.nodes.announcements import CompanionWatch, terminal_lines
from hydro_policy.nodes.evaluation import compare_on, report_results, required_gain_range
from hydro_policy.nodes.graph_node import CleanupStack, GraphNode
from hydro_policy.nodes.plant_options import NO_FILTER_WORDS, PlantOptions, box_mismatch
from hydro_policy.nodes.plants import (
    GRAPH_FILE,
    Graph,
    guard_range,
    plant_graph,
    recorder_parameters,
    start_nodes,
)
from hydro_policy.runs.report import write_page
from hydro_policy.runs.run_directory import RunDirectory
from hydro_policy.supervision.override import GainOverride
from hydro_policy.supervision.plant_supervisor import corrections_requirement
from hydro_policy.task.cases import EvaluationSettings
from hydro_policy.task.mdp import GainRange
from hydro_sim.files.pairing import BoxIdentity

TRUTH_FILE = "truth.yaml"  # truth of a site's emulated bench; without the file the emulator's default
EMULATED_PLANT = "emulator"
RECORDER_TIMEOUT = 30.0  # s, for a recorder to complete its recording


class Site:
    """Site of one bench: its folder, and the processes and trials on it, until `close`.

    `folder`: folder of the site. `record`: record of its commissioning; its plant is the serial port of the box, or
    `EMULATED_PLANT`. `rearm`: whether the plant is armed without a person. `policy`: whether a policy is to be trained.
    `seconds`: budget of the diagnosis, s of CPU. `log`: file for the output of all processes, whose warnings are also
    shown.
    """

    def __init__(
        self, folder: Path, record: Record, *, rearm: bool, policy: bool, seconds: float, log: IO[str]
    ) -> None:
        self.folder, self.record, self.policy, self.bench = folder, record, policy, folder / site.BENCH_FILE
        self.seconds = seconds
        self._rearm, self._log = rearm, log
        self._typed = None if rearm else terminal_lines()
        self._port = str(folder / "port") if record.plant == EMULATED_PLANT else record.plant
        self._emulator: Companion | None = None
        self._running: list[Companion] = []  # emulator and bridge
        self._node: GraphNode | None = None
        self._serves: Graph = {}  # parameters of the bridge with its filter
        self._stack, self._connection = ExitStack(), ExitStack()

    def close(self) -> None:
        """End all processes of the site."""
        with self._stack:
            self._disconnect()

    def recording(self, name: str) -> Path:
        """Return the folder of a recording."""
        return self.folder / site.RECORDINGS_FOLDER / name

    def run(self, package: str, executable: str, *words: str, echo: bool = True) -> str:
        """Run an executable to its end, with exclusive use of machine and port; returns its last line of output.

        The output goes into the log, and to the terminal if `echo`. Raises GateError: its exit status is not 0.
        """
        self._disconnect()
        self._log.write(f"$ ros2 run {package} {executable} {' '.join(words)}\n")

        def take(line: str) -> None:
            self._log.write(line)
            if echo:
                print_above_progress(line.rstrip("\n"))

        with Companion(package, executable, words, output=take) as running:
            status = running.process.wait()
        said = running.last_line
        if status:
            raise GateError(f"{executable}: {said.removeprefix('error: ') or f'ended with status {status}'}")
        return said

    def free_port(self) -> str:
        """Return the serial port, released by bridge and node; the first call starts the emulator, if any."""
        self._disconnect()
        if self.record.plant != EMULATED_PLANT or self._emulator is not None:
            return self._port
        port, truth = Path(self._port), self.folder / TRUTH_FILE
        port.unlink(missing_ok=True)  # of one that was killed
        words = ["--link", self._port, "--bench", str(self.bench)]
        words += ["--truth", str(truth)] if truth.is_file() else []
        self._emulator = self._stack.enter_context(Companion("hydro_sim", "emulator", words, output=self._log.write))
        end = time.monotonic() + 60.0
        while not port.exists():
            if not self._emulator.running or time.monotonic() > end:
                reason = self._emulator.last_line.removeprefix("error: ")
                raise UserError(f"the emulator does not start: {reason}")
            time.sleep(0.1)
        return self._port

    def record_rest(self, name: str, seconds: float) -> None:
        """Record `seconds` s of the bench at rest as recordings/NAME."""
        with self._recorded(name, required_gain_range([])) as (node, recorder):
            supervisor = node.supervisor(recorder, rearm=False, filtered=False)
            if not node.run_session(Rest(seconds, supervisor), lambda: None):
                raise KeyboardInterrupt

    def compare(
        self, name: str, settings: EvaluationSettings, controllers: Sequence[Controller] = (), *,
        words: Sequence[str] = NO_FILTER_WORDS, learned: bool = False, policies: Sequence[Path] = (),
    ) -> TrialRunner[Comparison]:  # fmt: skip
        """Run a comparison with the compensated law, and write its report; returns the runner with the results.

        `name`: name of recording and report. `settings`: references and lengths. `controllers`: controllers besides
        the compensated law. `words`: the filter's command line. `learned`: whether that law is also run with the
        learned residual. `policies`: policy files whose digests the recording contains.
        """
        run = RunDirectory(self.folder / site.REPORTS_FOLDER / name)
        shutil.rmtree(run.path, ignore_errors=True)
        run.path.mkdir(parents=True)
        with self._recorded(name, required_gain_range(controllers), words, policies) as (node, recorder):
            if node.law is None:
                raise NotReadyError(LAW_NOT_OFFERED_MESSAGE)
            if self._typed is not None:
                node.listen_for_enter(self._typed)
            filtered = tuple(words) != NO_FILTER_WORDS
            needed = (corrections_requirement(lambda: node.corrected),) if filtered else ()
            supervisor = node.supervisor(recorder, *needed, rearm=self._rearm, filtered=filtered)
            results = compare_on(node, controllers, supervisor, settings=settings, learned=learned)
            if results is None or not results.finished:
                raise KeyboardInterrupt
        gains = "{:g} {:g}".format(*self.record.base_gains)
        notes = {"plant": self.record.plant, "filter": " ".join(words), "bench": str(self.bench), "base gains": gains}
        notes["code_version"] = code_version()
        write_page(run, f"Evaluation {name}", notes, report_results(results, run, notes))
        return results

    def _disconnect(self) -> None:
        self._connection.close()
        self._running, self._node, self._serves = [], None, {}

    @contextmanager
    def _recorded(
        self, name: str, gain_range: GainRange, words: Sequence[str] = NO_FILTER_WORDS, policies: Sequence[Path] = ()
    ) -> Iterator[tuple[GraphNode, Requirement]]:
        """Record to `name`: yields node and recorder's requirement; disarms the plant before the recording ends.

        The node commands the plant behind a bridge with the filter `words`, for the range of gains `gain_range`.
        """
        options = PlantOptions(
            plant="bench", port=self._port, bench=self.bench, filter=tuple(words), policies=tuple(policies)
        )
        serves = plant_graph(options, gain_range, self.folder)
        if self._node is None or serves != self._serves:
            self.free_port()
            node = GraphNode("commission")
            self._connection.callback(leave_graph, node)
            node.announcer.log = self._log
            self._running = [self._emulator] if self._emulator is not None else []
            self._running += start_nodes(self._connection, self.folder / GRAPH_FILE, serves, node.announcer.write_log)
            node.companions = CompanionWatch(self._running)
            kp, ki = self.record.base_gains or (None, None)
            base = None if kp is None or ki is None else (kp, ki)  # not told before the first recording
            node.box_fault = partial(box_mismatch, BoxIdentity.of_file(self.bench, base))
            if not node.wait_for_plant(law=True) or node.box is None:
                raise KeyboardInterrupt
            node.override = GainOverride(guard_range(gain_range), node.override.report, node.box.base_gains)
            if options.filter != NO_FILTER_WORDS:
                node.listen_to_corrections()
            self._node, self._serves = node, serves
        node, folder = self._node, self.recording(name)
        shutil.rmtree(folder, ignore_errors=True)
        with CleanupStack() as stack:
            graph = {**serves, "recorder": recorder_parameters(options, folder)}
            (recorder,) = start_nodes(stack, self.folder / GRAPH_FILE, graph, node.announcer.write_log, only="recorder")
            stack.callback(recorder.stop, RECORDER_TIMEOUT)
            node.companions = CompanionWatch([*self._running, recorder])
            stack.callback(node.disarm)
            yield node, RecorderMonitor(node, folder, recorder).requirement
