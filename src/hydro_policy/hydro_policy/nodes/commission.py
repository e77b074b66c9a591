# SPDX-License-Identifier: Apache-2.0
"""Commissions a bench: from the cable to a compared controller behind a filter of this bench, gate by gate.

ros2 run hydro_policy commission --port /dev/ttyUSB0 --bench own.yaml --site own
ros2 run hydro_policy commission --plant emulator --site emulated
ros2 run hydro_policy commission --site own                       # goes on at the first gate that has not passed
ros2 run hydro_policy commission --site own --again               # after a change of spring, supply, oil or valve
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hydro_bridge.bags import RecordingError
from hydro_bridge.bags.recording import read_bag, read_messages
from hydro_bridge.ros.companion import CompanionError
from hydro_bridge.ros.node import running_ros
from hydro_bridge.ros.topics import BOX, BOX_LAW, DIAGNOSTICS, STATE
from hydro_bridge.safety.readiness import NotReadyError
from hydro_core.cli.console import UserError, bounded_number, command, make_parser, writable_folder
from hydro_core.files import bench_digest, site
from hydro_core.files.site import RECOMMISSION_HINT
from hydro_core.signals import Flag, StateArray
from hydro_filter.controller.loop_filter import loop_filter
from hydro_filter.metric import ScheduledMetric
from hydro_policy.commissioning import checks
from hydro_policy.commissioning.record import (
    FAILED,
    PASSED,
    SKIPPED,
    GateError,
    GateSkipped,
    Record,
    best,
    controller_scores,
    digests,
)
from hydro_policy.evaluation.controllers import Controller, FixedGains, policy_controller, policy_file
from hydro_policy.nodes.plant_options import require_matching_policy
from hydro_policy.nodes.site_runs import EMULATED_PLANT, TRUTH_FILE, Site
from hydro_policy.task.cases import EvaluationSettings
from hydro_sim.files.pairing import BoxIdentity, PairingError
from hydro_sim.model.bench import Bench

FIRST_REPEATED_GATE = "gains"
"""Gate from which `--again` repeats: a bench that has changed moves by half of the amplitude first."""
REST_RECORDING = "rest"
REST_TIME = 10.0  # s recorded at rest
AMPLITUDE_SHARE_MAX = 0.8
"""Largest amplitude over the force at which the compensated law cuts off: its a_0 is up to 1.25."""
ATTEMPTS_MAX = 3
LONGER = 6.0
"""Factor on the diagnosis' budget of its second attempt, where the first did not explain the bench."""
POLICY_FOLDER = "policy"  # folder of the pretrained policy


# Until this bench has a filter, all motions are under the compensated law without one: it tracks with 0.3 to 2.5 times
# the valve gain assumed (compensated_law.md). Motions are trials, run by `TrialRunner` on one plant (`site_runs`), of
# which a gate reads results and recording. Computations run as separate processes.


@dataclass(frozen=True, kw_only=True)
class Gate:
    """Gate of a commissioning: `run` returns its findings as a sentence, or raises GateError with the reason."""

    name: str
    run: Callable[[Site], str]
    files: tuple[str, ...]  # files and folders of the site that it reads and writes
    recordings: tuple[str, ...] = ()  # recordings of the site that it reads and writes


def link(at: Site) -> str:
    """Gate of the link: conformance and ten seconds at rest, for rate, loss, latency, the box's bench and laws."""
    report = at.folder / site.REPORTS_FOLDER / "conformance.json"
    report.unlink(missing_ok=True)
    words = ("--port", at.free_port(), "--bench", str(at.bench), "--json", str(report))
    try:
        at.run("hydro_bridge", "conformance", *words, echo=False)
    except GateError:
        if not report.is_file():
            raise
    rows = json.loads(report.read_text(encoding="utf-8"))["rows"]
    wrong = [f"{row['case']}: {row['found']}" for row in rows if row["result"] == "FAIL"]
    if wrong:
        raise GateError("the box does not keep the protocol: " + "; ".join(wrong))
    at.record_rest(REST_RECORDING, REST_TIME)
    folder = at.recording(REST_RECORDING)
    states = _states(folder)
    status = {e.key: e.value for _, m in read_messages(folder, DIAGNOSTICS) for s in m.status for e in s.values
              if s.name == "bridge"}  # fmt: skip
    if status.get("box differs", "no") != "no":
        raise GateError(f"the box is not what its bench file says: {status['box differs']}")
    if not next(read_messages(folder, BOX_LAW))[1].offered:
        raise GateError("the box has no compensated law: add it (protocol.md), or go on by hand (your_own_bench.md)")
    rate, lost = checks.sample_loss(states, REST_TIME)
    told = status.get("command out to confirmation in", "not told")
    return f"{rate:.0f} samples/s, {100 * lost:.2g} % lost; command and its answer: {told}"


