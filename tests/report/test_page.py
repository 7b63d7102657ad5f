import base64
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from ffl.report.page import Page, drawing, image_source, number, png_bytes, subplots


def drawn(points=50):
    with drawing():
        figure, ax = subplots()
        rng = np.random.default_rng(0)
        ax.plot(rng.standard_normal(points), rng.standard_normal(points), ",")
        ax.set_xlabel("time [s]")
    return figure


class Check(HTMLParser):
    """Every element closed in order; nothing fetched from elsewhere."""

    VOID = frozenset({"meta", "img", "br", "hr", "link"})

    def __init__(self):
        super().__init__()
        self.stack, self.sources = [], []

    def handle_starttag(self, tag, attrs):
        if tag not in self.VOID:
            self.stack.append(tag)
        self.sources += [value for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag):
        assert self.stack.pop() == tag


@pytest.fixture
def page():
    made = Page("A <title>", "what & why")
    made.section("First one").text("1 < 2").note("mind", "bad").facts([("figure", 0.12345)])
    made.table(["run", "error"], [["a", 0.5], ["b", None]], "says it all")
    made.section("First one").figure(drawn(), "A figure", "What one sees.").pre("x = [1]\ny = 2")
    made.section("Last").heading("Small")
    return made


def test_the_page_is_one_sound_file(page, tmp_path):
    page.write(tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    check = Check()
    check.feed(text)
    assert check.stack == []
    assert all(source.startswith(("data:image/", "#")) for source in check.sources)
    assert "http://" not in re.sub(r'src="data:[^"]*"', "", text)
    assert {"#first-one", "#first-one-2", "#last"} <= set(check.sources)
    assert "A &lt;title&gt;" in text
    assert "1 &lt; 2" in text
    assert '"Segoe UI"' in text  # the style is not escaped
    assert '<td class="number">0.5</td>' in text
    assert list(tmp_path.iterdir()) == [tmp_path / "page.html"]


def test_figures_are_the_same_every_time(page):
    assert image_source(drawn()) == image_source(drawn())


def test_large_figures_become_pixels():
    assert image_source(drawn()).startswith("data:image/svg+xml;base64,")
    source = image_source(drawn(40000))
    kind, data = source.split(",")
    assert kind == "data:image/png;base64"
    assert base64.b64decode(data)[:4] == b"\x89PNG"
    assert png_bytes(drawn())[:4] == b"\x89PNG"


def test_drawing_leaves_no_trace():
    from matplotlib import rcParams

    before = rcParams["font.size"], rcParams["axes.grid"]
    drawn()
    assert (rcParams["font.size"], rcParams["axes.grid"]) == before


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, ""), (3, "3"), (0.123456, "0.1235"), ("a", "a"), (True, "True"), (1e-9, "1e-09")],
)
def test_numbers(value, text):
    assert number(value) == text
