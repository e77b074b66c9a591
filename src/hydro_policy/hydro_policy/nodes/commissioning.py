# SPDX-License-Identifier: Apache-2.0
"""The gates of a commissioning, in order. Each returns what it found, or raises GateError with the reason.

    link        conformance at rest, then ten seconds of samples: rate, loss, latency; box against bench file
    sensors     the same samples: noise, plausibility, one force against the pressures
    signs       a fifth of the amplitude, slowly, more where an overlap holds it: which reading follows which
    gains       half of the amplitude, then all of it, at 1 Hz
    excitation  two recordings, one of them held out; again where samples were lost or commands late
    diagnosis   what the bench file leaves out
    metric      of the bench as found, with its certified range; on the held-out recording its filter says no MISMATCH
    policy      pretrained on the bench as found, with --policy
    controllers behind the filter: base gains, fixed gains, the compensated law, the learned residual on it, the policy
    comparison  the best of them is adopted

Everything moves under the compensated law without a filter until there is one of this bench: it tracks with 0.3 to 2.5
times the valve's gain believed (safety.md). What runs are executables, as processes of a `Site`, whose JSON is read.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np

from hydro_bridge.bags.recording import read_bag, read_messages
from hydro_bridge.bags.types import RecordingError
from hydro_bridge.ros.companion import Companion
from hydro_bridge.ros.topics import BOX, BOX_LAW, DIAGNOSTICS, STATE
from hydro_core.cli.console import UserError, print_above_progress
from hydro_core.files import site
from hydro_core.files.site import RECOMMISSION_HINT
from hydro_core.signals import Flag, StateArray
from hydro_filter.controller.loop_filter import loop_filter
from hydro_filter.metric import ScheduledMetric
from hydro_policy.commissioning import checks
from hydro_policy.commissioning.record import GateError, GateSkipped, Record, best, scored
from hydro_sim.model.bench import Bench

T = TypeVar("T")

PATIENCE = 30.0
"""s, for an executable that is asked to end: it disarms and completes its recording."""
PORT_WITHIN = 60.0
"""s, for the emulator's port, and for the first sample."""


@dataclass(frozen=True, kw_only=True)
class Site:
    """The folder of one bench, and how to run executables on it."""

    folder: Path
    record: Record
    port: str
    arm: str
    """`auto` or `ask`, as `--rearm` of `evaluate`."""
    policy: bool
    """Whether a policy is to be trained."""
    log: IO[str]
    """Output of all executables."""

    @property
    def bench(self) -> str:
        """File of what the box believes."""
        return str(self.folder / site.BENCH)

    def recording(self, name: str) -> Path:
        """Return the folder of a recording."""
        return self.folder / site.RECORDINGS / name

    def run(self, package: str, executable: str, *words: str, loud: bool = True) -> str:
        """Run an executable to its end; returns its last line.

        Its output goes into the log, and to the terminal if it is `loud`.

        Raises GateError: it did not end with status 0; the reason is its last line.
        """
        self.log.write(f"$ ros2 run {package} {executable} {' '.join(words)}\n")

        def take(line: str) -> None:
            self._keep(line)
            if loud:
                print_above_progress(line.rstrip("\n"))

        running = Companion(package, executable, words, output=take, keys=True)
        try:
            status = running.process.wait()
        except BaseException:
            running.stop(PATIENCE)
            raise
        said = running.last_line
        running.stop()
        if status:
            raise GateError(f"{executable}: {said.removeprefix('error: ') or f'ended with status {status}'}")
        return said

    def start(self, stack: ExitStack, package: str, executable: str, *words: str) -> Companion:
        """Start an executable that `stack` ends."""
        return stack.enter_context(Companion(package, executable, words, output=self._keep))

    def _keep(self, line: str) -> None:
        """Add to the log, which is read while it grows."""
        self.log.write(line)
        self.log.flush()

    def evaluate(self, name: str, *words: str, amplitude: float) -> dict[str, Any]:
        """Run `evaluate` under the compensated law, recorded as recordings/NAME; returns its JSON.

        Parameters
        ----------
        name
            Of the recording and of the report.
        words
            Further options.
        amplitude
            Of the sines [N].
        """
        for old in (self.recording(name), self.folder / site.REPORTS / name):
            shutil.rmtree(old, ignore_errors=True)
        base = (f"{value:g}" for value in self.record.base_gains)
        self.run(
            "hydro_policy", "evaluate", "--plant", "bench", "--port", self.port, "--bench", self.bench,
            "--base-gains", *base, "--law", "compensated", "--rearm", self.arm, "--no-dashboard",
            "--record", str(self.recording(name)),
            "--runs", str(self.folder / site.REPORTS), "--name", name, *words,
            "--ros-args", "-p", f"amplitude:={amplitude:.1f}",
        )  # fmt: skip
        return read_json(self.folder / site.REPORTS / name / "evaluation.json")