def sensors(at: Site) -> str:
    """Gate of the sensors: noise and plausibility of each signal at rest, hydraulic force against pressures."""
    bench = Bench.load(at.bench)
    states = _states(at.recording(REST_RECORDING))
    noise, off = checks.sensor_noise(states, bench)
    box = next(read_messages(at.recording(REST_RECORDING), BOX))[1]
    at.record.base_gains = [float(box.base_kp), float(box.base_ki)]
    if not at.record.amplitude:
        at.record.amplitude = bench.size.force
    law = next(read_messages(at.recording(REST_RECORDING), BOX_LAW))[1]
    most = AMPLITUDE_SHARE_MAX * float(law.reference_max)
    if at.record.amplitude > most:
        raise GateError(f"--amplitude {at.record.amplitude:.0f}: this box's force law reaches {most:.0f} N")
    units = {"pressure_a": "Pa", "pressure_b": "Pa", "piston_position": "m"}
    told = (f"{name} {value:.2g} {units.get(name, 'N')}" for name, value in noise.items())
    found = f"noise {', '.join(told)}; hydraulic force {off:.1f} N off the pressures"
    at.record.cell_noise, at.record.drift = noise["load_force"], checks.drift_warning(states, at.record.amplitude)
    return f"{found}; " + (at.record.drift or f"load force creeps {checks.drift_rate(states):.2g} N/s")


def signs(at: Site) -> str:
    """Gate of the signs: correlations of signals in a slow motion of 0.2 times the amplitude, larger if blocked."""
    for share in (0.2, 0.5, 1.0):
        _tracking_rmse(at, "signs", EvaluationSettings(frequencies=(checks.SIGN_CHECK_FREQUENCY,)), share)
        if not checks.is_motion_blocked(_armed(at.recording("signs"))):
            break
    found = checks.channel_correlations(_armed(at.recording("signs")), Bench.load(at.bench))
    return "correlations " + ", ".join(f"{name} {value:.2f}" for name, value in found.items())


def gains(at: Site) -> str:
    """Gate of the gains: tracking of a 1 Hz sine under the compensated law, at half and at full amplitude."""
    found = []
    for share in (0.5, 1.0):
        rmse = _tracking_rmse(at, "gains", EvaluationSettings(frequencies=(1.0,)), share)
        found.append(f"{rmse:.2f} N at {share * at.record.amplitude:.0f} N")
    checks.require_tracking(_armed(at.recording("gains")), 1.0)
    return f"the compensated law tracks 1 Hz with {', '.join(found)}"


def excitation(at: Site) -> str:
    """Gate of the excitation: training and held-out recordings, repeated for lost samples or late commands."""
    told = []
    training = EvaluationSettings(frequencies=(0.5, 1.0, 2.0), multisine=True, steps=True)
    for name, settings in (("training", training), ("held_out", EvaluationSettings(frequencies=(0.7, 1.5)))):
        for _ in range(ATTEMPTS_MAX):
            _tracking_rmse(at, name, settings)
            worst = checks.unusable_share(_armed(at.recording(name)))
            if worst <= checks.LOST_SHARE_MAX:
                break
        else:
            late = f"{100 * worst:.1f} % of {name} were lost or commanded late"
            raise GateError(f"{late}, {ATTEMPTS_MAX} times: end other work")
        told.append(f"{name} {100 * worst:.2g} %")
    return f"lost or commanded late: {', '.join(told)}"


