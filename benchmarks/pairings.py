# SPDX-License-Identifier: Apache-2.0
"""What does not belong together is refused: bench x model x metric x policy, each command with each wrong pairing.

python -m benchmarks.pairings [--json FILE]

Every command runs as users start it, on files that differ in nothing but what they say they were made for: `own` is for
another bench (another spring, cylinder and supply), `other` for this bench and another model, `unmarked` does not say.
Refused means: exit status 2, one sentence, nothing started and nothing written.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import yaml

from hydro_bridge.cli.console import Table, add_json_argument, command, progress
from hydro_bridge.ros.companion import executable_path
from hydro_filter.metric import learned as learned_metric
from hydro_policy.runs.initial_agent import shipped_agent
from hydro_sim.files import weights
from hydro_sim.files.pairing import MadeFor
from hydro_sim.files.stamping import stamped
from hydro_sim.learned.model import Learned
from hydro_sim.model.bench import Bench

COLUMNS = {
    "command": "",
    "words": "",
    "status": "exit status; 2: refused",
    "left": "files that it left behind",
    "sentence": "the last line that it says",
}
PATIENCE = 60.0
"""s, for a command that does not refuse."""


@dataclass(frozen=True, kw_only=True)
class Wrong:
    """A pairing that does not fit."""

    package: str
    executable: str
    words: str
    """Of the command line; @ stands for the folder of `make_files`."""
    sentence: str
    """Part of what is said."""

    def arguments(self, folder: Path) -> list[str]:
        """The command line, files in `folder`."""
        return [word.replace("@", f"{folder}/") for word in self.words.split()]


FOREIGN = "was made for bench"
UNMARKED = "does not say which bench it was made for"
CONSTANT = "--filter=--metric=constant"


def _wrong(package: str, executable: str, *rows: tuple[str, str]) -> Iterator[Wrong]:
    for words, sentence in rows:
        yield Wrong(package=package, executable=executable, words=words, sentence=sentence)


WRONG = (
    *_wrong(
        "hydro_filter", "filter",
        ("--bench @own.yaml", f"the model default_weights.safetensors {FOREIGN}"),
        ("--bench @own.yaml --model @own_model.safetensors", f"the metric default_metric.safetensors {FOREIGN}"),
        ("--bench @own.yaml --metric @own_metric.safetensors", f"the model default_weights.safetensors {FOREIGN}"),
        ("--model @own_model.safetensors", f"the model own_model.safetensors {FOREIGN}"),
        ("--metric @own_metric.safetensors", f"the metric own_metric.safetensors {FOREIGN}"),
        ("--model @other_model.safetensors", "the metric default_metric.safetensors was made for model"),
        ("--metric @other_metric.safetensors", "the metric other_metric.safetensors was made for model"),
        ("--model @unmarked_model.safetensors", UNMARKED),
        ("--metric @unmarked_metric.safetensors", UNMARKED),
    ),
    *_wrong(
        "hydro_filter", "validate",
        ("--bench @own.yaml", f"the model default_weights.safetensors {FOREIGN}"),
        ("--model @own_model.safetensors", f"the model own_model.safetensors {FOREIGN}"),
        ("--metric @own_metric.safetensors", f"the metric own_metric.safetensors {FOREIGN}"),
        ("--model @other_model.safetensors", "was made for model"),
        ("--metric @unmarked_metric.safetensors", UNMARKED),
    ),
    *_wrong(
        "hydro_filter", "learn_metric",
        ("--out @new/m.safetensors --bench @own.yaml", f"the model default_weights.safetensors {FOREIGN}"),
        ("--out @new/m.safetensors --model @own_model.safetensors", f"the model own_model.safetensors {FOREIGN}"),
        ("--out @new/m.safetensors --model @unmarked_model.safetensors", UNMARKED),
    ),
    *_wrong(
        "hydro_sim", "sim",
        ("--model @own_model.safetensors", f"the model own_model.safetensors {FOREIGN}"),
        ("--model shipped --box-bench @own.yaml", f"the model default_weights.safetensors {FOREIGN}"),
        ("--model @unmarked_model.safetensors", UNMARKED),
    ),
    *_wrong(
        "hydro_sim", "validate",
        ("@bag --bench @own.yaml", f"the model default_weights.safetensors {FOREIGN}"),
        ("@bag --model @own_model.safetensors", f"the model own_model.safetensors {FOREIGN}"),
        ("@bag --model @unmarked_model.safetensors", UNMARKED),
    ),
    *_wrong(
        "hydro_policy", "pretrain",
        ("--out @new --box @own.yaml", f"the model default_weights.safetensors {FOREIGN}"),
        ("--out @new --model @own_model.safetensors", f"the model own_model.safetensors {FOREIGN}"),
        ("--out @new --model @unmarked_model.safetensors", UNMARKED),
        ("--out @new --bench @own.yaml --box @own.yaml --filter learned", FOREIGN),
    ),
    *_wrong(
        "hydro_policy", "trainer",
        ("--runs @new --plant sim --bench @own.yaml", f"the model default_weights.safetensors {FOREIGN}"),
        ("--runs @new --plant emulator --bench @own.yaml --configuration wide", FOREIGN),
        (f"--runs @new --plant sim --bench @own.yaml {CONSTANT}", f"the agent pretrained_paper {FOREIGN}"),
        ("--runs @new --plant sim --from @own", f"the agent own {FOREIGN}"),
        ("--runs @new --plant sim --from @unmarked", UNMARKED),
        ("--runs @new --plant sim --base-gains 30 8", "was made for a box with base K_p 15, this one has 30"),
        ("--runs @new --plant sim --filter=--metric=@own_metric.safetensors", "the metric own_metric.safetensors"),
        ("--runs @new --plant bench --filter=--model=@other_model.safetensors", "was made for model"),
    ),
    *_wrong(
        "hydro_policy", "evaluate",
        ("--runs @new --plant sim --bench @own.yaml", f"the model default_weights.safetensors {FOREIGN}"),
        ("--runs @new --plant sim --policy @own", f"the policy own {FOREIGN}"),
        ("--runs @new --plant emulator --policy @unmarked", UNMARKED),
        (f"--runs @new --plant sim --bench @own.yaml {CONSTANT} --policy @shipped", f"the policy shipped {FOREIGN}"),
        ("--runs @new --plant sim --base-gains 30 8 --policy @shipped", "was made for a box with base K_p 15"),
        ("--runs @new --plant sim --filter=--metric=@unmarked_metric.safetensors", UNMARKED),
    ),
)  # fmt: skip
"""Every command that pairs anything, with what does not belong together."""


def make_files(folder: Path) -> None:
    """Own bench, models, metrics and policies, by what they say they were made for."""
    nominal = Bench.nominal()
    own = replace(nominal, spring_stiffness=4e4, piston_area=3e-4, supply_pressure=12e6)
    (folder / "own.yaml").write_text(yaml.safe_dump(own.to_mapping()), encoding="utf-8")
    shipped, metric = weights.shipped().read_bytes(), learned_metric.shipped().read_bytes()
    _other_model(folder / "other_model.safetensors", MadeFor(box=nominal.digest))
    _other_model(folder / "own_model.safetensors", MadeFor(box=own.digest))
    (folder / "unmarked_model.safetensors").write_bytes(stamped(shipped, None))
    other = weights.digest(folder / "other_model.safetensors")
    (folder / "own_metric.safetensors").write_bytes(stamped(metric, MadeFor(box=own.digest, model=other)))
    (folder / "other_metric.safetensors").write_bytes(stamped(metric, MadeFor(box=nominal.digest, model=other)))
    (folder / "unmarked_metric.safetensors").write_bytes(stamped(metric, None))
    start = shipped_agent("paper")
    assert start is not None
    for name, made in (("own", MadeFor(box=own.digest, base_kp=15.0, base_ki=5.0)), ("unmarked", None)):
        shutil.copytree(start.source, folder / name)
        for file in (folder / name).iterdir():
            file.write_bytes(stamped(file.read_bytes(), made))
    shutil.copytree(start.source, folder / "shipped")


def _other_model(path: Path, made: MadeFor) -> None:
    """The shipped model with a region that is a hair wider: another one by its digest."""
    learned = Learned.load()
    region = replace(learned.region, whiten=learned.region.whiten * (1.0 + 1e-9))
    replace(learned, region=region, made=made).save(path)


@command()
def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="benchmarks.pairings", description="Wrong pairings, each refused.")
    add_json_argument(parser)
    options = parser.parse_args()
    table = Table(COLUMNS, title="Pairings that do not fit")
    with TemporaryDirectory() as name:
        folder = Path(name)
        make_files(folder)
        before = set(folder.rglob("*"))
        for wrong in progress(WRONG, label="pairings", unit="command"):
            status, said = attempt(wrong, folder)
            left = len(set(folder.rglob("*")) - before)
            table.add(
                command=f"{wrong.package} {wrong.executable}", words=wrong.words, status=status, left=left,
                sentence=said.replace(f"{folder}/", ""),
            )  # fmt: skip
    table.show(options.json)
    refused = sum(row["status"] == 2 and row["left"] == 0 for row in table.rows)
    print(f"{refused} of {len(table.rows)} refused, nothing left behind", file=sys.stderr)


def attempt(wrong: Wrong, folder: Path) -> tuple[int, str]:
    """Run it: exit status and last line; -1 if it did not end by itself."""
    words = [str(executable_path(wrong.package, wrong.executable)), *wrong.arguments(folder)]
    try:
        ended = subprocess.run(
            words, capture_output=True, text=True, timeout=PATIENCE, check=False, cwd=folder, env=dict(os.environ)
        )
    except subprocess.TimeoutExpired:
        return -1, "it runs"
    return ended.returncode, (ended.stderr.strip().splitlines() or [""])[-1]


if __name__ == "__main__":
    main()
