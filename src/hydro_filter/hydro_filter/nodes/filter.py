# SPDX-License-Identifier: Apache-2.0
"""The filter node: one Correction for every BenchState, even if zero, so that silence means failure.

ros2 run hydro_filter filter [--metric FILE] [--model FILE] [--bench FILE] [--bypass]

States are answered in order, each once, with the epoch of the session (/hydro/authority). States of two plants are not
answered, and none while another filter publishes. After a delay, states older than `state_age_max` are answered STALE
without being acted upon. The filter simulates the valve's spool from sample to sample, and restarts after missing
samples.

If the model does not fit this bench, every answer is MISMATCH: nothing is corrected, and the plant narrows the gains.
The filter finds that by its own predictions, or by the box's description (/hydro/box), if that assumes another bench
than the filter was started for.

New files of metric, model and bench replace the old ones while the plant is disarmed, if they match one another; until
they are compiled the old ones answer.

While the box runs the compensated law, a state is answered with the law of the same sequence (/hydro/law_state), STALE
without. If the metric has no certificate for the active law, every answer is BYPASSED.

In the process of a plant (`filtered_plant`) the filter subscribes to no samples: the plant hands them over, with their
law and the session's epoch, and gets the correction back.

Ages are by the machine's clock. A state of a plant that goes by its own clock (PACED) has none: that plant waits for
this filter, or counts the age itself. A repeated state gets the same answer again.
"""

from __future__ import annotations

import concurrent.futures
import signal
import threading
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from hydro_bridge.arguments import ros_arguments
from hydro_bridge.plant_clock import FILTER_WINDOW
from hydro_bridge.ros.acknowledgement import SampleAcknowledger
from hydro_bridge.ros.diagnostics import (
    DiagnosticsPublisher,
    Level,
    Status,
    publisher_conflicts,
    with_publisher_conflicts,
)
from hydro_bridge.ros.messages import (
    CORRECTION_CODEC,
    LAW_STATE_CODEC,
    STATE_CODEC,
    law_state_from_message,
    subscribe,
    subscribe_to_box,
)
from hydro_bridge.ros.node import declare_parameters, request_realtime, run_node
from hydro_bridge.ros.topics import AUTHORITY, CORRECTION, LAW_STATE, STATE, create_publisher, create_subscription
from hydro_bridge.safety.box_info import BoxDescription
from hydro_core.cli.console import UserError, command
from hydro_core.files.site import RECOMMISSION_HINT
from hydro_core.process import termination
from hydro_core.process.realtime import Latency
from hydro_core.signals import PLANT_FIELDS, CorrectionStatus, Flag, Law
from hydro_filter.controller.factory import FilterChoice, parse_args
from hydro_filter.controller.loop_filter import LoopFilter, LoopFilterSettings, Result
from hydro_filter.model.sample import Sample
from hydro_msgs.msg import Authority
from hydro_sim.files.pairing import raise_if_mismatched
from hydro_sim.model.bench import Bench

WAIT_NOTICE_DELAY = 2.0
"""s after which a wait is explained to the user."""
DISCOVERY_TIME = 0.5
"""s after the start within which another filter is discovered, if there is one."""
LAW_VALID_SAMPLES = 50
"""Number of samples for which a LawState message stays valid, as one may be lost."""
_PLANT_VALUES = slice(2, 2 + len(PLANT_FIELDS))  # of a state's record, behind stamp and sequence


@dataclass
class FilterStatistics:
    """Statistics since the node started."""

    statuses: Counter[CorrectionStatus] = field(default_factory=Counter)
    missing: int = 0
    """Missing samples, by gaps in the sequence."""
    work: Latency = field(default_factory=Latency)
    """Time from the callback's begin to the correction's publication."""
    age: Latency = field(default_factory=Latency)
    """Time from a sample's stamp to the publication of its correction."""


