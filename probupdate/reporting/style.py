"""One look for every figure, and figures as SVG text that is the same for the same input.

Colours are those of Okabe and Ito, which people with a colour-vision deficiency distinguish; every series also has
its own marker or line, so that a grey print says the same.
"""

from __future__ import annotations

import functools
import io
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypedDict, TypeVar

import matplotlib
from matplotlib.axes import Axes
from matplotlib.axis import Axis, Tick
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, LogFormatterMathtext

from probupdate.io.files import written_whole

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

P = ParamSpec("P")
T = TypeVar("T")

# widths in inches of figures across the page and of two side by side: letters come out equally large
FULL_IN, HALF_IN = 7.6, 4.3

INK, GREY, PALE, GRID = "#1d2733", "#6b7684", "#c3cad2", "#e6e9ed"
BLUE, ORANGE, GREEN, RED, PURPLE, SKY = (
    "#0072b2", "#e69f00", "#009e73", "#d55e00", "#aa4f87", "#56b4e9",
)


class Role(TypedDict):
    """How one thing is drawn, the same in every figure; a line style by its name or as (offset, (on, off, ...))."""

    color: str
    marker: str
    linestyle: str | tuple[float, tuple[float, ...]]


MEASURED: Role = {"color": INK, "marker": "o", "linestyle": "-"}
PRIOR: Role = {"color": GREY, "marker": "D", "linestyle": (0, (4, 2))}
POSTERIOR: Role = {"color": BLUE, "marker": "s", "linestyle": "-"}
MAP: Role = {"color": GREEN, "marker": "^", "linestyle": (0, (1, 1))}
STEP_UPDATE: Role = {"color": RED, "marker": "X", "linestyle": (0, (5, 1, 1, 1))}
PRIOR_UPDATE: Role = {"color": ORANGE, "marker": "v", "linestyle": (0, (3, 1, 1, 1, 1, 1))}
TRUTH: Role = {"color": INK, "marker": "*", "linestyle": "-"}

_STYLE: dict[RcKeyType, object] = {
    "svg.hashsalt": "probupdate",
    "svg.fonttype": "none",
    "text.parse_math": False,  # a name with dollar signs in it is a name
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "axes.unicode_minus": True,
    "grid.color": GRID,
    "grid.linewidth": 0.8,
    "text.color": INK,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "figure.facecolor": "none",
    "axes.facecolor": "white",
    "savefig.facecolor": "none",
    "lines.linewidth": 1.4,
}
# matplotlib's own method of an axis that finds its ticks, in none of its published interfaces
_FIND_TICKS = "_update_ticks"


def with_style(draw: Callable[P, T]) -> Callable[P, T]:
    """Run a drawing function under this style; matplotlib's own settings are left as they were."""

    @functools.wraps(draw)
    def draw_styled(*args: P.args, **kwargs: P.kwargs) -> T:
        with matplotlib.rc_context(_STYLE):
            return draw(*args, **kwargs)

    return draw_styled


def new_figure(width_in: float, height_in: float) -> Figure:
    """A figure that belongs to no window system and no global list."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def label_axes(axes: Axes, x: str, y: str, title: str = "") -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if title:
        axes.set_title(title)


def _write_powers_plainly(figure: Figure) -> None:
    """Labels of logarithmic axes as 1e-4: matplotlib writes them as mathematics, which names in this style are not."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            for label, change in ((axis.get_major_formatter(), axis.set_major_formatter),
                                  (axis.get_minor_formatter(), axis.set_minor_formatter)):
                if isinstance(label, LogFormatterMathtext):
                    # of small ranges labels stand between the powers too
                    change(LogFormatter(labelOnlyBase=label.labelOnlyBase, minor_thresholds=label.minor_thresholds))


def save_figure(figure: Figure, path: Path) -> None:
    """The figure as a file of its own, on white, the same bytes for the same figure."""
    # a PDF has a date where others have none to leave out
    key = {".svg": "Date", ".pdf": "CreationDate"}.get(path.suffix)
    with matplotlib.rc_context(_STYLE):
        _write_powers_plainly(figure)
        metadata = None if key is None else {key: None}
        with written_whole(path) as part:
            figure.savefig(part, format=path.suffix[1:], dpi=160, facecolor="white", metadata=metadata)


@contextmanager
def ticks_found_once(figure: Figure) -> Iterator[None]:
    """matplotlib finds an axis's ticks some ten times while it draws a figure, for labels, frames, titles and both
    rounds of its layout: within this block once for each place and range of the axis. The picture is the same."""
    found = [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]
    for axis in found:
        # an attribute of this one axis, in front of its class's method
        vars(axis)[_FIND_TICKS] = functools.partial(_ticks, axis, {})
    try:
        yield
    finally:
        for axis in found:
            del vars(axis)[_FIND_TICKS]


def _ticks(axis: Axis, known: dict) -> list[Tick]:
    state = (*axis.get_view_interval(), *axis.axes.bbox.bounds)
    if state not in known:
        # ticks are moved, not made again: what was found for another state no longer holds
        known.clear()
        known[state] = getattr(type(axis), _FIND_TICKS)(axis)
    return known[state]


_KEPT: ContextVar[list[tuple[str, Figure]] | None] = ContextVar("kept figures", default=None)


@contextmanager
def collected_figures() -> Iterator[list[tuple[str, Figure]]]:
    """The figures that `svg_text` is given within this block, with their prefixes, in order."""
    found: list[tuple[str, Figure]] = []
    before = _KEPT.set(found)
    try:
        yield found
    finally:
        _KEPT.reset(before)


def svg_text(figure: Figure, prefix: str) -> str:
    """The figure as an <svg> element for inline use; `prefix` keeps its ids apart from other figures' ids."""
    if (kept := _KEPT.get()) is not None:
        kept.append((prefix, figure))
    stream = io.StringIO()
    with matplotlib.rc_context(_STYLE):
        figure.set_dpi(160)
        _write_powers_plainly(figure)
        # not savefig, which draws everything once more before, for a layout that the drawing itself makes too
        with ticks_found_once(figure):
            FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    text = text[text.index("<svg"):]
    # the page scales it: no fixed size, and no declarations a page does not need
    text = re.sub(r'<svg ([^>]*?)width="[^"]*"', r"<svg \1", text, count=1)
    text = re.sub(r'<svg ([^>]*?)height="[^"]*"', r"<svg \1", text, count=1)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, count=1, flags=re.DOTALL)
    text = _number_ids(text)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{prefix}-\1"', text)
    text = text.replace("'DejaVu Sans'", "'DejaVu Sans', Verdana, 'Segoe UI', Arial")
    return text.strip()


def _number_ids(svg: str) -> str:
    """Ids that matplotlib makes by hashing coordinates (of clips and markers) counted instead: a layout solved again
    may differ in a coordinate's last bits, which are not written, and would be another id."""
    made = r"[a-z][0-9a-f]{10}"
    names = {name: f"n{k}" for k, name in enumerate(dict.fromkeys(re.findall(rf'\bid="({made})"', svg)))}
    return re.sub(rf'(?<=["#]){made}(?=[")])', lambda found: names.get(found[0], found[0]), svg)
