# SPDX-License-Identifier: Apache-2.0
"""The plot of the metric's training (the paper's figure metric_loss)."""

from __future__ import annotations

from pathlib import Path

from hydro_bridge.signals import FloatArray
from hydro_sim.plotting import BLUE, GREEN, ORANGE, RED, figure, legend


def draw_metric_curves(history: FloatArray, path: str | Path) -> None:
    """Draw the loss and the shares of violating samples.

    `history` has rows of epoch, training loss, held-out loss, violated, foreign violated, caught.
    """
    with figure(path, 2, size=(7.0, 5.5), sharex=True) as (drawing, (loss, shares)):
        drawing.suptitle("contraction metric", x=0.01, ha="left", weight="semibold")
        loss.plot(history[1:, 0], history[1:, 1], color=BLUE, label="training")
        loss.plot(history[:, 0], history[:, 2], color=ORANGE, label="held out")
        loss.set(yscale="log", ylabel="loss")
        named = ((3, RED, "certified gains"), (4, GREEN, "all other gains"))
        for column, color, name in named:
            shares.plot(history[:, 0], 100.0 * history[:, column], color=color, label=name)
        shares.set(yscale="symlog", ylabel="violated [%]", xlabel="epoch", ylim=(0.0, 100.0))
        legend(loss)
        legend(shares)