class LoadedFilter(NamedTuple):
    """A choice of files, with the filter made from them."""

    choice: FilterChoice
    description: dict[str, str]
    """Description of the files, for logs and /diagnostics."""
    filter: LoopFilter

    @classmethod
    def load(cls, choice: FilterChoice, settings: LoopFilterSettings) -> LoadedFilter:
        """Create the filter of a choice and compile its models at first use; raises as `FilterChoice.make`."""
        return cls(choice, choice.describe(), choice.make(settings))

    def __str__(self) -> str:
        return "; ".join(f"{name}: {value}" for name, value in self.description.items())


class FileWatch:
    """Reloads a choice's files in a thread, once they have changed and then stayed unchanged for a poll."""

    def __init__(self, choice: FilterChoice, settings: LoopFilterSettings) -> None:
        self._choice, self._settings = choice, settings
        self._read = self._seen = choice.modification_times
        """Modification times of the files at their last reading, and at the last poll."""
        self._reading: concurrent.futures.Future[LoadedFilter] | None = None

    def poll(self, *, armed: bool) -> LoadedFilter | None:
        """Return the reloaded filter once it is ready; None: no new files, or the plant is armed.

        Raises ValueError, OSError, UserError: one cannot be read, or they do not belong together (PairingError).
        """
        if self._reading is not None:
            if armed or not self._reading.done():
                return None
            reading, self._reading = self._reading, None
            self._choice = (loaded := reading.result()).choice
            return loaded
        before, self._seen = self._seen, self._choice.modification_times
        if not armed and self._seen != self._read and self._seen == before:
            self._read, self._reading = self._seen, concurrent.futures.Future()
            threading.Thread(target=self._load, args=[self._reading], daemon=True).start()
        return None

    def _load(self, reading: concurrent.futures.Future[LoadedFilter]) -> None:
        try:
            file = self._choice.bench_file
            choice = replace(self._choice, bench=Bench.load(file) if file else self._choice.bench)
            raise_if_mismatched(choice.pairing_error())
            reading.set_result(LoadedFilter.load(choice, self._settings))
        except Exception as error:
            reading.set_exception(error)


