# SPDX-License-Identifier: Apache-2.0
"""Shared plotting: style, colors and display units.

Figures are drawn without a screen (Agg) and saved; nothing here touches matplotlib's global state, so that a
notebook's own style stays.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cycler import cycler

from hydro_core.files.atomic import write_atomic

if TYPE_CHECKING:  # matplotlib is imported with the first figure: commands that draw nothing start sooner
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, RED, PURPLE, SKY, GRAY = (
    "#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9", "#8a8f98"
)  # fmt: skip
"""Colors of Okabe and Ito: safe for color-blind readers and in print."""

UNITS: dict[str, tuple[str, str, float]] = {
    "hydraulic_force": ("hydraulic force", "N", 1.0),
    "hydraulic_force_rate": ("hydraulic force rate", "kN/s", 1e-3),
    "load_force": ("load force", "N", 1.0),
    "load_force_rate": ("load force rate", "kN/s", 1e-3),
    "pressure_a": ("pressure A", "MPa", 1e-6),
    "pressure_b": ("pressure B", "MPa", 1e-6),
    "piston_position": ("piston position", "mm", 1e3),
    "piston_velocity": ("piston velocity", "mm/s", 1e3),
    "valve_current": ("valve current", "mA", 1e3),
    "nominal_valve_current": ("nominal", "mA", 1e3),
    "reference_force": ("reference", "N", 1.0),
    "reference_force_rate": ("reference rate", "kN/s", 1e-3),
    "proportional_gain": (r"$K_p$", "1/s", 1.0),
    "integral_gain": (r"$K_i$", "1/s²", 1.0),
}
"""Display of a BenchState field: name, unit, factor from SI."""

STYLE: dict[str, Any] = {
    "axes.axisbelow": True, "axes.edgecolor": "#5b6068", "axes.grid": True, "axes.labelcolor": "#2b2f36",
    "axes.prop_cycle": cycler(color=[BLUE, ORANGE, GREEN, RED, PURPLE, SKY, GRAY]),
    "axes.spines.right": False, "axes.spines.top": False,
    "axes.titlelocation": "left", "axes.titlesize": 11, "axes.titleweight": "semibold",
    "figure.constrained_layout.use": True, "figure.dpi": 150, "font.size": 9,
    "grid.color": "#e3e5e8", "grid.linewidth": 0.7, "legend.frameon": False, "legend.handlelength": 1.4,
    "lines.linewidth": 1.2, "xtick.color": "#5b6068", "ytick.color": "#5b6068",
}  # fmt: skip


@contextmanager
def figure(
    path: str | Path, rows: int = 1, *, size: tuple[float, float], **layout: Any
) -> Iterator[tuple[Figure, Any]]:
    """Open a figure of `rows` axes above one another (shape (rows,)) in `STYLE`; saved to `path` at the end.

    `path`: file to write, its suffix decides the format; missing folders are created. `size`: width and height [inch].
    `layout`: passed on to `Figure.subplots`.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=size)
        FigureCanvasAgg(drawing)
        yield drawing, drawing.subplots(rows, 1, squeeze=False, **layout)[:, 0]
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        content = BytesIO()
        drawing.savefig(content, format=Path(path).suffix[1:] or None)
        write_atomic(Path(path), content.getvalue())


def add_legend(axes: Axes) -> None:
    """Add a legend in one row above the axes."""
    entries = len(axes.get_legend_handles_labels()[0])
    if entries:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=entries, borderaxespad=0.2)
