# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_sim learn BAG... --out WEIGHTS: train the bench's model from recordings (paper, Table training)."""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import asdict, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numba
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from hydro_bridge.cli.console import UserError, command, progress, writable
from hydro_bridge.cli.resuming import explicit_options, refuse_changes
from hydro_sim.files import recordings
from hydro_sim.files.pairing import MadeFor
from hydro_sim.files.recordings import DataError
from hydro_sim.identification import adam, engines, learn_bench, stages, training
from hydro_sim.identification.checkpoint import Checkpoint
from hydro_sim.identification.curves import draw_curves
from hydro_sim.learned.model import Model
from hydro_sim.model.bench import Bench
from hydro_sim.structured.model import StructuredModel

DEVICE_HELP = (
    "what computes gradients; auto: the quicker of CPU and GPU on one batch, the CPU without a GPU. Constants are "
    "identified and start states estimated on the CPU. The GPU's code is tested by torch on the CPU; it has not been "
    "run on a GPU"
)


STRUCTURE_HELP = (
    "structured: equations with learned constants, and a network for the rest; residual: a network on top of the bench "
    "file's equations; network: the paper's, x' by a network alone (docs/reports/learned_bench.md compares these); "
    "bench: the parameters of effects and closures that --bench names, WEIGHTS is a bench file (default structured)"
)
RESUME_HELP = (
    "go on from WEIGHTS' checkpoint, if there is one, with what it was begun with; --epochs, --patience, --device and "
    "--threads may change"
)
BENCH_HELP = (
    "bench.yaml to start from; the shipped one by default. Recordings say which one the box believed: the model is for "
    "that one, and for this one where they do not say"
)
HIDDEN_HELP = "hidden layers' widths, as many as there are to be layers; two for structured (default 32 32)"


@command(DataError, ValueError)
def main() -> None:
    """Entry point."""
    options = parser().parse_args()
    if options.structure == learn_bench.STRUCTURE:
        learn_bench.run(options, explicit_options(parser(), sys.argv[1:]))
        return
    _check(options)
    out, began = Path(options.out), time.monotonic()
    before = resumed(options)
    settings = before.settings if before else _settings(options)
    numba.set_num_threads(min(options.threads or numba.config.NUMBA_NUM_THREADS, numba.config.NUMBA_NUM_THREADS))
    bench = Bench.load(options.bench) if options.bench else Bench.nominal()
    if bench.terms:
        _say(f"the learning starts from the bench file's numbers, without its {len(bench.terms)} effects and closures")
    data, box = recordings.split(recordings.load(options.bags)), recordings.believed_bench(options.bags)
    threadpool_limits(1, "blas")  # numba's threads call BLAS: its own would only get in their way
    if before and before.asked["recordings"] != data.digests:
        raise UserError(f"{_checkpoint(out)} is of other recordings: {', '.join(before.asked['recordings'])}")
    last, model = _train(before or _begun(options, data, settings, bench), data, _checkpoint(out))
    if isinstance(model, StructuredModel):
        model = stages.tune_observer(model, data)
    facts = {
        "recordings": data.digests, "command": " ".join(["learn", *sys.argv[1:]]), "seed": settings.seed,
        "settings": asdict(settings), "code": _code_version(), "validation_error": last.best_error,
        "epochs": last.epoch, "best_epoch": last.best_epoch, "seconds": round(time.monotonic() - began, 1),
    }  # fmt: skip
    made = MadeFor(box=box or bench.digest)
    replace(training.finished(model, data, facts), made=made).save(out)
    draw_curves(last.history, out.with_suffix(".png"), settings.structure)
    _checkpoint(out).unlink(missing_ok=True)
    print(f"{out}: {settings.structure}, validation error {last.best_error:.5f} at epoch {last.best_epoch}")


def _checkpoint(out: Path) -> Path:
    return out.with_suffix(".checkpoint")


def resumed(options: argparse.Namespace) -> Checkpoint | None:
    """The checkpoint to resume, with changed options; UserError if an option contradicts it."""
    path = _checkpoint(Path(options.out))
    if not options.resume:
        return None
    if not path.exists():
        _say(f"there is no {path}: the training begins at its beginning")
        return None
    before = Checkpoint.load(path)
    begun = {"bench": before.asked["bench"], "learning_rate": before.settings.adam.learning_rate}
    begun |= {
        name: getattr(before.settings, name) for name in ("structure", "horizon", "batch", "seed", "printed_loss")
    }
    refuse_changes(parser(), sys.argv[1:], str(path), {**begun, "hidden": list(before.settings.hidden)})
    said = explicit_options(parser(), sys.argv[1:])
    loop = replace(before.settings.adam, **{name: said[name] for name in ("epochs", "patience") if name in said})
    device = said.get("device", before.settings.device)
    return replace(before, settings=replace(before.settings, adam=loop, device=device))


