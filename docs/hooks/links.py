"""Links of the finished site: every one that stays inside leads to a page, and to a place on it that is there."""

import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class _Parsed(HTMLParser):
    """What a page points to, and what can be pointed to on it."""

    def __init__(self, text: str):
        super().__init__()
        self.links: list[str] = []
        self.places: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("href", "src") and value:
                self.links.append(value)
            elif name in ("id", "name") and value:
                self.places.add(value)


def broken(site: Path) -> list[str]:
    """A sentence for each link that leads nowhere."""
    pages = {path.resolve(): _Parsed(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    return [
        f"{path.relative_to(site.resolve())}: {why}"
        for path, page in pages.items()
        for why in _broken_on(path, page, pages)
    ]


def _broken_on(path: Path, page: _Parsed, pages: dict[Path, _Parsed]) -> Iterator[str]:
    for link in dict.fromkeys(page.links):
        parts = urlsplit(link)
        if parts.scheme or parts.netloc:
            if parts.scheme not in ("https", "mailto", "data"):
                yield f"{link} is neither a file of the site nor an https address"
            continue
        target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
        if path.name == "404.html" and parts.path.startswith("/"):
            continue  # counts from the root of wherever the site is put
        if not target.is_file():
            yield f"{link} leads to no file"
        elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].places:
            yield f"{link} leads to no place on that page"


_FETCHING = re.compile(r"<(?:script|img|iframe|source|object|link)\b[^>]*>")
_ADDRESS = re.compile(r"\b(?:src|href|data)=\"?(https?:[^\">\s]+)")


def requests(site: Path) -> list[str]:
    """What a page would fetch from elsewhere when it is opened; where a page says it lies is no request."""
    found = []
    for path in sorted(site.rglob("*.html")):
        for tag in _FETCHING.findall(path.read_text(encoding="utf-8")):
            if "canonical" not in tag:
                found += [f"{path.relative_to(site)}: {address}" for address in _ADDRESS.findall(tag)]
    return found
