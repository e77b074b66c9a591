# SPDX-License-Identifier: Apache-2.0
"""Draw the moving picture of the README: a training, and a diagnosis from recording to corrected simulation.

    make train ARGS="--name front_page"
    python -m benchmarks.front_page --run runs/front_page        # writes docs/images/front_page.gif

The first scene plays the recording of a training. The second records an emulated bench with a leak, dry friction and a
slow valve, diagnoses it, and closes its recorded loop again on the bench file and on the corrected bench.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image

from hydro_bridge.bags.recording import read_bag
from hydro_core.cli.console import command, make_parser
from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_diagnosis import diagnose
from hydro_diagnosis.forecast import recorded_loop
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import Sensors
from hydro_sim.simulation.offline import simulate

SIZE_MAX = 2_000_000
"""Bytes of the picture, at most."""
TRUTH = """profile: nominal
effects:
  leakage_internal: {coefficient: 1e-12}
  friction_coulomb: {force: 15}
  valve_lag: {bandwidth: 60}
"""
BLUE, RED, GREEN, GREY = "#1f5fa8", "#c8452d", "#2a8a4a", "#777777"
FRAME_TIME, PAUSE = 110, 2500
"""Duration of a frame, and of a scene's last one [ms]."""


def _axes(rows: int, title: str) -> tuple[Any, Any]:
    figure, axes = plt.subplots(rows, 1, figsize=(8.2, 4.4), dpi=100, layout="constrained", sharex=True, squeeze=False)
    figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold")
    for one in axes[:, 0]:
        one.spines[["top", "right"]].set_visible(False)
        one.grid(alpha=0.25)
    return figure, axes[:, 0]


def _frame(figure: Any) -> Image.Image:
    figure.canvas.draw()
    return Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[:, :, :3].copy())


def _palette() -> Image.Image:
    """Image whose palette holds the colours of all lines, faded to white in steps: the same in every frame."""
    colours = np.array([to_rgb(colour) for colour in (BLUE, RED, GREEN, GREY, "black")])
    faded = 1.0 - np.linspace(0.0, 1.0, 8)[:, np.newaxis, np.newaxis] * (1.0 - colours)
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.round(255.0 * faded).astype(int).ravel().tolist())
    return palette


def training_frames(run: Path, frames: int = 44, span: float = 4.0) -> Iterator[Image.Image]:
    """Yield the force, the gains and the error of a recorded training; each frame shows `span` s of it."""
    states = read_bag(run / "bag", topics=["/hydro/state"]).state
    time = np.arange(len(states)) * SAMPLE_PERIOD
    error = states["reference_force"] - states["load_force"]
    rms = np.sqrt(np.convolve(np.square(error), np.full(2000, 1 / 2000), mode="same"))
    figure, (force, gains, errors) = _axes(3, "make train: the policy sets two gains, 100 times a second")
    (reference,) = force.plot([], [], color=GREY, lw=2, label="reference")
    (measured,) = force.plot([], [], color=BLUE, lw=1.2, label="measured force")
    (kp,) = gains.plot([], [], color=RED, lw=1, label="$K_p$ [1/s]")
    (ki,) = gains.plot([], [], color=GREEN, lw=1, label="$K_i$ [1/s²]")
    (shown,) = errors.plot([], [], color=BLUE, lw=1.2, label="error, RMS over 2 s [N]")
    for axis, limits, label in ((force, (-400, 400), "force [N]"), (gains, (0, 310), "gains"), (errors, (0, 60), "N")):
        axis.set(ylim=limits, ylabel=label)
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.95), ncols=2, fontsize=8, frameon=False)
    width = int(span / SAMPLE_PERIOD)
    for begin in np.linspace(0, len(states) - width, frames).astype(int):
        part = slice(begin, begin + width, 8)
        drawn = {"reference_force": reference, "load_force": measured, "proportional_gain": kp, "integral_gain": ki}
        for name, line in drawn.items():
            line.set_data(time[part] - time[begin], states[name][part])
        shown.set_data(time[part] - time[begin], rms[part])
        errors.set(xlim=(0, span), xlabel=f"{time[begin]:5.0f} s of bench time behind us")
        yield _frame(figure)
    plt.close(figure)


