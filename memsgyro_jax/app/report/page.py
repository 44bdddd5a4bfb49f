"""A report page: sections of text, tables and figures in one HTML file that loads nothing from anywhere.

Everything that is not a figure is escaped, and what stands between backticks is set as code; figures are SVG drawn here
by matplotlib. The page's content policy forbids scripts and every outside resource, so that a report may be opened from
an untrusted share.
"""

import io
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup, escape

from memsgyro_jax.base.files import write_whole
from memsgyro_jax.base.made_by import made_by


if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Page:
    """Builds a page from top to bottom.

    page = Page("Coupling errors", "sweep.csv")
    page.section("Result").text("...").table(["name", "value"], [["c_xy", "-6.96e-08"]])
    page.save("report.html")
    """

    def __init__(self, title: str, subtitle: str = "", footer: str | None = None):
        self.title, self.subtitle = title, subtitle
        self.footer = made_by() if footer is None else f"{footer} {made_by()}"
        self._sections: list[dict] = []

    def section(self, title: str) -> "Page":
        """Begin a section; what follows goes into it."""
        self._sections.append({"title": title, "parts": []})
        return self

    def text(self, text: str) -> "Page":
        """A paragraph of plain text."""
        return self._add("text", text=text)

    def table(
        self, header: Sequence[str], rows: Sequence[Sequence[object]], caption: str = "", *, stacked: bool = False
    ) -> "Page":
        """A table; every cell is shown as its text, columns that hold numbers only flush right. The last cell of a row
        that is short spans what is left. `stacked` rows stand one cell below the other where the page is narrow.
        """
        cells = [[str(cell) for cell in row] for row in rows]
        whole = [row for row in cells if len(row) == len(header)]
        numeric = [bool(whole) and all(_is_number(row[i]) for row in whole) for i in range(len(header))]
        return self._add("table", header=list(header), rows=cells, caption=caption, numeric=numeric, stacked=stacked)

    def figure(self, figure: "Figure", caption: str) -> "Page":
        """A matplotlib figure, as SVG within the page."""
        return self._add("figure", svg=_svg(figure, self._salt), caption=caption)

    def figures(self, figures: "Sequence[tuple[Figure, str]]") -> "Page":
        """Small figures with their captions, side by side as far as the page is wide."""
        drawn = [(_svg(figure, f"{self._salt}-{n}"), caption) for n, (figure, caption) in enumerate(figures)]
        return self._add("figures", figures=drawn)

    @property
    def _salt(self) -> str:
        return f"figure-{sum(len(s['parts']) for s in self._sections)}"

    def drawing(self, svg: Markup, caption: str) -> "Page":
        """A picture that is an SVG already."""
        return self._add("figure", svg=svg, caption=caption)

    def html(self) -> str:
        """The page as text."""
        return _template().render(title=self.title, subtitle=self.subtitle, sections=self._sections, footer=self.footer)

    def save(self, path: str | Path) -> Path:
        """Write the page, whole or not at all."""
        return write_whole(path, self.html())

    def _add(self, kind: str, **content: Any) -> "Page":
        if not self._sections:
            self.section("")
        self._sections[-1]["parts"].append({"kind": kind, **content})
        return self


@cache
def _template() -> Template:
    # Autoescape is unconditional: no file name decides whether a user's text is trusted.
    environment = Environment(
        loader=PackageLoader("memsgyro_jax.app.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"marked": _marked, "unmarked": lambda text: text.replace("`", "")}
    return environment.get_template("page.html")


def _marked(text: str) -> Markup:
    """Text whose `names` are set as code; all of it is escaped first."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def _svg(figure: "Figure", salt: str) -> Markup:
    import matplotlib as mpl

    buffer = io.StringIO()
    # Text stays text (small, selectable, searchable); the salt keeps ids of several figures on one page apart and
    # reproducible.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": salt, "font.family": "sans-serif"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None}, bbox_inches="tight")
    text = buffer.getvalue()
    return Markup(text[text.index("<svg") :])  # without the XML prolog, which has no place inside HTML


def _is_number(text: str) -> bool:
    head = text.strip().removeprefix("< ").split(" ")[0].rstrip("%").replace("−", "-")
    try:
        float(head)
    except ValueError:
        return text.strip() in {"", "-", "–"}
    return True
