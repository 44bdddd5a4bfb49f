"""Builds the documentation of several versions side by side: `python docs/hooks/versions.py FOLDER v0.1.0 v0.2.0`.

Each version is built from its own sources (a tag, a branch, a commit) by this environment, into a folder of its name;
`index.html` leads to them, the last one given first. What is there already stays, so that a release adds its own.
"""

import argparse
import html
import subprocess
import sys
import tempfile
from pathlib import Path


ROOT = Path(__file__).resolve().parents[2]
FRONT = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>memsgyro_jax, all versions</title>
<style>:root {{ color-scheme: light dark; }} body {{ font: 16px/1.6 system-ui, sans-serif; margin: 2em auto;
max-width: 40em; padding: 0 1em; }}</style></head>
<body><h1>memsgyro_jax</h1><p>Documentation by version, the newest first.</p><ul>
{entries}
</ul></body></html>
"""


def build(folder: Path, versions: list[str], command: tuple[str, ...]) -> None:
    """Builds each of `versions` into a folder of its name, then the front page of all that are there."""
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    for version in versions:
        with tempfile.TemporaryDirectory() as place:
            tree = Path(place) / "tree"
            git = ("git", "-C", str(ROOT), "worktree")
            subprocess.run([*git, "add", "--quiet", "--detach", str(tree), version], check=True)
            try:
                subprocess.run([*command, str(folder / _named(version))], cwd=tree, check=True)
            finally:
                subprocess.run([*git, "remove", "--force", str(tree)], check=True)
    there = [path.name for path in sorted(folder.iterdir()) if (path / "index.html").exists()]
    given = [_named(version) for version in reversed(versions)]
    order = [*given, *(name for name in reversed(there) if name not in given)]
    entries = "\n".join(f'<li><a href="{html.escape(name)}/index.html">{html.escape(name)}</a></li>' for name in order)
    (folder / "index.html").write_text(FRONT.format(entries=entries), encoding="utf-8")


def _named(version: str) -> str:
    return version.replace("/", "-")


def main(arguments: list[str]) -> None:
    """Builds what the command line names."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("versions", nargs="+", help="tags, branches or commits, the newest last")
    given = parser.parse_args(arguments)
    build(given.folder, given.versions, (sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir"))


if __name__ == "__main__":
    main(sys.argv[1:])
