"""The command line `memsgyro`.

Each command is a function in `commands/` that imports what it runs inside its body, so that `--help` answers without
importing JAX. It prints for people, writes files only where it is told to, and leaves errors to `main`: what the user
can mend is one sentence and exit status 2.
"""

import contextlib
import functools
import gc
import logging
import os
import re
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import cyclopts

from memsgyro_jax import __version__
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.made_by import called

from .commands.allan import allan_command
from .commands.check import check_command
from .commands.compare import compare_command
from .commands.datasheet import datasheet_command
from .commands.diagnose import diagnose_command
from .commands.diff import diff_command
from .commands.effects import effects_command
from .commands.fit import fit_command
from .commands.identify import identify_command
from .commands.import_ import import_command
from .commands.law import law_command
from .commands.loop import loop_command
from .commands.new import new_command
from .commands.rate_test import rate_test_command
from .commands.schema import schema_command
from .commands.simulate import simulate_command
from .commands.status import status_command
from .commands.studies import studies_command
from .commands.sweep import sweep_command
from .commands.tornado import tornado_command
from .commands.tune import tune_command
from .ending import TERMINATED, Terminated, told_to_end
from .kinds import kinds_text


BAD_INPUT = 2
INTERRUPTED = 130  # as shells count: 128 and the number of the signal
BROKEN_PIPE = 1  # as rich does

VERBOSE = "--verbose"
_WORD = re.compile(r"-(\.?\d.*)?")
_LOG = logging.getLogger("memsgyro_jax")

app = cyclopts.App(
    name="memsgyro",
    help="Simulates vibratory gyroscopes in closed loop, one die or thousands, and lays them beside measurements.\n\n"
    "With `--verbose` any command says on standard error what it reads, writes and waits for.",
    version=__version__,
    help_format="plaintext",  # markdown would cost a third of the time that `--help` takes
    suppress_keyboard_interrupt=False,  # `main` answers it
)


def _prepared(command: Callable[..., None]) -> Callable[..., None]:
    """The command with JAX set up before it starts."""

    @functools.wraps(command)
    def run(*arguments: object, **options: object) -> None:
        from memsgyro_jax.base.runtime import configure

        configure()
        started = time.monotonic()
        command(*arguments, **options)
        _LOG.info("done in %.1f s", time.monotonic() - started)

    return run


for _command in (
    sweep_command,
    status_command,
    simulate_command,
    tornado_command,
    loop_command,
    tune_command,
    identify_command,
    allan_command,
    rate_test_command,
    datasheet_command,
    effects_command,
    import_command,
    check_command,
    compare_command,
    fit_command,
    diagnose_command,
    law_command,
    diff_command,
    new_command,
    schema_command,
    studies_command,
):
    _told = kinds_text() if _command in (sweep_command, simulate_command, tune_command) else None
    _name = _command.__name__.removesuffix("_command").replace("_", "-")
    app.command(_prepared(_command), name=_name, help_epilogue=_told)


app.register_install_completion_command(help="Complete words of the command line in this shell (bash, zsh, fish).")


# Objects more before Python looks for what may go: at its own pace, in what JAX traced, that is 5 % of a diagnosis.
_SELDOM = 100_000, 50, 100


def main(tokens: Sequence[str] | None = None) -> None:
    """Runs `memsgyro` and ends the process with its exit status.

    0 is success, 2 bad input or an unusable file, 130 an interruption by Ctrl-C, 143 an end asked for by `kill` or a
    batch system (one sentence on standard error each), 1 a reader of the output that has left.

    Args:
        tokens: the command line without the program's name; `None` takes it from the process.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, ValueError):  # not all that stands in for them is a stream of text
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]  # `±` is no letter of every locale
    if tokens is None:
        gc.set_threshold(*_SELDOM)
    with told_to_end(at_last=tokens is None):
        sys.exit(_run(app, _without_verbose(sys.argv[1:] if tokens is None else tokens)))


def _without_verbose(tokens: Sequence[str]) -> list[str]:
    """The command line, remembered for what it makes, without `--verbose`, which sends what the package logs to
    standard error.
    """
    if VERBOSE in tokens:
        logging.basicConfig(format="%(asctime)s %(message)s", datefmt="%H:%M:%S", force=True)
        _LOG.setLevel(logging.DEBUG)
    called(tokens)
    words = [token for token in tokens if token != VERBOSE]
    # A dash alone, and a number below zero with a unit, are words; the library takes what begins with one for options.
    return [f" {token}" if words[0] == "import" and _WORD.fullmatch(token) else token for token in words]


def _run(application: cyclopts.App, tokens: Sequence[str]) -> int:
    try:
        application(
            list(tokens), exit_on_error=False, print_error=False, help_on_error=False, result_action="return_value"
        )
        sys.stdout.flush()
    except InputError as error:
        for line in error.each if len(error.each) > 1 else (str(error),):
            _say(line, BAD_INPUT)
        return BAD_INPUT
    except cyclopts.CycloptsError as error:
        return _say(f"{_one_line(str(error))} See `memsgyro --help`.", BAD_INPUT)
    except KeyboardInterrupt:
        return _say("Interrupted.", INTERRUPTED)
    except Terminated:
        return _say("Terminated.", TERMINATED)
    except BrokenPipeError:
        # The reader of the pipe has left (`memsgyro ... | head`); Python would complain when it closes the stream.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except OSError as error:
        return _say(_file_sentence(error), BAD_INPUT)
    return 0


def _say(sentence: str, status: int) -> int:
    print(_one_line(sentence), file=sys.stderr)
    return status


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _file_sentence(error: OSError) -> str:
    """Disk full, no permission, no such file: the file first, then the system's own words."""
    reason = error.strerror or str(error) or type(error).__name__
    if isinstance(error, FileNotFoundError) and Path(str(error.filename)).name == "case.toml":
        reason += "; `memsgyro import FILE... --out CASE` makes a case of what instruments save"
    return f"{error.filename}: {reason}." if error.filename else f"{reason}."


if __name__ == "__main__":
    main()
