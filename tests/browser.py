"""Pages as a browser lays them out: what runs wide, what is fetched, what is said on its console."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest


PHONE, SCREEN = 390, 1280
# The frame's script belongs to the test: the page within is under its own policy, which forbids all scripts.
FRAME = """<!DOCTYPE html><body>{frames}<script>
const found = [];
window.onload = () => {{
  for (const frame of document.querySelectorAll('iframe')) {{
    const page = frame.contentDocument, root = page.documentElement, box = frame.contentWindow.innerWidth;
    const wide = [...page.querySelectorAll('body *')].filter(e => !e.closest('.wide') && !e.closest('svg')
      && e.getBoundingClientRect().right > box + 1).map(e => e.tagName.toLowerCase() + '.' + e.className);
    found.push({{page: frame.dataset.page, width: +frame.width, inside: root.scrollWidth, box: root.clientWidth,
      beyond: wide.slice(0, 3), fetched: frame.contentWindow.performance.getEntriesByType('resource').map(r => r.name),
      scripts: page.scripts.length, ink: frame.contentWindow.getComputedStyle(page.body).color}});
  }}
  document.title = JSON.stringify(found);
}};
</script></body>"""


class Seen(NamedTuple):
    """A page in a frame of some width."""

    page: str
    width: int
    inside: int
    box: int
    beyond: list
    fetched: list
    scripts: int
    ink: str


def run(folder: Path, *flags: str) -> subprocess.CompletedProcess:
    """The browser with a profile of its own; skips the test where none is found."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium on this machine: how pages look in a browser was not checked")
    usual = [
        "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update",
        "--enable-logging=stderr",
        "--allow-file-access-from-files", f"--user-data-dir={folder / 'profile'}",
    ]  # fmt: skip
    return subprocess.run([browser, *usual, *flags], capture_output=True, text=True, check=False, timeout=120)


def seen(folder: Path, pages: dict[str, str], *, dark: bool = False, widths=(PHONE, SCREEN)) -> list[Seen]:
    """Every page (name and HTML) at every width, all in one start of the browser."""
    frames = ""
    for name, text in pages.items():
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
        frames += "".join(
            f'<iframe data-page="{name}" src="{name}.html" width="{width}" height="900"></iframe>' for width in widths
        )
    (folder / "frames.html").write_text(FRAME.format(frames=frames), encoding="utf-8")
    # No address is known, so that nothing that is asked of another machine is waited for.
    scheme = ["--host-resolver-rules=MAP * ~NOTFOUND", *(["--blink-settings=preferredColorScheme=0"] if dark else [])]
    done = run(folder, *scheme, "--window-size=1400,1000", "--dump-dom", str(folder / "frames.html"))
    told = re.search(r"<title>(\[.*?\])</title>", done.stdout, re.DOTALL)
    assert told, done.stderr
    complaints = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert not complaints, complaints
    return [Seen(**entry) for entry in json.loads(told[1].replace("&amp;", "&"))]


def check(folder: Path, pages: dict[str, str]) -> list[Seen]:
    """Nothing overflows a phone or a screen but what is meant to scroll; nothing is fetched, no script is there."""
    found = seen(folder, pages)
    for one in found:
        assert one.inside <= one.box, one
        assert not one.beyond, one
        assert not one.fetched, one
        assert not one.scripts, one
    return found
