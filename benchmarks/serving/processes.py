"""What the processes of a service hold, read from /proc: memory, descriptors, shared memory, zombies."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

SERVER, LABEL, DETECT, OTHER = "server", "label", "detect", "other"

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Process:
    """A process that lives, or a zombie. cpu_s: what it has computed so far."""

    pid: int
    parent: int
    state: str
    cpu_s: float

    @property
    def is_zombie(self) -> bool:
        """Whether it has ended, and its parent has not asked how."""
        return self.state == "Z"


@dataclass(frozen=True)
class Level:
    """What a service holds besides memory.

    shared: pieces of anonymous shared memory (memfd). files_in_dev_shm: all but those that processes beside
    the service have mapped.
    """

    processes: int
    zombies: int
    descriptors: int
    shared: int
    files_in_dev_shm: int

    def above(self, before: Level) -> dict[str, int]:
        """What there is more than before, by name."""
        more = {one.name: getattr(self, one.name) - getattr(before, one.name) for one in fields(self)}
        return {name: count for name, count in more.items() if count > 0}


def family(server: int) -> list[Process]:
    """The process and all that descend from it; none where it has ended."""
    everyone = {one.pid: one for one in _everyone()}
    members = [everyone[server]] if server in everyone else []
    for member in members:  # it grows meanwhile
        members.extend(one for one in everyone.values() if one.parent == member.pid)
    return members


def roles(server: int) -> dict[int, str]:
    """What each process of a service is there for, told by the libraries that it has loaded."""
    return {one.pid: _role(one, server) for one in family(server) if not one.is_zombie}


def workers(server: int, role: str) -> set[int]:
    """Process numbers of the workers of one role."""
    return {pid for pid, its in roles(server).items() if its == role}


def level(server: int) -> Level:
    """What the service holds now."""
    members = family(server)
    return Level(
        processes=len(members),
        zombies=sum(one.is_zombie for one in members),
        descriptors=sum(len(_entries(Path(f"/proc/{one.pid}/fd"))) for one in members),
        shared=len({inode for one in members for inode in _shared_memory(one.pid)}),
        files_in_dev_shm=_files_in_dev_shm({one.pid for one in members}),
    )


def resident_bytes(pid: int) -> int:
    """RSS of a process, 0 where it has ended."""
    return _bytes_of(Path(f"/proc/{pid}/status"), "VmRSS")


def proportional_bytes(pid: int) -> int:
    """PSS of a process: a page that several have counts in parts. 0 where it has ended."""
    return _bytes_of(Path(f"/proc/{pid}/smaps_rollup"), "Pss")


def cpu_seconds(server: int) -> float:
    """CPU time of the service's processes that live."""
    return sum(one.cpu_s for one in family(server))


def _everyone() -> Iterator[Process]:
    for folder in _entries(Path("/proc")):
        if folder.name.isdigit():
            # The name of the program stands in brackets and may hold any character.
            words = _text(folder / "stat").rpartition(")")[2].split()
            if words:
                cpu_s = (int(words[11]) + int(words[12])) / _TICKS_PER_S
                yield Process(int(folder.name), int(words[1]), words[0], cpu_s)


def _role(process: Process, server: int) -> str:
    if process.pid == server:
        return SERVER
    folder = Path(f"/proc/{process.pid}")
    # A fork server may hold the libraries of the workers that it makes.
    if process.parent == server and "forkserver" in _text(folder / "cmdline"):
        return OTHER
    libraries = _text(folder / "maps")
    if "libtorch" in libraries:
        return LABEL
    return DETECT if "onnxruntime" in libraries else OTHER


def _shared_memory(pid: int) -> set[str]:
    """Inodes of what a process holds open or has mapped."""
    mapped = {line.split()[4] for line in _text(Path(f"/proc/{pid}/maps")).splitlines() if "/memfd:" in line}
    held = set()
    for entry in _entries(Path(f"/proc/{pid}/fd")):
        try:
            if "/memfd:" in str(entry.readlink()):
                held.add(str(entry.stat().st_ino))
        except OSError:  # it has just been closed
            continue
    return mapped | held


def _files_in_dev_shm(members: set[int]) -> int:
    files = {str(path) for path in _entries(Path("/dev/shm"))}
    if files:
        others = (one.pid for one in _everyone() if one.pid not in members)
        maps = (line for pid in others for line in _text(Path(f"/proc/{pid}/maps")).splitlines())
        files -= {line.split(maxsplit=5)[5] for line in maps if "/dev/shm/" in line}
    return len(files)


def _bytes_of(path: Path, name: str) -> int:
    lines = (line.split() for line in _text(path).splitlines())
    return next((1024 * int(words[1]) for words in lines if words[:1] == [f"{name}:"]), 0)


def _entries(folder: Path) -> list[Path]:
    """What is in a folder; nothing where its process has ended."""
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _text(path: Path) -> str:
    """What a file says; nothing where its process has ended."""
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""
