"""Who computes which block, among processes on any machines that see one folder.

A process signs in with a file of its own, which it touches every few seconds. A block is claimed by creating the file
`block.attempt`, which only one can (POSIX, NFS too); it names the owner. Where an owner has died, the next attempt is
claimed in the same way, so that of several that wait one gets it, and the former owner, should it only have slept, sees
that it has lost the block. Nothing compares clocks: an owner has died when its file does not change for `EXPIRY`
seconds of the watcher's own clock, or at once when it was a process of this machine that is gone.

Leases only save work. That rows are right does not rest on them, but on the seals of the store.
"""

import contextlib
import functools
import os
import platform
import shutil
import threading
import time
import uuid
from pathlib import Path
from types import TracebackType

from memsgyro_jax.base.files import write_whole


BEAT, EXPIRY = 2.0, 20.0  # s: how often an owner touches its file, how long an untouched one counts
_OWNER = "owner-"


class Leases:
    """The claims of this process in `folder`, while it is signed in (`with`)."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.name = f"{_OWNER}{uuid.uuid4().hex}"
        self._held: dict[int | str, int] = {}  # attempt under which a block is claimed
        self._seen: dict[str, tuple[int, float]] = {}  # of other owners: last change of their file, when first noticed
        self._left = threading.Event()
        self._pulse = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> "Leases":
        self._sign()
        self._pulse.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._left.set()
        self._pulse.join()
        for block in list(self._held):
            self.release(block)
        (self.folder / self.name).unlink(missing_ok=True)
        if not any(self._alive(owner) for owner in self._others()):
            shutil.rmtree(self.folder, ignore_errors=True)

    def shared(self) -> bool:
        """Whether another process is at work here: watches those that signed in until one stirs or all count as dead.

        This takes up to `BEAT` seconds beside one that lives, up to `EXPIRY` after one that died on another machine.
        """
        first = {owner: self._changed(owner) for owner in self._others()}
        while alive := [owner for owner in self._others() if self._alive(owner)]:
            if any(self._changed(owner) not in (None, first.get(owner)) for owner in alive):
                return True
            time.sleep(0.02)
        return False

    def claim(self, block: int | str) -> bool:
        """Whether the block is now this process' own; False while another that lives has it."""
        last = self._last(block)
        if last >= 0 and self._alive(self._holder(block, last)):
            return False
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with self._file(block, last + 1).open("x") as file:
                file.write(self.name)
        except (FileExistsError, FileNotFoundError):  # another was faster, or the last one to leave has tidied up
            return False
        self._held[block] = last + 1
        return True

    def holds(self, block: int | str) -> bool:
        """Whether a claimed block is still this process' own; to be asked before each write."""
        attempt = self._held.get(block)
        return attempt is not None and attempt == self._last(block) and self._holder(block, attempt) == self.name

    def release(self, block: int | str) -> None:
        """Give up a claim; one that was lost meanwhile is its new owner's."""
        if self.holds(block):
            for attempt in range(self._held[block] + 1):
                self._file(block, attempt).unlink(missing_ok=True)
        self._held.pop(block, None)

    def _file(self, block: int | str, attempt: int) -> Path:
        return self.folder / f"{block}.{attempt}"

    def _last(self, block: int | str) -> int:
        """The highest attempt at a block, -1 without one."""
        attempt = 0
        while self._file(block, attempt).exists():
            attempt += 1
        return attempt - 1

    def _holder(self, block: int | str, attempt: int) -> str:
        """Who made an attempt; one that was stopped before it could write its name is watched by its claim."""
        file = self._file(block, attempt)
        with contextlib.suppress(OSError, ValueError):
            return file.read_text() or file.name
        return file.name

    def _others(self) -> list[str]:
        with contextlib.suppress(OSError):
            return [file.name for file in self.folder.glob(f"{_OWNER}*") if file.name != self.name]
        return []

    def _changed(self, owner: str) -> int | None:
        with contextlib.suppress(OSError, ValueError):
            return (self.folder / owner).stat().st_mtime_ns
        return None

    def _alive(self, owner: str) -> bool:
        if owner == self.name:
            return True
        try:
            # Opened before it is asked for its time: NFS then asks the server.
            host, _, process = (self.folder / owner).read_text(errors="replace").partition("\n")
        except (OSError, ValueError):
            return False
        if host == _host() and process.isdigit() and not _runs(int(process)):
            (self.folder / owner).unlink(missing_ok=True)
            return False
        changed, now = self._changed(owner) or 0, time.monotonic()
        if self._seen.get(owner, (None, now))[0] != changed:
            self._seen[owner] = changed, now
        return now - self._seen[owner][1] < EXPIRY

    def _sign(self) -> None:
        for last in (False, False, False, True):
            self.folder.mkdir(parents=True, exist_ok=True)
            try:
                write_whole(self.folder / self.name, f"{_host()}\n{os.getpid()}")
            except FileNotFoundError:  # the last one to leave has tidied up in between
                if last:
                    raise
            else:
                return

    def _beat(self) -> None:
        while not self._left.wait(BEAT):
            with contextlib.suppress(OSError):  # a full disk is the main thread's to tell
                self._sign()


def signed_in(folder: Path) -> tuple[int, int]:
    """How many have signed in to `folder`, and how many blocks are claimed; some of them may have died."""
    names = [file.name for file in folder.glob("*")] if folder.is_dir() else []
    owners = sum(name.startswith(_OWNER) for name in names)
    return owners, len({name.partition(".")[0] for name in names if name[:1].isdigit()})


@functools.cache
def _host() -> str:
    """This machine since its start; containers, which number their processes anew, count as machines."""
    boot = namespace = ""
    with contextlib.suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        namespace = str(Path("/proc/self/ns/pid").stat().st_ino)
    return f"{platform.node()} {boot} {namespace}"


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # somebody else's
        return True
    return True
