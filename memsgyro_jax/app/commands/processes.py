"""Programs that run side by side, each in a process of its own: none stops another, none outlives an interruption."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path


Running = list[subprocess.Popen]


@contextmanager
def pool_of_processes(jobs: int) -> Iterator[tuple[ThreadPoolExecutor, Running]]:
    """A pool of so many threads, and the list of their processes: where this one is interrupted, those end, and those
    that wait do not begin.
    """
    running: Running = []
    with ThreadPoolExecutor(jobs) as pool:
        try:
            yield pool, running
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in running:
                process.terminate()
            raise


def run_logged(command: Sequence[str], running: Running, log: Path, text: Path | None = None) -> str:
    """Runs Python with the arguments `command`; why it failed, if it did: its status and its last line.

    What it says goes to the file `log`, what it prints to `text` where one is named.
    """
    with contextlib.ExitStack() as files:
        said = files.enter_context(log.open("w", encoding="utf-8"))
        printed = said if text is None else files.enter_context(text.open("w", encoding="utf-8"))
        command = [sys.executable, *command]
        process = subprocess.Popen(command, stdout=printed, stderr=said, stdin=subprocess.DEVNULL)
        running.append(process)
        status = process.wait()
    running.remove(process)
    if status == 0:
        return ""
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    return f"failed with status {status}: {next((line for line in reversed(lines) if line.strip()), 'no word')}"
