# SPDX-License-Identifier: Apache-2.0
"""The plant of a site for a whole commissioning: the emulator, if it is emulated, a bridge, and the node that commands.

The emulator runs until the end; the bridge, with the filter in its process, and the node until another filter is
needed, or the port, or the machine. Each motion has a recording of its own, and leaves the plant disarmed.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import IO

from hydro_bridge.ros.companion import Companion, RecorderWatch
from hydro_bridge.ros.node import leave_graph
from hydro_bridge.safety.guard import NOT_OFFERED
from hydro_bridge.safety.readiness import NotReadyError, Requirement
from hydro_core.cli.console import UserError
from hydro_core.files import site
from hydro_core.process.endings import undisturbed
from hydro_policy.evaluation.controllers import Controller
from hydro_policy.evaluation.runner import Rest, TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.nodes.evaluation import box_mismatch, evaluate_on, required_gain_range
from hydro_policy.nodes.graph.announcements import CompanionWatch, companion_output
from hydro_policy.nodes.graph.node import GraphNode
from hydro_policy.nodes.startup.companions import NO_FILTER, PlantOptions, commands, guard_range, recorder_arguments
from hydro_policy.supervision.override import GainOverride
from hydro_policy.supervision.plant_supervisor import corrections
from hydro_policy.task.cases import EvaluationSettings
from hydro_policy.task.mdp import GainRange
from hydro_sim.files.pairing import BoxIdentity

TRUTH = "truth.yaml"
"""What the emulated bench of a site is made of; where there is none, the emulator's own."""
EMULATED = "emulator"
PORT_WITHIN = 60.0
"""s, for the emulator's port."""
ENDS_WITHIN = 30.0
"""s, for a recorder to complete its recording."""


class SitePlant:
    """The plant of a site; use as context manager.

    Parameters
    ----------
    folder
        Of the site.
    plant
        The serial port of its box, or `EMULATED`.
    rearm
        Whether it is armed without a person.
    log
        Takes what its processes say, warnings of which are also shown.
    """

    def __init__(self, folder: Path, plant: str, *, rearm: bool, log: IO[str]) -> None:
        self.base_gains: tuple[float, float] | None = None
        """K_p [1/s], K_i [1/s^2] that the box has to have; None: any."""
        self._folder, self._emulated, self._rearm, self._log = folder, plant == EMULATED, rearm, log
        self._port = str(folder / "port") if self._emulated else plant
        self._emulator: Companion | None = None
        self._bridge: Companion | None = None
        self._node: GraphNode | None = None
        self._serves: list[tuple[str, str, list[str]]] = []  # command line of the bridge
        self._stack, self._connection = ExitStack(), ExitStack()

    def __enter__(self) -> SitePlant:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        with self._stack:
            self.disconnect()

    def disconnect(self) -> None:
        """End bridge and node: the port is free."""
        self._connection.close()
        self._bridge, self._node, self._serves = None, None, []

    def free_port(self) -> str:
        """Disconnect, and return the port; an emulated one appears at the first call.

        Raises UserError: the emulator does not start.
        """
        self.disconnect()
        if not self._emulated or self._emulator is not None:
            return self._port
        port, truth = Path(self._port), self._folder / TRUTH
        port.unlink(missing_ok=True)  # of one that was killed
        words = ["--link", self._port, "--bench", str(self._folder / site.BENCH)]
        words += ["--truth", str(truth)] if truth.is_file() else []
        self._emulator = self._stack.enter_context(Companion("hydro_sim", "emulator", words, output=self._log.write))
        end = time.monotonic() + PORT_WITHIN
        while not port.exists():
            if not self._emulator.running or time.monotonic() > end:
                reason = self._emulator.last_line.removeprefix("error: ")
                raise UserError(f"the emulator does not start: {reason}")
            time.sleep(0.1)
        return self._port

    def rest(self, recording: Path, seconds: float) -> None:
        """Record so many seconds at rest.

        Raises NotReadyError, CompanionError: as `GraphNode.run_session`; KeyboardInterrupt: a signal arrived.
        """
        options = self._options(NO_FILTER)
        node = self._connected(options, required_gain_range([]))
        with self._recorded(node, options, recording) as recorder:
            if not node.run_session(
                Rest(seconds, node.supervisor(recorder, rearm=False, filtered=False)), lambda: None
            ):
                raise KeyboardInterrupt

    def compare(
        self,
        controllers: Sequence[Controller],
        settings: EvaluationSettings,
        recording: Path,
        *,
        words: Sequence[str] = NO_FILTER,
        learned: bool = False,
    ) -> TrialRunner[Comparison]:
        """Run these controllers and the compensated law, if `learned` also with the learned residual, and record it.

        `words`: of the filter's command line. Raises: as `rest`, and NotReadyError where the box has not that law.
        """
        options = self._options(words)
        node = self._connected(options, required_gain_range(controllers))
        if node.law is None:
            raise NotReadyError(NOT_OFFERED)
        with self._recorded(node, options, recording) as recorder:
            filtered = options.filter != NO_FILTER
            needed = (corrections(lambda: node.corrected),) if filtered else ()
            watch = node.supervisor(recorder, *needed, rearm=self._rearm, filtered=filtered)
            results = evaluate_on(node, controllers, watch, settings=settings, learned=learned)
            if not results.finished:
                raise KeyboardInterrupt
        return results

    def _options(self, words: Sequence[str]) -> PlantOptions:
        return PlantOptions(plant="bench", port=self._port, bench=self._folder / site.BENCH, filter=tuple(words))

    def _connected(self, options: PlantOptions, reach: GainRange) -> GraphNode:
        """Return the node that commands this plant, behind a bridge with this filter, for this range of gains."""
        serves = commands(options, reach, self._folder)
        if self._node is not None and serves == self._serves:
            return self._node
        self.free_port()
        node = GraphNode("commission")
        self._connection.callback(leave_graph, node)
        node.announcer.log = self._log
        for package, executable, arguments in serves:
            output = companion_output(node.announcer.keep)
            self._bridge = self._connection.enter_context(Companion(package, executable, arguments, output=output))
        node.companions = self._watched()
        node.box_fault = partial(box_mismatch, BoxIdentity.of_file(options.bench, self.base_gains))
        if not node.wait_for_plant(law=True) or node.box is None:
            raise KeyboardInterrupt
        node.override = GainOverride(guard_range(reach), node.override.say, node.box.base_gains)
        if options.filter != NO_FILTER:
            node.listen_to_corrections()
        if not self._rearm:
            node.listen_for_enter()
        self._node, self._serves = node, serves
        return node

    def _watched(self, *others: Companion) -> CompanionWatch:
        return CompanionWatch([one for one in (self._emulator, self._bridge, *others) if one is not None])

    @contextmanager
    def _recorded(self, node: GraphNode, options: PlantOptions, folder: Path) -> Iterator[Requirement]:
        """Record what follows; the plant is left disarmed, whatever happens, before the recording ends."""
        with ExitStack() as quiet, ExitStack() as stack:
            words = ["--realtime", *recorder_arguments(options, folder)]
            recorder = Companion("hydro_bridge", "recorder", words, output=companion_output(node.announcer.keep))
            stack.callback(recorder.stop, ENDS_WITHIN)
            node.companions = self._watched(recorder)
            stack.callback(node.disarm)
            stack.callback(quiet.enter_context, undisturbed())  # first of all: a second Ctrl-C waits
            yield RecorderWatch(node, folder, recorder).requirement
