"""A report page is one file that escapes what it is given, loads nothing and is written whole."""

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from memsgyro_jax.app.report.page import Page
from memsgyro_jax.base.files import write_whole


def drawn(text="µm"):
    figure = Figure(figsize=(3, 2))
    ax = figure.subplots()
    ax.plot([0, 1], [0, 1])
    ax.set_xlabel(text)
    return figure


class Tags(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags, self.attributes = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs


EVIL = '<script>alert("x")</script>"><img src=x onerror=alert(1)>'


def evil_page():
    return (
        Page(EVIL, EVIL, EVIL).section(EVIL).text(EVIL).table([EVIL], [[EVIL]], EVIL).figure(drawn(EVIL), EVIL).html()
    )


def test_everything_is_escaped():
    page = Tags(evil_page())
    assert "script" not in page.tags
    assert "img" not in page.tags
    assert not any(name.startswith("on") for name, _ in page.attributes)


def test_nothing_is_loaded_from_anywhere():
    html = evil_page()
    assert "default-src 'none'" in html
    links = [value for name, value in Tags(html).attributes if name in {"src", "href", "xlink:href"} and value]
    assert all(link.startswith("#") for link in links)
    assert not re.search(r"url\((?!#)|@import", html)


def test_ids_of_two_figures_do_not_collide():
    page = Page("two").section("a").figure(drawn(), "one").figure(drawn(), "two").html()
    clips = re.findall(r'<clipPath id="([^"]+)"', page)
    assert len(clips) == len(set(clips)) == 2


def test_the_same_page_is_the_same_text():
    assert evil_page() == evil_page()


def test_numbers_are_set_flush_right():
    html = Page("t").section("s").table(["name", "value"], [["c_xy", "-7e-08"], ["k_xy", "–"]]).html()
    assert html.count('<td class="number">') == 2
    assert "<td>c_xy</td>" in html


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "report.html"
    Page("old").save(path)
    before = path.read_text()

    def full(part, content, write=Path.write_bytes):
        write(part, content[:10])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, "new and longer than ten letters")
    assert path.read_text() == before
    assert list(tmp_path.iterdir()) == [path]