TRUTH = "truth.yaml"
"""What the emulated bench of a site is made of; where there is none, the emulator's own."""


def start_emulator(stack: ExitStack, at: Site) -> None:
    """Start the emulator on the site's port for as long as `stack` holds (raises UserError where it does not start)."""
    port = Path(at.port)
    port.unlink(missing_ok=True)  # of one that was killed
    truth = at.folder / TRUTH
    known = ["--truth", str(truth)] if truth.is_file() else []
    emulator = at.start(stack, "hydro_sim", "emulator", "--link", at.port, "--bench", at.bench, *known)
    end = time.monotonic() + PORT_WITHIN
    while not port.exists():
        if not emulator.running or time.monotonic() > end:
            raise UserError(f"the emulator does not start: {emulator.last_line.removeprefix('error: ')}")
        time.sleep(0.1)


def read_json(path: Path) -> dict[str, Any]:
    """Read a result (raises GateError where there is none)."""
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise GateError(f"{path} cannot be read: {error}") from None
    return content


AT_REST = "rest"
REST = 10.0
"""s recorded at rest."""
REACH = 0.8
"""Largest amplitude over the force at which the compensated law cuts off: its a_0 is up to 1.25."""
ATTEMPTS = 3
TRAINING = ("--frequencies", "0.5", "1", "2", "--multisine", "--steps")
HELD_OUT = ("--frequencies", "0.7", "1.5")
COMPARED = ("--frequencies", "0.5", "1", "1.5", "2")
POLICY = "policy"
"""Folder of the pretrained policy."""
WATCH = (
    f"The filter says MISMATCH where the bench is no longer the one that was diagnosed: {RECOMMISSION_HINT}.",
    "Errors are of the load cell's reading: where its amplifier lags, the specimen feels more.",
)
FIXED_SHARES = (0.5, 0.9)
"""K_p of the fixed gains that are compared, over the largest certified."""


@dataclass(frozen=True, kw_only=True)
class Gate:
    """One gate."""

    name: str
    run: Callable[[Site], str]
    files: tuple[str, ...]
    """Files and folders of the site that it reads and writes."""
    plant: bool = True
    """Whether it needs the plant."""


def _recorded(*names: str) -> tuple[str, ...]:
    return tuple(f"{site.RECORDINGS}/{name}" for name in names)


def link(at: Site) -> str:
    """See the module."""
    report = at.folder / site.REPORTS / "conformance.json"
    report.unlink(missing_ok=True)
    words = ("--port", at.port, "--bench", at.bench, "--json", str(report))
    try:
        at.run("hydro_bridge", "conformance", *words, loud=False)
    except GateError:
        if not report.is_file():
            raise
    wrong = [f"{row['case']}: {row['found']}" for row in read_json(report)["rows"] if row["result"] == "FAIL"]
    if wrong:
        raise GateError("the box does not keep the protocol: " + "; ".join(wrong))
    folder = at.recording(AT_REST)
    shutil.rmtree(folder, ignore_errors=True)
    with ExitStack() as stack:
        at.start(stack, "hydro_bridge", "recorder", "--realtime", "--out", str(folder))
        at.start(stack, "hydro_bridge", "bridge", "--realtime", "--port", at.port, "--bench", at.bench)
        end = time.monotonic() + REST + PORT_WITHIN
        time.sleep(REST)
        while not _lasts(folder, REST) and time.monotonic() < end:  # a busy machine starts them late
            time.sleep(1.0)
    states = _states(folder)
    status = {e.key: e.value for _, m in read_messages(folder, DIAGNOSTICS) for s in m.status for e in s.values
              if s.name == "bridge"}  # fmt: skip
    if status.get("box differs", "no") != "no":
        raise GateError(f"the box is not what its bench file says: {status['box differs']}")
    rate, lost = checks.line(states, REST)
    told = status.get("command out to confirmation in", "not told")
    return f"{rate:.0f} samples/s, {100 * lost:.2g} % lost; command and its answer: {told}"


def sensors(at: Site) -> str:
    """See the module."""
    bench = Bench.load(at.bench)
    states = _states(at.recording(AT_REST))
    noise, off = checks.sensors(states, bench)
    box = next(iter(read_messages(at.recording(AT_REST), BOX)))[1]
    at.record.base_gains = [float(box.base_kp), float(box.base_ki)]
    if not at.record.amplitude:
        at.record.amplitude = bench.size.force
    law = next(iter(read_messages(at.recording(AT_REST), BOX_LAW)))[1]
    most = REACH * float(law.reference_max)
    if law.offered and at.record.amplitude > most:
        raise GateError(f"--amplitude {at.record.amplitude:.0f}: this box's force law reaches {most:.0f} N")
    told = (f"{name} {value:.2g}" for name, value in noise.items())
    creep = checks.creep(states)
    return f"noise {', '.join(told)}; hydraulic force {off:.1f} N off the pressures; load force creeps {creep:.2g} N/s"