def diagnosis(at: Site) -> str:
    """Gate of the diagnosis: identification of the effects that the bench file lacks; an unknown one fails it.

    One that does not explain the bench is repeated once with `LONGER` times the budget, before it is taken.
    """
    out = at.folder / site.REPORTS_FOLDER / "diagnosis"
    training, held_out = (str(at.recording(name)) for name in ("training", "held_out"))
    words = (training, "--holdout", held_out, "--bench", str(at.bench), "--out", str(out), "--quiet")
    for seconds in (at.seconds, LONGER * at.seconds):
        shutil.rmtree(out, ignore_errors=True)
        at.run("hydro_diagnosis", "diagnose", *words, "--seconds", f"{seconds:g}")
        report = json.loads((out / "report.json").read_text(encoding="utf-8"))
        if report["verdict"] == "explained":
            break
    at.record.causes = report["effects"]
    if report["verdict"] == "unknown":
        places = "; ".join(place["sentence"] for place in report["location"])
        raise GateError(f"the bench differs from its file by what has no name: {places}")
    (at.folder / site.METRIC_FILE).unlink(missing_ok=True)  # of the model before: the next gate may be interrupted
    shutil.copyfile(out / site.MODEL_FILE, at.folder / site.MODEL_FILE)
    ids = ", ".join(cause["id"] for cause in report["effects"]) or "no cause"
    return f"{report['verdict']}: {ids}"


def metric(at: Site) -> str:
    """Gate of the metric: contraction metric of the diagnosed bench, certified gains, no MISMATCH on held-out data."""
    out = at.folder / site.METRIC_FILE
    held_out = at.recording("held_out")
    words = ("--model", str(at.folder / site.MODEL_FILE), "--bench", str(at.bench), "--out", str(out))
    said = at.run("hydro_filter", "learn_metric", *words, "--recording", str(held_out), "--law", "both")
    found = ScheduledMetric.load(out)
    if reason := found.validity_error(out.name):
        raise GateError(reason)
    at.record.certified_gains = {
        "paper" if one.velocity_compensation == 1.0 else "compensated": [float(one.gains[0]), float(one.gains[-1])]
        for one in found.all_metrics
    }
    own = loop_filter(found, Bench.load(str(at.folder / site.MODEL_FILE)), Bench.load(at.bench))
    checks.require_matching_filter(_states(held_out), own)
    ranges = (f"{law} law: K_p {low:g} to {high:g} 1/s" for law, (low, high) in at.record.certified_gains.items())
    return "; ".join([*ranges, *([said] if len(at.record.certified_gains) < 2 else [])])


def policy(at: Site) -> str:
    """Gate of the policy, with --policy: pretraining on the diagnosed bench."""
    shutil.rmtree(at.folder / POLICY_FOLDER, ignore_errors=True)
    if not at.policy:
        raise GateSkipped("--policy trains one in simulation")
    at.run("hydro_policy", "pretrain", "--site", str(at.folder), "--out", str(at.folder / POLICY_FOLDER))
    return f"pretrained on {site.MODEL_FILE}: {POLICY_FOLDER}/report.html"


def controllers(at: Site) -> str:
    """Gate of the controllers: evaluation behind the filter, of fixed gains, compensated law, residual, policy."""
    kp, ki = at.record.base_gains
    top = at.record.certified_gains.get("paper", (kp, kp))[1]
    fixed = [(kp, ki), *((round(share * top), 3.0 * ki) for share in (0.5, 0.9) if share * top > kp)]
    chosen: list[Controller] = [FixedGains(*pair, (kp, ki)) for pair in fixed]
    trained, policies = at.folder / POLICY_FOLDER, list[Path]()
    if trained.is_dir():
        require_matching_policy(trained, BoxIdentity.of_file(at.bench, (kp, ki)))
        chosen.insert(0, policy_controller(trained))
        policies.append(policy_file(trained))
    words = ("--model", str(at.folder / site.MODEL_FILE), "--metric", str(at.folder / site.METRIC_FILE))
    settings = EvaluationSettings(frequencies=(0.5, 1.0, 1.5, 2.0), amplitude=at.record.amplitude)
    results = at.compare("controllers", settings, chosen, words=words, learned=True, policies=policies)
    worst = checks.disturbed_share(results.scores)
    if worst > checks.LOST_SHARE_MAX:
        late = f"{100 * worst:.1f} % of the samples were lost or commanded late"
        raise GateError(f"{late}, though runs were repeated: end other work")
    found = controller_scores(results.scores)
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
    at.record.watch = list(results.warnings)
    stopped = sum(entry["trips"] for entry in found.values())
    return f"{len(results.scores)} runs, {stopped} of them stopped, {100 * worst:.2g} % lost or commanded late"


