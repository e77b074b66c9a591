# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_filter relearn BAG... --out FOLDER: the bench's model and the filter's metric from recordings.

After a change of the bench (spring, supply, valve) a minute of recordings is enough: `learn` fits a bench file's
effects, `learn_metric` solves the metric of that model. Both are commands of their own, with more to choose.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from hydro_bridge.cli.console import UserError, command

MODEL, METRIC = "model.yaml", "metric.safetensors"
_RECORDINGS = "recordings.txt"


@command()
def main() -> None:
    """Entry point."""
    options = _parser().parse_args()
    folder = Path(options.out)
    _begin(folder, [str(Path(bag).resolve()) for bag in options.bags], resume=options.resume)
    box = ["--bench", options.bench] if options.bench else []
    model, metric = folder / MODEL, folder / METRIC
    if not model.exists():
        _run("hydro_sim.identification.learn", *options.bags, "--out", str(model), *box)
    if not metric.exists():
        words = ["--model", str(model), "--out", str(metric), "--json", str(folder / "metric.json")]
        _run("hydro_filter.training.learn_metric", *words, *box)
    said = " ".join(["ros2 run hydro_filter filter --model", str(model), "--metric", str(metric), *box])
    print(f"{folder}: a model and its metric. The filter with them: {said}")


def _parser() -> argparse.ArgumentParser:
    result = argparse.ArgumentParser(
        prog="relearn",
        description="Learn the bench's model and the filter's metric anew from recordings: some minutes. The model is "
        "a bench file with learned effects (`learn`), the metric is solved (`learn_metric`).",
    )
    result.add_argument("bags", nargs="+", metavar="BAG", help="recordings of the bench as it is now, a minute or more")
    result.add_argument("--out", required=True, metavar="FOLDER", help=f"folder for {MODEL} and {METRIC}")
    result.add_argument("--bench", metavar="FILE", help="bench.yaml that the box believes; the shipped one by default")
    result.add_argument("--resume", action="store_true", help="go on in FOLDER after an interruption")
    return result


def _begin(folder: Path, bags: list[str], *, resume: bool) -> None:
    """Make the folder and note its recordings (raises UserError where it is another's)."""
    note = folder / _RECORDINGS
    if not resume:
        if folder.exists() and any(folder.iterdir()):
            raise UserError(f"{folder} is not empty: name another folder, or go on in it with --resume")
        folder.mkdir(parents=True, exist_ok=True)
        note.write_text("\n".join(bags) + "\n", encoding="utf-8")
    elif not note.is_file():
        raise UserError(f"{folder} holds nothing to go on with: start without --resume")
    elif (before := note.read_text(encoding="utf-8").splitlines()) != bags:
        raise UserError(f"{folder} was begun with {' '.join(before)}: name these, or another folder")


def _run(module: str, *words: str) -> None:
    """Run a command of ours; it prints its own progress and errors (raises UserError if it fails)."""
    start = f"import sys; from hydro_bridge.process.start import main_of; sys.exit(main_of.{module}())"
    done = subprocess.run([sys.executable, "-c", start, *words], check=False)
    if done.returncode:
        name = module.rpartition(".")[2]
        raise UserError(f"{name} ended with status {done.returncode}: mend what it says, then go on by --resume")
