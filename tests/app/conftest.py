"""What the tests of several commands share."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from memsgyro_jax.app import cli


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The empty folder in which the command line is run."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def memsgyro(
    folder: Path, capsys: pytest.CaptureFixture[str], quick_pictures: None
) -> Callable[..., tuple[Any, str, str]]:
    """Runs the command line in `folder`: exit status, standard output, standard error."""

    def run(*tokens: Any) -> tuple[Any, str, str]:
        with pytest.raises(SystemExit) as end:
            cli.main(list(map(str, tokens)))
        return end.value.code, *capsys.readouterr()

    return run