class FilterNode(Node):
    """Node that runs the filter on each BenchState and publishes a Correction for it.

    `choice`: filter to run. `settings`: defaults of the ROS parameters. `realtime`: request SCHED_FIFO. `in_process`: a
    plant in this process hands over its samples (`hydro_bridge.nodes.plant_node.Corrector`), and decides on scheduling.
    """

    def __init__(
        self, choice: FilterChoice, settings: LoopFilterSettings, *, realtime: bool = False, in_process: bool = False
    ) -> None:
        super().__init__("filter")
        begun = time.monotonic()
        self.settings = declare_parameters(self, settings)
        self._statistics, self._in_process, self._armed = FilterStatistics(), in_process, False
        self._reported: Counter[CorrectionStatus] = Counter()
        """Statuses when they were last reported."""
        self._lock = threading.Lock()  # held while a sample is answered, which may be in a plant's thread
        self._loaded, self._files = self._load(choice), FileWatch(choice, self.settings)
        self._box: BoxDescription | None = None
        self._identity: object = None
        """The box's description and assumed bench, once received."""
        self._foreign = ""
        """Why the files do not fit this bench, by the plant's description; empty: they do."""
        self._mismatch = ""
        """Why every answer is MISMATCH; empty: the model fits."""
        self._law: Any = None  # record of the last one, while another law than the paper's acts
        self._waiting: Any = None  # record of a state that waits for its law
        self._last: Any = None  # record of the last correction
        self._epoch = 0
        self._publisher: Publisher | None = None  # None as long as another filter answers
        self._answers: SampleAcknowledger | None = None
        self._states: Subscription | None = None
        self._diagnostics = DiagnosticsPublisher(self, self._status)
        self._advice = "" if realtime or in_process else ", or start it with --realtime"
        scheduling = "in the plant's process" if in_process else request_realtime(realtime=realtime)
        rate = f"contraction rate {self.settings.contraction_rate:g} 1/s"
        self.get_logger().info(f"{self._loaded}; {rate}, {scheduling}")
        if self.settings.bypass:
            self.get_logger().error("BYPASSED: nothing is corrected; plants that require the filter stay at base gains")
        self._boxes = subscribe_to_box(self, self._on_box)
        time.sleep(max(0.0, begun + DISCOVERY_TIME - time.monotonic()))
        self._start_publishing()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(DISCOVERY_TIME, self._start_publishing, clock=steady)
        self.create_timer(1.0, self._poll_files, clock=steady)  # new files are read once they are unchanged for as long
        if in_process:
            return
        self._laws = subscribe(self, LAW_STATE, LAW_STATE_CODEC, self._on_law_state)
        self._authority = create_subscription(self, AUTHORITY, self._on_authority)
        self._states = subscribe(self, STATE, STATE_CODEC, self._on_state)  # last: states are queued from now on
        if self._publisher is not None:
            self._answers = SampleAcknowledger(self, FILTER_WINDOW, self._states)

    def _load(self, choice: FilterChoice) -> LoadedFilter:
        """Compile now, not at the first sample, and report it: until then nothing is corrected."""
        log, begin = self.get_logger().info, time.monotonic()
        notice = "compiling the filter: once, for up to a minute; until then there are no corrections"
        late = threading.Timer(WAIT_NOTICE_DELAY, log, [notice])
        late.daemon = True
        late.start()
        try:
            with termination.handled_by(signal.SIG_DFL):  # nothing runs yet, and the compiler ends untidily
                loaded = LoadedFilter.load(choice, self.settings)
        finally:
            late.cancel()
        if (taken := time.monotonic() - begin) > WAIT_NOTICE_DELAY:
            log(f"compiled in {taken:.0f} s")
        return loaded

    def _start_publishing(self) -> None:
        if self._publisher is not None:
            return
        if others := self.get_publishers_info_by_topic(CORRECTION):
            waits = "this filter waits until it ends"
            if self._in_process:
                waits = "its corrections do not reach this plant, end it"
            self.get_logger().warning(f"{others[0].node_name} answers already: {waits}", throttle_duration_sec=10.0)
            return
        self._publisher = create_publisher(self, CORRECTION)
        if self._states is not None:
            self._answers = SampleAcknowledger(self, FILTER_WINDOW, self._states)

    def _poll_files(self) -> None:
        """Take new files over, if the plant is disarmed or gone and they have been written.

        A plant that is silent is not gone: its samples may wait for this process, which a busy machine holds up.
        """
        gone = self._states is not None and self._states.get_publisher_count() == 0
        try:
            if (loaded := self._files.poll(armed=self._armed and not gone)) is None:
                return
        except (ValueError, OSError, UserError) as error:
            self.get_logger().warning(f"the new files are not taken over: {error}")
            return
        with self._lock:
            self._loaded, self._mismatch = loaded, ""
        self._foreign = loaded.choice.box_mismatch(self._box) if self._box else ""
        self.get_logger().info(f"new files are taken over: {loaded}")

    def correct(self, state: Any, law: Any, epoch: int) -> Any:
        """Correct a sample handed over by a plant; see `hydro_bridge.nodes.plant_node.Corrector`."""
        self._epoch = epoch
        if law is not None:
            self._on_law_state(law)
        self._on_state(state)
        return self._last

    def publish(self) -> None:
        """Publish the last correction; see `hydro_bridge.nodes.plant_node.Corrector`."""
        if self._publisher is not None and self._last is not None:
            self._publisher.publish(CORRECTION_CODEC.pack(*self._last))

    def _on_authority(self, message: Authority) -> None:
        if self._authority.get_publisher_count() < 2:  # else the plant repeats it once it is alone
            self._epoch = message.epoch

    def _on_state(self, message: Any) -> None:
        self._armed = bool(message.flags & Flag.ARMED)
        if self._states is not None and self._states.get_publisher_count() > 1:
            return  # which of them is the plant's? The plant holds its base gains, and disarms
        if message.flags & Flag.PACED and self._last is not None and message.sequence == self._last.sequence:
            self.publish()
            return
        if self._waiting is not None:  # its law never came
            self._answer(self._waiting)
        law = self._recent_law(message.sequence)
        if law is None or law.sequence == message.sequence or not self._armed or self._bypass_reason(law):
            self._answer(message)
        else:
            self._waiting = message

    def _on_law_state(self, message: Any) -> None:
        if self._law is None:
            reason = self._bypass_reason(message)
            if message.law != Law.COMPENSATED:
                self.get_logger().warning(f"BYPASSED, nothing is corrected: {reason}")
            else:
                bypassed = f": BYPASSED, {reason}" if reason else ""
                self.get_logger().info(f"the box runs the compensated law{bypassed}")
        self._law = message
        if self._waiting is not None and self._waiting.sequence == message.sequence:
            self._answer(self._waiting)

    def _bypass_reason(self, law: Any) -> str:
        """Return why nothing is decided under this law; empty: the metric is made for it."""
        if law.law != Law.COMPENSATED:
            return f"law {law.law} is unknown"
        return self._loaded.filter.missing_certificate(compensated=True)

    def _recent_law(self, sequence: int) -> Any:
        """Return the last law that is not the paper's; None if the paper's acts: the filter starts again with it."""
        law = self._law
        if law is None or (sequence - law.sequence + LAW_VALID_SAMPLES) & 0xFFFFFFFF < 2 * LAW_VALID_SAMPLES:
            return law
        self._law = None
        self._loaded.filter.reset()
        self.get_logger().info("the box runs the paper's law again: the filter starts over")
        return None

    def _answer(self, message: Any) -> None:
        self._waiting = None
        with self._lock:
            begin, contraction_filter = time.perf_counter(), self._loaded.filter
            gap = -1 if self._last is None else (message.sequence - self._last.sequence - 1) & 0xFFFFFFFF
            self._statistics.missing += gap if 0 < gap < 0x80000000 else 0  # a restarted source counts from zero
            if gap:
                contraction_filter.reset_history()
            age, law, armed = self._age(message), self._recent_law(message.sequence), message.flags & Flag.ARMED
            if law is not None and self._bypass_reason(law):
                result = Result.uncorrected(CorrectionStatus.BYPASSED)
            elif law is not None and law.sequence != message.sequence and armed:
                contraction_filter.reset_history()
                result = Result.uncorrected(CorrectionStatus.STALE)
            else:
                sample = Sample(
                    np.array(message[_PLANT_VALUES]), message.nominal_valve_current, message.reference_force,
                    message.proportional_gain, message.valve_current, message.reference_force_rate, bool(armed),
                    None if law is None else law_state_from_message(law),
                )  # fmt: skip
                result = contraction_filter.correct(sample, age)
                if contraction_filter.solver is not None and self._age(message) > self.settings.state_age_max:
                    result = Result.uncorrected(CorrectionStatus.STALE)  # the solver took too long
            delta_u, before, after, status = self._check_model(result)
            infeasible = status in (CorrectionStatus.RELAXED, CorrectionStatus.INFEASIBLE)
            self._last = CORRECTION_CODEC.record(
                message.stamp, message.sequence, delta_u, before, after, delta_u != 0.0, infeasible,
                int(status), self._epoch,
            )  # fmt: skip
            if not self._in_process:  # else the plant says when
                self.publish()
            self._statistics.statuses[status] += 1
            self._statistics.work.add(time.perf_counter() - begin)
            self._statistics.age.add(self._age(message))

    def _age(self, state: Any) -> float:
        return 0.0 if state.flags & Flag.PACED else 1e-9 * (time.time_ns() - state.stamp)

    def _check_model(self, result: Result) -> Result:
        """Return the result, or MISMATCH if the model does not fit; a change of this is reported at once."""
        if result.status is CorrectionStatus.BYPASSED:
            self._mismatch = ""  # nothing is known of it
            return result
        if self._foreign and result.status is not CorrectionStatus.NAN:
            result = Result.uncorrected(CorrectionStatus.MISMATCH)
        if (result.status is CorrectionStatus.MISMATCH) == bool(self._mismatch):
            return result
        seen = self._loaded.filter.mismatch
        before, self._mismatch = self._mismatch, self._foreign or (f"{seen}; {RECOMMISSION_HINT}" if seen else "")
        if self._mismatch and not before:
            self.get_logger().error(f"MISMATCH, no corrections are made and the gains are limited: {self._mismatch}")
        elif before and not self._mismatch:
            self.get_logger().warning(f"the model fits this bench again; before: {before}")
        return result

    def _on_box(self, box: BoxDescription) -> None:
        """Process a box's description, which may announce another bench from now on."""
        self._box, self._foreign = box, self._loaded.choice.box_mismatch(box)
        if self._boxes.get_publisher_count() > 1:  # one of them is foreign, or has just died
            return
        identity = box.info, box.bench_digest
        if self._identity not in (None, identity):  # findings are of the previous bench; a bench at rest gives none
            self.get_logger().warning("another box is connected: what was known about its model is dropped")
            with self._lock:
                self._loaded.filter.reset()
                self._mismatch = ""
        self._identity = identity

    def _status(self) -> Status:
        seen = self._statistics
        counts, self._reported = seen.statuses - self._reported, seen.statuses.copy()
        worst_first = [status for status in reversed(CorrectionStatus) if status is not CorrectionStatus.PASS]
        parts = [f"{counts[status]} {status.name.lower()}" for status in worst_first if counts[status]]
        told = f"{counts.total()} corrections" + (f": {', '.join(parts)}" if parts else "")
        level, late = Level.OK, counts[CorrectionStatus.STALE]
        if not counts:
            level, told = Level.STALE, "no states"
        elif counts[CorrectionStatus.NAN] or counts[CorrectionStatus.INFEASIBLE] or late > 0.01 * counts.total():
            level = Level.WARN
            busy = f"; the machine is busy: close other programs{self._advice}" if late else ""
            self.get_logger().warning(told + busy, throttle_duration_sec=30.0)
        if self.settings.bypass:
            level, told = Level.ERROR, f"BYPASSED, nothing is corrected; {told}"
            self.get_logger().error(told, throttle_duration_sec=10.0)
        elif self._law is not None and (reason := self._bypass_reason(self._law)):
            level = Level.OK if self._law.law == Law.COMPENSATED else Level.WARN
            told = f"BYPASSED, the box does not run the paper's law: {reason}; {told}"
        if self._mismatch:
            level, told = Level.ERROR, f"MISMATCH, nothing is corrected: {self._mismatch}; {told}"
        values: dict[str, object] = {**self._loaded.description}
        values |= {status.name.lower(): seen.statuses[status] for status in CorrectionStatus}
        values["missing_states"] = seen.missing
        for name, latency in (("work", seen.work), ("age", seen.age)):
            for percent, key in ((50.0, "p50"), (99.0, "p99"), (99.9, "p99_9")):
                values[f"{name}_{key}_ms"] = 1e3 * latency.percentile(percent)
        values["fits"] = f"no: {self._mismatch}" if self._mismatch else "yes"
        crowd = publisher_conflicts(self, STATE)
        if not crowd and self._publisher is None:
            crowd = "another filter answers: this one waits"
        return with_publisher_conflicts(Status(level=level, message=told, values=values), crowd)


@command(ValueError)
def main() -> None:
    """Entry point."""
    own, ros = ros_arguments()
    choice, settings, asked = parse_args(own, ros)
    choice.describe()  # a missing file is refused before ROS starts
    run_node(lambda: FilterNode(choice, settings, realtime=asked.realtime), ros, [asked])
