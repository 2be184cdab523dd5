"""The look of all figures: matplotlib draws each, as a PNG on white and as SVG in the colours of a page."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any, Literal, NamedTuple

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator

INK, SOFT, LINE = "#1b2430", "#5b6675", "#dde2e9"
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b58900", "#56b4e9", "#7f7f7f")
"""Colours of series, which colour-blind people tell apart: those of Okabe and Ito (2008), yellow darkened."""

PANEL_SIZE = (3.6, 2.3)
"""Width and height of a panel in inches: as wide as a phone, at a readable size of letters."""

_LEFT, _RIGHT, _TOP, _BOTTOM = 0.72, 0.12, 0.32, 0.42
"""Inches around the axes of a panel. Letting matplotlib find them would take most of the time of a page."""
_LEGEND_LINE = 0.28

_CSS_COLOURS = {INK: "var(--ink)", SOFT: "var(--soft)", LINE: "var(--line)"} | {
    colour: f"var(--s{number})" for number, colour in enumerate(SERIES)
}
_COLOUR = re.compile("|".join(_CSS_COLOURS))
_HEADER = re.compile(r"^.*?<svg [^>]*?viewBox=\"0 0 ([\d.]+) ([\d.]+)\"[^>]*>", re.DOTALL)
_GROUP_ID = re.compile(r"<g id=\"[^\"]*\"")
_STYLE = re.compile(r"<style.*?</style>", re.DOTALL)

FAINT: dict[str, Any] = {"alpha": 0.35, "linewidth": 0.8}
POINT: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 4}
TRIANGLE: dict[str, Any] = {"linestyle": "", "marker": "v", "markersize": 6}
_LOOKS: dict[str, dict[str, Any]] = {
    "line": {},
    "faint": FAINT,
    "point": POINT,
    "triangle": TRIANGLE,
    "area": {"linewidth": 7},
}

styled = matplotlib.rc_context(
    {
        "axes.axisbelow": True,
        "axes.edgecolor": SOFT,
        "axes.grid": True,
        "axes.labelcolor": SOFT,
        "axes.spines.right": False,
        "axes.spines.top": False,
        "axes.titlecolor": INK,
        "axes.titlelocation": "left",
        "axes.titlesize": 10,
        "axes.titleweight": "bold",
        "figure.facecolor": "white",
        "font.family": "DejaVu Sans",  # comes with matplotlib
        "font.size": 9,
        "grid.color": LINE,
        "grid.linewidth": 0.7,
        "legend.frameon": False,
        "lines.linewidth": 1.8,
        "savefig.dpi": 160,
        "savefig.facecolor": "white",
        "svg.fonttype": "none",  # text stays text
        "svg.hashsalt": "gem",  # the same figure is the same file
        "text.color": INK,
        "text.parse_math": False,  # a dollar sign is a dollar sign
        "xtick.color": SOFT,
        "ytick.color": SOFT,
    }
)
"""Decorator of functions that draw or save: the options of matplotlib that hold meanwhile."""

DrawPanel = Callable[[Axes], None]


class Key(NamedTuple):
    """An entry of a legend.

    Args:
        label: What a line or point stands for.
        series: The number of its colour.
        look: How it is drawn.
    """

    label: str
    series: int
    look: Literal["line", "faint", "point", "triangle", "area"] = "line"


@styled
def grid_figure(panels: Sequence[DrawPanel], legend: Sequence[Key] = ()) -> Figure:
    """Draw panels in rows of up to three, with a legend above them."""
    columns = 2 if len(panels) == 4 else min(len(panels), 3)
    rows = -(-len(panels) // columns)
    keys_in_line = 2 * columns if columns > 1 else 1
    above = _LEGEND_LINE * -(-len(legend) // keys_in_line)
    figure = Figure(figsize=(PANEL_SIZE[0] * columns, PANEL_SIZE[1] * rows + above))
    axes = figure.subplots(rows, columns, squeeze=False, gridspec_kw=_margins(rows, columns, above)).flat
    for draw, each in zip(panels, axes, strict=False):
        draw(each)
    for unused in axes[len(panels) :]:
        unused.remove()
    if legend:
        lines = [Line2D([], [], color=series_colour(key.series), label=key.label, **_LOOKS[key.look]) for key in legend]
        figure.legend(handles=lines, loc="upper left", ncols=keys_in_line)
    return figure


@styled
def panel_figure(draw: DrawPanel, height: float | None = None) -> Figure:
    """Draw one panel, of a height in inches where its labels decide how wide the rest is."""
    if height is None:
        return grid_figure([draw])
    figure = Figure(figsize=(PANEL_SIZE[0], height), layout="constrained")
    draw(figure.subplots())
    return figure


@styled
def save_png(figure: Figure, path: str | Path) -> Path:
    """Write a figure as a PNG, and return its path."""
    figure.savefig(path, format="png")
    return Path(path)


@styled
def svg_text(figure: Figure, title: str) -> str:
    """Return a figure as an ``<svg>`` element to stand in a page, coloured by the page's variables.

    Args:
        figure: What ``styled`` functions drew.
        title: What a screen reader says.
    """
    file = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    figure.savefig(file, format="svg", transparent=True, metadata=nothing)
    text = _HEADER.sub(lambda found: _header(float(found[1]), float(found[2]), title), file.getvalue(), count=1)
    text = _STYLE.sub("", text)  # would hold for the whole page; the page has it for its figures
    text = _GROUP_ID.sub("<g", text)  # figures in one page would share them
    return _COLOUR.sub(lambda found: _CSS_COLOURS[found[0]], text)


def series_colour(number: int) -> str:
    """Return the colour of a series, counted from 0."""
    return SERIES[number % len(SERIES)]


def label_numbers(axes: Axes, *, percent: bool = False) -> None:
    """Number the vertical axis plainly, shares in percent, and the horizontal one by whole numbers."""
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_formatter(number_formatter(percent=percent))
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True, steps=[1, 2, 5, 10]))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    axes.tick_params(length=0)


def number_formatter(*, percent: bool = False) -> FuncFormatter:
    """Return what writes the numbers of an axis."""
    return FuncFormatter(lambda value, _: number_text(value, percent=percent))


def number_text(value: float, *, percent: bool = False) -> str:
    """Return a number of an axis."""
    return f"{100 * value:.4g} %" if percent else f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def _header(width: float, height: float, title: str) -> str:
    """Return the opening tag of a figure: as wide as its place, up to half as large again as it was drawn."""
    size = f'viewBox="0 0 {width:g} {height:g}" style="max-width: {1.5 * width:g}px"'
    return f'<svg {size} role="img" aria-label="{escape(title)}">'


def _margins(rows: int, columns: int, above: float) -> dict[str, float]:
    """Return where the axes of a grid lie, in matplotlib's shares of the figure and of an axes."""
    width, height = PANEL_SIZE
    total = height * rows + above
    return {
        "left": _LEFT / (width * columns),
        "right": 1 - _RIGHT / (width * columns),
        "bottom": _BOTTOM / total,
        "top": 1 - (_TOP + above) / total,
        "wspace": (_LEFT + _RIGHT) / (width - _LEFT - _RIGHT),
        "hspace": (_TOP + _BOTTOM) / (height - _TOP - _BOTTOM),
    }