def signs(at: Site) -> str:
    """See the module."""
    for share in (0.2, 0.5, 1.0):
        _moved(at, "signs", "--frequencies", str(checks.SLOW), amplitude=share * at.record.amplitude)
        if not checks.held(_armed(at.recording("signs"))):
            break
    found = checks.signs(_armed(at.recording("signs")), Bench.load(at.bench))
    return "correlations " + ", ".join(f"{name} {value:.2f}" for name, value in found.items())


def gains(at: Site) -> str:
    """See the module."""
    found = []
    for share in (0.5, 1.0):
        amplitude = share * at.record.amplitude
        rmse = _moved(at, "gains", "--frequencies", "1", amplitude=amplitude)
        found.append(f"{rmse:.2f} N at {amplitude:.0f} N")
    checks.tracking(_armed(at.recording("gains")), 1.0)
    return f"the compensated law tracks 1 Hz with {', '.join(found)}"


def excitation(at: Site) -> str:
    """See the module."""
    told = []
    for name, words in (("training", TRAINING), ("held_out", HELD_OUT)):
        _, worst = _whole(at, name, partial(_moved, at, name, *words, amplitude=at.record.amplitude))
        told.append(f"{name} {100 * worst:.2g} %")
    return f"lost or commanded late: {', '.join(told)}"


def diagnosis(at: Site) -> str:
    """See the module."""
    out = at.folder / site.REPORTS / "diagnosis"
    training, held_out = (str(at.recording(name)) for name in ("training", "held_out"))
    words = (training, "--holdout", held_out, "--bench", at.bench, "--out", str(out), "--quiet")
    at.run("hydro_diagnosis", "diagnose", *words)
    report = read_json(out / "report.json")
    at.record.causes = report["effects"]
    if report["verdict"] == "unknown":
        places = "; ".join(place["sentence"] for place in report["location"])
        raise GateError(f"the bench differs from its file by what has no name: {places}")
    (at.folder / site.METRIC).unlink(missing_ok=True)  # of the model before: the next gate may be interrupted
    shutil.copyfile(out / site.MODEL, at.folder / site.MODEL)
    ids = ", ".join(cause["id"] for cause in report["effects"]) or "no cause"
    return f"{report['verdict']}: {ids}"


def metric(at: Site) -> str:
    """See the module."""
    out = at.folder / site.METRIC
    held_out = at.recording("held_out")
    words = ("--model", str(at.folder / site.MODEL), "--bench", at.bench, "--out", str(out))
    said = at.run("hydro_filter", "learn_metric", *words, "--recording", str(held_out), "--law", "both")
    found = ScheduledMetric.load(out)
    if reason := found.validity_error(out.name):
        raise GateError(reason)
    at.record.certified_gains = {
        "paper" if one.velocity_compensation == 1.0 else "compensated": [float(one.gains[0]), float(one.gains[-1])]
        for one in found.certificates
    }
    own = loop_filter(found, Bench.load(str(at.folder / site.MODEL)), Bench.load(at.bench))
    checks.fits(_states(held_out), own)
    ranges = (f"{law} law: K_p {low:g} to {high:g} 1/s" for law, (low, high) in at.record.certified_gains.items())
    return "; ".join([*ranges, *([said] if len(at.record.certified_gains) < 2 else [])])


def policy(at: Site) -> str:
    """See the module."""
    shutil.rmtree(at.folder / POLICY, ignore_errors=True)
    if not at.policy:
        raise GateSkipped("--policy trains one in simulation")
    at.run("hydro_policy", "pretrain", "--site", str(at.folder), "--out", str(at.folder / POLICY))
    return f"pretrained on {site.MODEL}: {POLICY}/report.html"