def comparison(at: Site) -> str:
    """Gate of the comparison: adoption of the best controller, without those under which the piston stood."""
    entries = at.record.comparison
    still = checks.STANDSTILL_RATIO * at.record.amplitude / 2.0**0.5
    stood = {
        key: entry["name"]
        for key, entry in entries.items()
        if any(rmse is not None and rmse > still for rmse in entry["rmse"].values())
    }
    at.record.adopted = best({key: entry for key, entry in entries.items() if key not in stood})
    names = ", ".join(dict.fromkeys(stood.values()))
    left_out = f"; left out: {names}: the load force hardly followed, as if the piston stood" if stood else ""
    if not at.record.adopted:
        raise GateError(f"no controller completed every reference{left_out}")
    adopted, noise = at.record.comparison[at.record.adopted], at.record.cell_noise
    told = [f"At rest, {at.record.drift}."] if at.record.drift else []
    if max(adopted["rmse"].values()) < 1.5 * noise:
        told.append(f"The best errors are mainly the load cell's noise, {noise:.2g} N: less than that tells nothing.")
    notes = (
        f"MISMATCH says that the bench is no longer the one that was diagnosed: {RECOMMISSION_HINT}.",
        "Errors are of the load cell's reading: where its amplifier lags, the specimen feels more.",
    )
    at.record.watch = list(dict.fromkeys([*at.record.watch, *told, *notes]))
    return " ".join([f"{adopted['name']} is the best{left_out}.", *told]).rstrip(".")


GATES = (
    Gate(name="link", run=link, files=(site.BENCH_FILE,), recordings=(REST_RECORDING,)),
    Gate(name="sensors", run=sensors, files=(site.BENCH_FILE,), recordings=(REST_RECORDING,)),
    Gate(name="signs", run=signs, files=(site.BENCH_FILE,), recordings=("signs",)),
    Gate(name="gains", run=gains, files=(site.BENCH_FILE,), recordings=("gains",)),
    Gate(name="excitation", run=excitation, files=(), recordings=("training", "held_out")),
    Gate(name="diagnosis", run=diagnosis, files=(site.MODEL_FILE,), recordings=("training", "held_out")),
    Gate(
        name="metric", run=metric, files=(site.BENCH_FILE, site.MODEL_FILE, site.METRIC_FILE), recordings=("held_out",)
    ),
    Gate(name="policy", run=policy, files=(site.MODEL_FILE, POLICY_FOLDER)),
    Gate(name="controllers", run=controllers, files=(site.MODEL_FILE, site.METRIC_FILE), recordings=("controllers",)),
    Gate(name="comparison", run=comparison, files=(f"{site.REPORTS_FOLDER}/controllers/evaluation.json",)),
)
GATE_NAMES = tuple(gate.name for gate in GATES)


def _tracking_rmse(at: Site, name: str, settings: EvaluationSettings, share: float = 1.0) -> float:
    """Move by this share of the amplitude under the compensated law without a filter; returns the largest RMSE [N]."""
    amplitude = share * at.record.amplitude
    scores = at.compare(name, replace(settings, amplitude=amplitude)).scores
    for score in scores:
        if score.stopped:
            raise GateError(f"stopped at {score.case}, {amplitude:.0f} N: {score.stopped}")
    return max(score.rmse for score in scores)


def _states(folder: Path) -> StateArray:
    return read_bag(folder, (STATE,)).state


def _armed(folder: Path) -> StateArray:
    states = _states(folder)
    armed = states[states["flags"] & Flag.ARMED != 0]
    if len(armed) < 100:
        raise GateError(f"{folder} was not armed")
    return armed


def parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    result = make_parser("commission", __doc__)
    result.add_argument("--site", required=True, type=writable_folder, metavar="DIR", help="folder of this bench")
    plant = result.add_mutually_exclusive_group()
    plant.add_argument("--port", metavar="PATH", help="serial port of the box; a site keeps it")
    plant.add_argument("--plant", choices=(EMULATED_PLANT,), help="commission an emulated bench in its place")
    result.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml that the box believes; a site keeps it")
    result.add_argument(
        "--truth", type=Path, metavar="FILE", help="YAML of what the emulated bench is made of; a site keeps it"
    )
    result.add_argument(
        "--arm",
        choices=("person", "auto"),
        help="who arms before each motion: a person, by Enter or `arm` (default on a port), or nobody is asked "
        "(default with the emulator)",
    )
    result.add_argument(
        "--amplitude", type=float, metavar="N",
        help="of the sines; default: 9.4 %% of piston area times supply pressure",
    )  # fmt: skip
    result.add_argument("--policy", action="store_true", help="pretrain a policy in simulation, and compare it, too")
    result.add_argument(
        "--seconds", type=bounded_number(0.1), default=24.0, metavar="S",
        help=f"budget of the diagnosis, s of CPU (default %(default)g); {LONGER:g} times that if it does not explain",
    )  # fmt: skip
    repeat = result.add_mutually_exclusive_group()
    repeat.add_argument(
        "--from", dest="start", choices=GATE_NAMES, metavar="GATE", help=f"repeat from: {', '.join(GATE_NAMES)}"
    )
    repeat.add_argument(
        "--again", action="store_true", help=f"the bench has changed: repeat from {FIRST_REPEATED_GATE}"
    )
    return result


