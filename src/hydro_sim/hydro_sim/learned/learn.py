# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_sim learn BAG... --out WEIGHTS: train the bench's model from recordings (paper, Table training)."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import asdict, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numba
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from hydro_bridge.console import command, progress, writable
from hydro_sim.bench import Bench
from hydro_sim.learned import adam, engine, identification, recordings, training
from hydro_sim.learned.curves import draw_curves
from hydro_sim.learned.model import Model
from hydro_sim.learned.recordings import DataError
from hydro_sim.learned.structured_model import StructuredModel

DEVICE_HELP = (
    "what computes gradients; auto: the quicker of CPU and GPU on one batch, the CPU without a GPU. Constants are "
    "identified and start states estimated on the CPU. The GPU's code is tested by torch on the CPU; it has not been "
    "run on a GPU"
)


STRUCTURE_HELP = (
    "structured: equations with learned constants, and a network for the rest; residual: a network on top of the bench "
    "file's equations; network: the paper's, x' by a network alone (default structured; docs/learned_model.md compares)"
)
HIDDEN_HELP = "hidden layers' widths, as many as there are to be layers; two for structured (default 32 32)"


@command(DataError, ValueError)
def main() -> None:
    """Entry point."""
    options = _arguments()
    _check(options)
    settings = _settings(options)
    numba.set_num_threads(min(options.threads or numba.config.NUMBA_NUM_THREADS, numba.config.NUMBA_NUM_THREADS))
    bench = Bench.load(options.bench) if options.bench else Bench.nominal()
    if bench.effects:
        _say(f"the learning starts from the bench file's numbers, without its {len(bench.effects)} effects")
    data = recordings.split(recordings.load(options.bags))
    out, began = Path(options.out), time.monotonic()
    threadpool_limits(1, "blas")  # numba's threads call BLAS: its own would only get in their way
    checkpoint = out.with_suffix(".checkpoint")
    resume = options.resume and checkpoint.exists()
    model = training.start(data, settings, bench)
    if isinstance(model, StructuredModel) and not resume:
        model = identification.identified(model, data, settings.identify_windows, settings.seed, _say)
    last, model = _train(model, data, settings, checkpoint, resume)
    if isinstance(model, StructuredModel):
        model = identification.trusted(model, data)
    facts = {
        "recordings": data.digests, "command": " ".join(["learn", *sys.argv[1:]]), "seed": settings.seed,
        "settings": asdict(settings), "code": _code_version(), "validation_error": last.best_error,
        "epochs": last.epoch, "best_epoch": last.best_epoch, "seconds": round(time.monotonic() - began, 1),
    }  # fmt: skip
    training.finished(model, data, facts).save(out)
    draw_curves(last.history, out.with_suffix(".png"), settings.structure)
    checkpoint.unlink(missing_ok=True)
    print(f"{out}: {settings.structure}, validation error {last.best_error:.5f} at epoch {last.best_epoch}")


def _train(
    model: Model, data: recordings.Data, settings: training.Settings, checkpoint: Path, resume: bool
) -> tuple[adam.Progress, Model]:
    bar: tqdm[Any] = progress(total=settings.adam.epochs, label="training", unit="epoch")
    for last in training.steps(model, data, settings, checkpoint, resume=resume):
        state = last[0]
        bar.update(state.epoch - bar.n)
        bar.set_postfix_str(f"loss {state.history[-1, 1]:.4g}, validation {state.best_error:.5f}")
    bar.close()
    return last


def _say(sentence: str) -> None:
    print(sentence, file=sys.stderr)


def _check(options: argparse.Namespace) -> None:
    """Refuse numbers that cannot work, before the work; raises ValueError."""
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
    engine.engines(options.device)


def _settings(options: argparse.Namespace) -> training.Settings:
    base = training.STRUCTURED_ADAM if options.structure == "structured" else adam.Settings()
    given = {"epochs": options.epochs, "learning_rate": options.learning_rate, "patience": options.patience}
    loop = replace(base, **{name: value for name, value in given.items() if value is not None})
    return training.Settings(
        structure=options.structure, hidden=tuple(options.hidden), horizon=options.horizon, batch=options.batch,
        seed=options.seed, printed_loss=options.printed_loss, device=options.device, adam=loop,
    )  # fmt: skip


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="learn", description="Train the bench's model from recordings.")
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recordings; of three or more the last one validates")
    parser.add_argument(
        "--out",
        required=True,
        type=writable,
        metavar="WEIGHTS",
        help="file to write, .safetensors; its curve beside it",
    )
    parser.add_argument("--structure", choices=training.CHOICES, default="structured", help=STRUCTURE_HELP)
    parser.add_argument("--bench", metavar="FILE", help="bench.yaml to start from; the shipped one by default")
    parser.add_argument("--hidden", nargs="+", type=int, default=[32, 32], metavar="WIDTH", help=HIDDEN_HELP)
    parser.add_argument("--horizon", type=int, default=70, help="samples rolled out; 1: one-step training")
    parser.add_argument("--batch", type=int, default=8192, help="windows per gradient")
    parser.add_argument("--epochs", type=int, help="at most; 1000, and 60 for structured")
    parser.add_argument("--learning-rate", type=float, help="1e-3, and 3e-4 for structured")
    parser.add_argument("--patience", type=int, help="epochs without a better validation before training stops")
    parser.add_argument("--seed", type=int, default=0, help="of first weights and shuffles")
    parser.add_argument("--printed-loss", action="store_true", help="network: eq. loss as printed (errors may cancel)")
    parser.add_argument("--resume", action="store_true", help="go on from WEIGHTS' checkpoint, if there is one")
    parser.add_argument("--device", choices=engine.DEVICES, default="auto", help=DEVICE_HELP)
    parser.add_argument("--threads", type=int, default=0, help="cores to use; 0: all")
    return parser.parse_args()


def _code_version() -> str:
    try:
        return version("hydro_sim")
    except PackageNotFoundError:
        return "unknown"
