"""A self-contained page: sections of text, figures and tables in one HTML file.

>>> page = Page("Title", "what it is about")
>>> page.section("Results").text("Three runs.").table(["run", "error"], [["a", 0.1]])
Page('Title')
>>> "<table>" in page.html()
True
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from contextlib import AbstractContextManager
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler

from ffl.systems.atomic import write_text

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

Dash = str | tuple[int, tuple[int, ...]]
# Okabe and Ito's colours, which stay apart for every kind of colour vision; order for lines.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#1b1f24", "#8c6d31")
LINES: tuple[Dash, ...] = (
    "-",
    "--",
    "-.",
    (0, (1, 1)),
    (0, (5, 1, 1, 1, 1, 1)),
    (0, (7, 2)),
    "-",
    "--",
)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")

STYLE: dict[RcKeyType, Any] = {
    "font.size": 10.0,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.prop_cycle": cycler(color=COLOURS),
    "grid.color": "#e4e8ec",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "lines.linewidth": 1.5,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "legend.handlelength": 2.8,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-2, 4),
    "axes.formatter.use_mathtext": True,
    "svg.fonttype": "path",
    "svg.hashsalt": "ffl",
}
SVG_LIMIT = 300_000  # bytes; a figure with more points than that is drawn as pixels instead


def drawing() -> AbstractContextManager[None]:
    """The project's style, to draw in: `with drawing(): figure, axes = subplots(...)`."""
    return rc_context(STYLE)


def subplots(
    width: float = 8.6, height: float = 3.6, rows: int = 1, columns: int = 1, **options: Any
) -> tuple[Figure, Any]:
    """A figure (inches) and its axes, an array where there are several; no global state."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def png_bytes(figure: Figure, dpi: int = 110) -> bytes:
    """The figure as PNG."""
    buffer = io.BytesIO()
    with drawing():
        figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def image_source(figure: Figure) -> str:
    """The figure as a data URI: SVG where that stays small, PNG otherwise."""
    buffer = io.BytesIO()
    with drawing():
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    content, kind = buffer.getvalue(), "svg+xml"
    if len(content) > SVG_LIMIT:
        content, kind = png_bytes(figure, 160), "png"
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def number(value: Any, digits: int = 4) -> str:
    """A number for people: `digits` significant ones, a blank where there is none."""
    if value is None:
        return ""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    return str(value) if isinstance(value, int) else f"{value:.{digits}g}"


@cache
def _template() -> Any:
    import jinja2

    text = resources.files("ffl.report").joinpath("page.html.j2").read_text()
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(text)


class Page:
    """Sections in reading order; every method returns the page, so that calls chain.

    All text is escaped. `figure` closes nothing and keeps no state of matplotlib.
    """

    def __init__(self, title: str, lead: str = "") -> None:
        self.title, self.lead = title, lead
        self.footer = ""
        self._sections: list[dict[str, Any]] = []

    def __repr__(self) -> str:
        return f"Page({self.title!r})"

    def section(self, title: str) -> Page:
        """Begins a section; what follows stands in it."""
        anchor = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
        taken = sum(section["anchor"].startswith(anchor) for section in self._sections)
        anchor = f"{anchor}-{taken + 1}" if taken else anchor
        self._sections.append({"title": title, "anchor": anchor, "blocks": []})
        return self

    def text(self, text: str) -> Page:
        return self._add(kind="text", text=text)

    def heading(self, text: str) -> Page:
        return self._add(kind="heading", text=text)

    def note(self, text: str, tone: str = "") -> Page:
        """A remark set apart; `tone` is "good", "bad" or empty."""
        return self._add(kind="note", text=text, tone=tone)

    def pre(self, text: str) -> Page:
        """Text as it stands, such as a configuration."""
        return self._add(kind="pre", text=text)

    def facts(self, facts: Sequence[tuple[str, Any]]) -> Page:
        """Headline figures: (what, value) each."""
        return self._add(kind="facts", facts=[(what, number(value, 3)) for what, value in facts])

    def figure(self, figure: Figure, title: str, caption: str) -> Page:
        """A figure with what one sees and how to read it."""
        return self._add(kind="figure", source=image_source(figure), title=title, caption=caption)

    def table(
        self, header: Sequence[str], rows: Sequence[Sequence[Any]], caption: str = ""
    ) -> Page:
        """A table; columns that hold numbers only are set right."""
        right = [
            bool(rows) and all(row[k] is None or isinstance(row[k], (int, float)) for row in rows)
            for k in range(len(header))
        ]
        cells = [[number(value) for value in row] for row in rows]
        return self._add(
            kind="table", header=list(header), rows=cells, right=right, caption=caption
        )

    def _add(self, **block: Any) -> Page:
        if not self._sections:
            self.section("Overview")
        self._sections[-1]["blocks"].append(block)
        return self

    def html(self) -> str:
        style = resources.files("ffl.report").joinpath("style.css").read_text()
        return str(
            _template().render(
                title=self.title,
                lead=self.lead,
                style=style,
                sections=self._sections,
                footer=self.footer,
            )
        )

    def write(self, path: Path) -> None:
        """Writes the page aside, then renames it."""
        write_text(path, self.html())
