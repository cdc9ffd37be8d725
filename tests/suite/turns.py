"""Which parameters of long lists have their turn: by the commit, so that over time all of them run.

No git is needed: the commit stands in files of the folder .git.
"""

from __future__ import annotations

import zlib
from contextlib import suppress
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parent.parent.parent


def commit(checkout: Path = CHECKOUT) -> str:
    """Begin of the commit's hash, also of a linked work tree; empty where there is none."""
    folder = checkout / ".git"
    with suppress(OSError, ValueError, IndexError):
        if folder.is_file():
            folder = checkout / folder.read_text(encoding="utf-8").partition("gitdir: ")[2].strip()
        head = (folder / "HEAD").read_text(encoding="utf-8").strip()
        name = head.partition("ref: ")[2]
        common = folder / "commondir"
        if name and common.is_file():
            folder = folder / common.read_text(encoding="utf-8").strip()
        return (_of_branch(folder, name) if name else head)[:10]
    return ""


def _of_branch(folder: Path, name: str) -> str:
    file = folder / name
    if file.is_file():
        return file.read_text(encoding="utf-8").strip()
    packed = (folder / "packed-refs").read_text(encoding="utf-8").splitlines()
    return next((row.split()[0] for row in packed if row.endswith(f" {name}")), "")


def first_of(turn: str, test: str, count: int) -> int:
    """Index of the parameter of a test from which on they are taken, the same in all processes.

    Args:
        turn: A commit or another word; empty: the first one.
        count: Of its parameters.
    """
    return zlib.crc32(f"{turn} {test}".encode()) % count if turn else 0
