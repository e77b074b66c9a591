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
times the valve's gain believed (safety.md). What moves are trials, run by `TrialRunner` on one plant (`site_runs`); a
gate reads their results and their recording. What only computes is a process of its own.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hydro_bridge.bags.recording import read_bag, read_messages
from hydro_bridge.bags.types import RecordingError
from hydro_bridge.ros.topics import BOX, BOX_LAW, DIAGNOSTICS, STATE
from hydro_core.files import site
from hydro_core.files.site import RECOMMISSION_HINT
from hydro_core.signals import Flag, StateArray
from hydro_filter.controller.loop_filter import loop_filter
from hydro_filter.metric import ScheduledMetric
from hydro_policy.commissioning import checks
from hydro_policy.commissioning.record import GateError, GateSkipped, best, scored
from hydro_policy.evaluation.controllers import Controller, FixedGains, policy_controller, policy_file
from hydro_policy.nodes.plants import require_matching_policy
from hydro_policy.nodes.site_runs import Site, read_json
from hydro_policy.task.cases import EvaluationSettings
from hydro_sim.files.pairing import BoxIdentity
from hydro_sim.model.bench import Bench

AT_REST = "rest"
REST = 10.0
"""s recorded at rest."""
REACH = 0.8
"""Largest amplitude over the force at which the compensated law cuts off: its a_0 is up to 1.25."""
ATTEMPTS = 3
TRAINING = EvaluationSettings(frequencies=(0.5, 1.0, 2.0), multisine=True, steps=True)
HELD_OUT = EvaluationSettings(frequencies=(0.7, 1.5))
COMPARED = EvaluationSettings(frequencies=(0.5, 1.0, 1.5, 2.0))
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


def _recorded(*names: str) -> tuple[str, ...]:
    return tuple(f"{site.RECORDINGS}/{name}" for name in names)


def link(at: Site) -> str:
    """See the module."""
    report = at.folder / site.REPORTS / "conformance.json"
    report.unlink(missing_ok=True)
    words = ("--port", at.free_port(), "--bench", str(at.bench), "--json", str(report))
    try:
        at.run("hydro_bridge", "conformance", *words, loud=False)
    except GateError:
        if not report.is_file():
            raise
    wrong = [f"{row['case']}: {row['found']}" for row in read_json(report)["rows"] if row["result"] == "FAIL"]
    if wrong:
        raise GateError("the box does not keep the protocol: " + "; ".join(wrong))
    at.rest(AT_REST, REST)
    folder = at.recording(AT_REST)
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
        _moved(at, "signs", EvaluationSettings(frequencies=(checks.SLOW,)), share)
        if not checks.held(_armed(at.recording("signs"))):
            break
    found = checks.signs(_armed(at.recording("signs")), Bench.load(at.bench))
    return "correlations " + ", ".join(f"{name} {value:.2f}" for name, value in found.items())


def gains(at: Site) -> str:
    """See the module."""
    found = []
    for share in (0.5, 1.0):
        rmse = _moved(at, "gains", EvaluationSettings(frequencies=(1.0,)), share)
        found.append(f"{rmse:.2f} N at {share * at.record.amplitude:.0f} N")
    checks.tracking(_armed(at.recording("gains")), 1.0)
    return f"the compensated law tracks 1 Hz with {', '.join(found)}"


def excitation(at: Site) -> str:
    """See the module."""
    told = []
    for name, settings in (("training", TRAINING), ("held_out", HELD_OUT)):
        worst = _whole(at, name, settings)
        told.append(f"{name} {100 * worst:.2g} %")
    return f"lost or commanded late: {', '.join(told)}"


def diagnosis(at: Site) -> str:
    """See the module."""
    out = at.folder / site.REPORTS / "diagnosis"
    training, held_out = (str(at.recording(name)) for name in ("training", "held_out"))
    words = (training, "--holdout", held_out, "--bench", str(at.bench), "--out", str(out), "--quiet")
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
    words = ("--model", str(at.folder / site.MODEL), "--bench", str(at.bench), "--out", str(out))
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
    chosen: list[Controller] = [FixedGains(*pair, (kp, ki)) for pair in fixed]
    trained, policies = at.folder / POLICY, list[Path]()
    if trained.is_dir():
        require_matching_policy(trained, BoxIdentity.of_file(at.bench, (kp, ki)))
        chosen.insert(0, policy_controller(trained))
        policies.append(policy_file(trained))
    words = ("--model", str(at.folder / site.MODEL), "--metric", str(at.folder / site.METRIC))
    settings = replace(COMPARED, amplitude=at.record.amplitude)
    content = at.compare("controllers", settings, chosen, words=words, learned=True, policies=policies)
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
    Gate(name="sensors", run=sensors, files=(site.BENCH, *_recorded(AT_REST))),
    Gate(name="signs", run=signs, files=(site.BENCH, *_recorded("signs"))),
    Gate(name="gains", run=gains, files=(site.BENCH, *_recorded("gains"))),
    Gate(name="excitation", run=excitation, files=_recorded("training", "held_out")),
    Gate(name="diagnosis", run=diagnosis, files=(*_recorded("training", "held_out"), site.MODEL)),
    Gate(name="metric", run=metric, files=(site.BENCH, site.MODEL, site.METRIC, *_recorded("held_out"))),
    Gate(name="policy", run=policy, files=(site.MODEL, POLICY)),
    Gate(name="controllers", run=controllers, files=(site.MODEL, site.METRIC, *_recorded("controllers"))),
    Gate(name="comparison", run=comparison, files=(f"{site.REPORTS}/controllers/evaluation.json",)),
)
NAMES = tuple(gate.name for gate in GATES)


def _moved(at: Site, name: str, settings: EvaluationSettings, share: float = 1.0) -> float:
    """Move by this share of the amplitude under the compensated law without a filter; returns the largest RMSE [N].

    Raises GateError: it was stopped.
    """
    amplitude = share * at.record.amplitude
    content = at.compare(name, replace(settings, amplitude=amplitude))
    for run in content["runs"]:
        if run["stopped"]:
            raise GateError(f"stopped at {run['case']}, {amplitude:.0f} N: {run['stopped']}")
    return max(float(run["rmse"]) for run in content["runs"])


def _whole(at: Site, name: str, settings: EvaluationSettings) -> float:
    """Move until few samples of the recording were lost or commanded late; returns their share."""
    for _ in range(ATTEMPTS):
        _moved(at, name, settings)
        worst = checks.unusable(_armed(at.recording(name)))
        if worst <= checks.LOST_MAX:
            return worst
    raise GateError(f"{100 * worst:.1f} % of {name} were lost or commanded late, {ATTEMPTS} times: end other work")


def _states(folder: Path) -> StateArray:
    try:
        return read_bag(folder, (STATE,)).state
    except RecordingError as error:
        raise GateError(str(error)) from None


def _armed(folder: Path) -> StateArray:
    states = _states(folder)
    armed = states[states["flags"] & Flag.ARMED != 0]
    if len(armed) < 100:
        raise GateError(f"{folder} was not armed")
    return armed
