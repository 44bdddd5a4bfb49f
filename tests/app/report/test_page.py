"""A report page is one file that escapes what it is given, loads nothing and is written whole."""

import re
from html.parser import HTMLParser
from pathlib import Path

import browser
import pytest
from matplotlib.figure import Figure

from memsgyro_jax.app.report.page import Page
from memsgyro_jax.base import made_by
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


def test_names_of_the_study_are_set_as_code():
    """Pages showed the marks of a terminal, `settle`."""
    said, code = "a longer `sweep.settle` or `<b>`", "<code>sweep.settle</code> or <code>&lt;b&gt;</code>"
    html = Page("one").section(said).text(said).table([said], [[said]], said).figure(drawn(), said).html()
    assert html.count(code) == 6  # title of the section, text, head, cell, captions of the table and the figure
    assert "`" not in html
    assert 'aria-label="a longer sweep.settle or &lt;b&gt;"' in html


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


def test_a_page_says_when_by_what_and_how_it_was_made():
    made_by.called(["sweep", "my study.toml"])
    made = re.search("<footer>(.*)</footer>", Page("Title").html())[1]
    made_by._COMMAND.set("")
    stamp, command = made.split(" UTC, by ")
    assert re.fullmatch(r"memsgyro_jax \S+, \d{4}-\d\d-\d\d \d\d:\d\d", stamp)
    assert command == "memsgyro sweep &#39;my study.toml&#39;"
    assert re.search(r"UTC</footer>", Page("Title").html()), "no command line where there was none"


def test_a_browser_finds_nothing_wrong_and_would_find_it(tmp_path):
    """Nothing overflows a phone or a screen, is fetched or runs; and each of these is seen where it is so."""
    page = Page("A title with a long_word_" + "x" * 20, "subtitle").section("A section").text("Words. " * 40)
    page.table([f"column {k}" for k in range(12)], [["some words"] * 12] * 3, "A caption. " * 20)
    page.table([f"column {k}" for k in range(6)], [["some words"] * 6, ["name", "why not " * 9]], stacked=True)
    page.figures([(drawn(), "one")] * 3)
    html = page.figure(drawn(), "a figure").html()
    light = browser.check(tmp_path, {"page": html})
    bad = '<body><p style="width: 700px">wide</p><img src="https://nowhere.invalid/"><script></script></body>'
    phone, screen, dark, _ = browser.seen(tmp_path, {"bad": bad, "page": html}, dark=True)
    assert phone.inside > phone.box
    assert phone.beyond == ["p."]
    assert not screen.beyond
    assert screen.fetched == ["https://nowhere.invalid/"]
    assert screen.scripts == 1
    assert (light[0].ink, dark.ink) == ("rgb(29, 37, 48)", "rgb(228, 232, 238)")
    with pytest.raises(AssertionError, match="Content Security Policy"):
        browser.seen(tmp_path, {"bad": html.replace("<main>", '<main><img src="https://nowhere.invalid/">')})