@command(CompanionError, ValueError)
def main() -> int:
    """Entry point; status 0 where all gates passed, 1 where one failed."""
    options = parser().parse_args()
    folder: Path = options.site
    record = Record.load(folder, GATE_NAMES)
    changed = _take(options, folder, record)
    untrained = options.policy and record.gates[GATE_NAMES.index("policy")].status != PASSED
    start = FIRST_REPEATED_GATE if options.again else options.start or ("policy" if untrained else None)
    starts = [name for name in (start, "signs" if changed else None) if name]
    first = record.reset_invalid_gates(folder, min((GATE_NAMES.index(name) for name in starts), default=len(GATES)))
    for gate in GATES[:first]:
        print(f"{gate.name}: passed before")
    with ExitStack() as stack:
        log = stack.enter_context((folder / "commission.log").open("a", buffering=1, encoding="utf-8"))
        stack.enter_context(running_ros())
        rearm = options.arm == "auto" if options.arm else record.plant == EMULATED_PLANT
        at = Site(folder, record, rearm=rearm, policy=options.policy, seconds=options.seconds, log=log)
        stack.callback(at.close)
        for gate, result in zip(GATES[first:], record.gates[first:], strict=True):
            print(f"\n== {gate.name}")
            record.write(folder)  # what is begun again has not passed
            began = time.monotonic()
            try:
                result.reason, result.status = gate.run(at), PASSED
            except KeyboardInterrupt:
                print(f"go on: ros2 run hydro_policy commission --site {folder}", file=sys.stderr)
                raise
            except GateSkipped as skipped:
                result.reason, result.status = str(skipped), SKIPPED
            except (GateError, NotReadyError, CompanionError, PairingError, RecordingError) as error:
                result.reason, result.status = str(error), FAILED
            result.seconds = round(time.monotonic() - began, 1)
            recordings = (f"{site.RECORDINGS_FOLDER}/{name}" for name in gate.recordings)
            result.files = digests(folder, (*gate.files, *recordings))
            record.write(folder)
            print(f"{gate.name}: {result.status}: {result.reason} ({result.seconds:.0f} s)")
            if result.status == FAILED:
                break
    print(f"\n{record.table().text()}\n")
    if record.comparison:
        print(f"{record.comparison_table().text()}\n")
    print(f"page: {folder / 'report.html'}")
    return 0 if all(gate.status in (PASSED, SKIPPED) for gate in record.gates) else 1


def _take(options: argparse.Namespace, folder: Path, record: Record) -> bool:
    """Store plant and bench file in the site, or refuse others than its own; returns whether the amplitude changed."""
    plant = options.plant or options.port or record.plant
    if not plant or options.port == "":
        raise UserError("which bench? Name its --port, or --plant emulator")
    if EMULATED_PLANT in (record.plant, plant) and record.plant not in ("", plant):
        raise UserError(f"{folder} is the site of {record.plant}, not of {plant}: name another --site")
    if options.truth and plant != EMULATED_PLANT:
        raise UserError("--truth is of the emulated bench: it goes with --plant emulator")
    own = folder / site.BENCH_FILE
    given = options.bench or (bench_digest.shipped_bench_file() if plant == EMULATED_PLANT else None)
    if own.is_file():
        if options.bench and bench_digest.digest(bench_digest.read_parameters(options.bench)) != bench_digest.digest(
            bench_digest.read_parameters(own)
        ):
            raise UserError(f"{own} is another bench than {options.bench}: name another --site")
    elif given is None:
        raise UserError("--bench: which bench.yaml does the box believe?")
    else:
        bench_digest.read_parameters(given)
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(given, own)
    if options.truth:
        shutil.copyfile(options.truth, folder / TRUTH_FILE)
    (folder / site.REPORTS_FOLDER).mkdir(exist_ok=True)
    before, record.plant, record.amplitude = record.amplitude, plant, options.amplitude or record.amplitude
    return record.amplitude != before