def controllers(at: Site) -> str:
    """See the module."""
    kp, ki = at.record.base_gains
    top = at.record.certified_gains.get("paper", (kp, kp))[1]
    fixed = [(kp, ki), *((round(share * top), 3.0 * ki) for share in FIXED_SHARES if share * top > kp)]
    chosen = [word for pair in fixed for word in ("--fixed", *(f"{value:g}" for value in pair))]
    trained = at.folder / POLICY
    chosen += ["--policy", str(trained)] if trained.is_dir() else []
    chosen += ["--learned-residual", *COMPARED, *_filter(at)]
    content = at.evaluate("controllers", *chosen, amplitude=at.record.amplitude)
    worst = checks.disturbed(content)
    if worst > checks.LOST_MAX:
        late = f"{100 * worst:.1f} % of the samples were lost or commanded late"
        raise GateError(f"{late}, though runs were repeated: end other work")
    found = scored(content)
    rows = {name: entry for name, entry in found.items() if name.startswith("fixed")}
    missing: dict[str, Any] = {"name": "policy", "rmse": {}, "trips": 0}
    first = f"fixed ({kp:g}, {ki:g})"
    at.record.comparison = {
        "best_fixed": rows[best(rows) or first],
        "base": rows[first],
        "compensated": found["compensated"],
        "residual": found["compensated, learned residual"],
        "policy": found.get(f"policy {trained.name}", missing),
    }
    if found["compensated"]["trips"]:
        raise GateError("the compensated law was stopped behind this bench's filter: see reports/controllers")
    at.record.watch = list(content["warnings"])
    stopped = sum(entry["trips"] for entry in found.values())
    return f"{len(content['runs'])} runs, {stopped} of them stopped, {100 * worst:.2g} % lost or commanded late"


def comparison(at: Site) -> str:
    """See the module."""
    entries = at.record.comparison
    stood = {key: entry["name"] for key, entry in entries.items() if checks.still(entry, at.record.amplitude)}
    at.record.adopted = best({key: entry for key, entry in entries.items() if key not in stood})
    names = ", ".join(dict.fromkeys(stood.values()))
    left_out = f"; left out: {names}: the load force hardly followed, as if the piston stood" if stood else ""
    if not at.record.adopted:
        raise GateError(f"no controller completed every reference{left_out}")
    at.record.watch = list(dict.fromkeys([*at.record.watch, *WATCH]))
    name = at.record.comparison[at.record.adopted]["name"]
    return f"{name} is the best{left_out}"


GATES = (
    Gate(name="link", run=link, files=(site.BENCH, *_recorded(AT_REST))),
    Gate(name="sensors", run=sensors, files=(site.BENCH, *_recorded(AT_REST)), plant=False),
    Gate(name="signs", run=signs, files=(site.BENCH, *_recorded("signs"))),
    Gate(name="gains", run=gains, files=(site.BENCH, *_recorded("gains"))),
    Gate(name="excitation", run=excitation, files=_recorded("training", "held_out")),
    Gate(name="diagnosis", run=diagnosis, files=(*_recorded("training", "held_out"), site.MODEL), plant=False),
    Gate(name="metric", run=metric, files=(site.BENCH, site.MODEL, site.METRIC, *_recorded("held_out")), plant=False),
    Gate(name="policy", run=policy, files=(site.MODEL, POLICY), plant=False),
    Gate(name="controllers", run=controllers, files=(site.MODEL, site.METRIC, *_recorded("controllers"))),
    Gate(name="comparison", run=comparison, files=(f"{site.REPORTS}/controllers/evaluation.json",), plant=False),
)
NAMES = tuple(gate.name for gate in GATES)


def _filter(at: Site) -> tuple[str, str]:
    """Return the option that starts this site's filter."""
    return "--filter", f"--model {at.folder / site.MODEL} --metric {at.folder / site.METRIC}"


def _moved(at: Site, name: str, *words: str, amplitude: float) -> float:
    """Move under the compensated law without a filter; returns the largest RMSE [N] (raises GateError at a stop)."""
    content = at.evaluate(name, *words, "--filter", "none", amplitude=amplitude)
    for run in content["runs"]:
        if run["stopped"]:
            raise GateError(f"stopped at {run['case']}, {amplitude:.0f} N: {run['stopped']}")
    return max(float(run["rmse"]) for run in content["runs"])


def _whole(at: Site, name: str, run: Callable[[], T]) -> tuple[T, float]:
    """Run until few samples of its recording were lost or commanded late; returns its result and their share."""
    for _ in range(ATTEMPTS):
        result = run()
        worst = checks.unusable(_armed(at.recording(name)))
        if worst <= checks.LOST_MAX:
            return result, worst
    raise GateError(f"{100 * worst:.1f} % of {name} were lost or commanded late, {ATTEMPTS} times: end other work")


def _states(folder: Path) -> StateArray:
    try:
        return read_bag(folder, (STATE,)).state
    except RecordingError as error:
        raise GateError(str(error)) from None


def _lasts(folder: Path, seconds: float) -> bool:
    """Return whether a recording, which may not have ended, has samples of so many seconds."""
    try:
        return float(np.ptp(read_bag(folder, (STATE,)).state["time"])) >= seconds
    except (RecordingError, ValueError):  # no sample yet
        return False


def _armed(folder: Path) -> StateArray:
    states = _states(folder)
    armed = states[states["flags"] & Flag.ARMED != 0]
    if len(armed) < 100:
        raise GateError(f"{folder} was not armed")
    return armed