def diagnosis_frames(folder: Path, steps: int = 14) -> Iterator[Image.Image]:
    """Yield a held-out recording's tracking error, the bench file's, the causes found, and the corrected bench's."""
    (folder / "truth.yaml").write_text(TRUTH, encoding="utf-8")
    recordings = [folder / name for name in ("monday", "tuesday")]
    for seed, recording in enumerate(recordings, start=1):
        emulator = [sys.executable, "-c", "from hydro_sim.emulator.command import main; main()", "--offline"]
        options = ["--truth", str(folder / "truth.yaml"), "--seconds", "20", "--seed", str(seed)]
        subprocess.run([*emulator, *options, "--out", str(recording)], check=True)
    found = diagnose(recordings[:1], holdout=recordings[1:])
    segment = max((one.segment for one in found.holdout), key=len)
    loop = recorded_loop(segment, Bench.nominal(), recordings[1])
    errors = [loop.reference - loop.force]
    for bench in (Bench.nominal(), found.corrected):
        force = simulate(AnalyticPlant(bench, settings=Sensors()), loop.box_bench, loop.schedule, config=loop.config)
        errors.append(loop.reference - force["load_force"])
    sentences = [f"{effect.id}: {effect.sentence}" for effect in found.report.effects]
    yield from _drawn(errors, sentences, steps)


def _drawn(errors: list[FloatArray], sentences: list[str], steps: int) -> Iterator[Image.Image]:
    figure, (axis,) = _axes(1, "diagnose: what the simulation leaves out")
    part = slice(4000, 10000, 4)
    time = np.arange(len(errors[0]))[part] * SAMPLE_PERIOD
    limit = 1.8 * max(np.abs(one[part]).max() for one in errors)
    axis.set(xlim=(time[0], time[-1]), ylim=(-limit, limit), xlabel="time [s]", ylabel="tracking error [N]")
    said = [" "] * len(sentences)
    axis.set_title("\n".join(said), loc="left", fontsize=8.5)
    for error, colour, label in zip(errors, (GREY, RED, GREEN), ("held-out recording", "your simulation",
                                                                 "corrected simulation"), strict=True):  # fmt: skip
        rms = np.sqrt(np.mean(np.square(error[part])))
        (line,) = axis.plot([], [], color=colour, lw=2.6 if colour == GREY else 1.2, label=f"{label}: {rms:.1f} N RMS")
        axis.legend(loc="lower left", ncols=3, fontsize=8, frameon=False)
        for shown in np.linspace(0, len(time), steps).astype(int):
            line.set_data(time[:shown], error[part][:shown])
            yield _frame(figure)
        if colour == RED:
            for number, sentence in enumerate(sentences):
                said[number] = sentence if len(sentence) < 110 else sentence[:107] + "..."
                axis.set_title("\n".join(said), loc="left", fontsize=8.5)
                yield from [_frame(figure)] * 6
    plt.close(figure)


@command(ValueError, OSError)
def main() -> int:
    """Draw both scenes, and write them as one picture."""
    options = make_parser("python -m benchmarks.front_page", __doc__)
    options.add_argument("--run", type=Path, default=Path("runs/front_page"), help="folder of a recorded training")
    options.add_argument("--out", type=Path, default=Path("docs/images/front_page.gif"), help="picture to write")
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        scenes = [list(training_frames(chosen.run)), list(diagnosis_frames(Path(folder)))]
    durations = [FRAME_TIME if frame is not scene[-1] else PAUSE for scene in scenes for frame in scene]
    drawn = [frame.quantize(palette=_palette(), dither=Image.Dither.NONE) for scene in scenes for frame in scene]
    drawn[0].save(chosen.out, save_all=True, append_images=drawn[1:], duration=durations, loop=0, optimize=True)
    size = chosen.out.stat().st_size
    if size > SIZE_MAX:
        raise ValueError(f"{chosen.out} has {size} bytes, more than {SIZE_MAX}")
    print(f"{chosen.out}: {size / 1e6:.2f} MB, {len(drawn)} frames")
    return 0


if __name__ == "__main__":
    sys.exit(main())