def _begun(options: argparse.Namespace, data: recordings.Data, settings: training.Settings, bench: Bench) -> Checkpoint:
    """Return a training at its beginning; of a structured model the constants are identified."""
    model = training.start(data, settings, bench)
    if isinstance(model, StructuredModel):
        model = stages.fit_constants(model, data, settings.identify_windows, settings.seed, _say)
    asked = {"recordings": data.digests, "bench": options.bench and os.path.abspath(options.bench)}
    return Checkpoint(progress=adam.Progress.begin(model.flat), model=model, settings=settings, asked=asked)


def _train(first: Checkpoint, data: recordings.Data, path: Path) -> tuple[adam.Progress, Model]:
    bar: tqdm[Any] = progress(total=first.settings.adam.epochs, label="training", unit="epoch", every=10.0)

    def keep(state: adam.Progress) -> None:
        replace(first, progress=state).save(path)

    for last in training.steps(first.model, data, first.settings, first.progress, keep):
        state = last[0]
        bar.update(state.epoch - bar.n)
        bar.set_postfix_str(f"loss {state.history[-1, 1]:.4g}, validation {state.best_error:.5f}")
    bar.close()
    return last


def _say(sentence: str) -> None:
    print(sentence, file=sys.stderr)


def _check(options: argparse.Namespace) -> None:
    """Refuse impossible numbers before any work; raises ValueError."""
    counts = {"--horizon": options.horizon, "--batch": options.batch, "--epochs": options.epochs}
    counts |= {"--patience": options.patience, "--hidden": min(options.hidden)}
    for word, count in counts.items():
        if count is not None and count < 1:
            raise ValueError(f"{word} is {count}, needs 1 or more")
    rate = options.learning_rate
    if rate is not None and not 0.0 < rate <= 1.0:
        raise ValueError(f"--learning-rate is {rate:g}, needs a number above 0, at most 1")
    if options.seed < 0 or options.threads < 0:
        raise ValueError("--seed and --threads need 0 or more")
    deep = options.structure == "residual" or (options.structure == "network" and len(options.hidden) != 2)
    if options.structure == "structured" and len(options.hidden) != 2:
        raise ValueError(f"--hidden names {len(options.hidden)} layers, --structure structured has two")
    if deep and (options.device == "cuda" or options.printed_loss):
        raise ValueError("--device cuda and --printed-loss are for a network alone of two layers, and for structured")
    if options.json:
        raise ValueError("--json is for --structure bench")
    engines.engines(options.device)


def _settings(options: argparse.Namespace) -> training.Settings:
    base = training.STRUCTURED_ADAM if options.structure == "structured" else adam.Settings()
    given = {"epochs": options.epochs, "learning_rate": options.learning_rate, "patience": options.patience}
    loop = replace(base, **{name: value for name, value in given.items() if value is not None})
    return training.Settings(
        structure=options.structure, hidden=tuple(options.hidden), horizon=options.horizon, batch=options.batch,
        seed=options.seed, printed_loss=options.printed_loss, device=options.device, adam=loop,
    )  # fmt: skip


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(prog="learn", description="Train the bench's model from recordings.")
    result.add_argument("bags", nargs="+", metavar="BAG", help="recordings; of three or more the last one validates")
    result.add_argument(
        "--out",
        required=True,
        type=writable,
        metavar="WEIGHTS",
        help="file to write, .safetensors; its curve beside it. A bench.yaml for --structure bench",
    )
    result.add_argument(
        "--structure", choices=(*training.CHOICES, learn_bench.STRUCTURE), default="structured", help=STRUCTURE_HELP
    )
    result.add_argument("--bench", metavar="FILE", help=BENCH_HELP)
    result.add_argument("--windows", type=int, default=120, help="bench: predictions that it is learnt from")
    result.add_argument("--json", metavar="FILE", help="bench: write the table of parameters there as well")
    result.add_argument("--hidden", nargs="+", type=int, default=[32, 32], metavar="WIDTH", help=HIDDEN_HELP)
    result.add_argument("--horizon", type=int, default=70, help="samples rolled out; 1: one-step training")
    result.add_argument("--batch", type=int, default=8192, help="windows per gradient")
    result.add_argument("--epochs", type=int, help="at most; 1000, and 60 for structured")
    result.add_argument("--learning-rate", type=float, help="1e-3, and 3e-4 for structured")
    result.add_argument("--patience", type=int, help="epochs without a better validation before training stops")
    result.add_argument("--seed", type=int, default=0, help="of first weights and shuffles")
    result.add_argument("--printed-loss", action="store_true", help="network: eq. loss as printed (errors may cancel)")
    result.add_argument("--resume", action="store_true", help=RESUME_HELP)
    result.add_argument("--device", choices=engines.DEVICES, default="auto", help=DEVICE_HELP)
    result.add_argument("--threads", type=int, default=0, help="cores to use; 0: all")
    return result


def _code_version() -> str:
    try:
        return version("hydro_sim")
    except PackageNotFoundError:
        return "unknown"
