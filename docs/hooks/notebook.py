"""Writes pages as notebooks: `python docs/hooks/notebook.py docs/control.md` gives control.ipynb, with its results.

The page stays the source; a notebook is what its blocks gave when it was run. Text becomes text, `python` a cell,
`sh` a cell of commands, a file that the page writes a cell that writes it.
"""

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any


sys.path.insert(0, str(Path(__file__).parent))

from blocks import FENCE, ROOT, Executed, execute, prepare


RESULT = re.compile(
    r"\s*(?:``` \{ \.text \.output \}\n(?P<printed>.*?)\n```\n"
    r"|!\[(?P<told>[^\]]*)\]\((?P<figure>[^)]+)\)\{ \.figure[^}]*\}\n"
    r"|\[(?P<said>[^\]]*)\]\((?P<page>[^)]+)\)\{ \.report \}\n)",
    re.DOTALL,
)


def notebook(page: Executed) -> dict[str, Any]:
    """The page as a notebook of format 4.5."""
    cells, place = [], 0
    while block := FENCE.search(page.text, place):
        cells += _text(page.text[place : block.start()])
        place = block.end()
        outputs = []
        while result := RESULT.match(page.text, place):
            place = result.end()
            outputs += _output(result, page)
        cells.append(_code(*block.groups(), outputs))
    cells += _text(page.text[place:])
    for number, cell in enumerate(cells):
        cell["id"] = f"cell-{number}"
    about = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return {"nbformat": 4, "nbformat_minor": 5, "metadata": about, "cells": cells}


def _text(text: str) -> list[dict[str, Any]]:
    return [{"cell_type": "markdown", "metadata": {}, "source": text.strip()}] if text.strip() else []


def _code(language: str, title: str | None, code: str, outputs: list[dict[str, Any]]) -> dict[str, Any]:
    if language not in ("python", "sh") and not title:
        return _text(f"```{language}\n{code}```")[0]
    if title:
        code = f"%%writefile {title}\n{code}"
    elif language == "sh":
        lines = code.replace("\\\n", " ").splitlines()
        code = "\n".join(line if not line or line.startswith("#") else f"!{line}" for line in lines)
    source = code.rstrip("\n")
    return {"cell_type": "code", "execution_count": None, "metadata": {}, "outputs": outputs, "source": source}


def _output(result: re.Match[str], page: Executed) -> list[dict[str, Any]]:
    if result["printed"] is not None:
        return [{"output_type": "stream", "name": "stdout", "text": result["printed"] + "\n"}]
    if result["figure"] is None:
        return []
    data = {"image/svg+xml": page.files[result["figure"]], "text/plain": result["told"]}
    return [{"output_type": "display_data", "data": data, "metadata": {}}]


def main(arguments: list[str]) -> None:
    """Runs the pages and writes a notebook of each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("pages", nargs="+", type=Path, help="of docs/")
    parser.add_argument("--out", type=Path, default=Path(), help="folder of the notebooks")
    given = parser.parse_args(arguments)
    prepare()
    given.out.mkdir(parents=True, exist_ok=True)
    for path in given.pages:
        name = path.resolve().relative_to(ROOT / "docs").as_posix()
        made = notebook(execute(name, path.read_text(encoding="utf-8")))
        target = given.out / f"{path.stem}.ipynb"
        target.write_text(json.dumps(made, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(target)


if __name__ == "__main__":
    main(sys.argv[1:])
