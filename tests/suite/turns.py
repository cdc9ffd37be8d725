"""Which parameters of long lists have their turn: by the week, so that over time all of them run.

Runs of one week make the same choice, so that what a commit has mended is run again by the next.
"""

from __future__ import annotations

import zlib
from datetime import UTC, date, datetime


def week(today: date | None = None) -> str:
    """Year and week, as in 2026-W49."""
    year, number, _ = (today or datetime.now(UTC).date()).isocalendar()
    return f"{year}-W{number:02d}"


def first_of(turn: str, test: str, count: int) -> int:
    """Index of the parameter of a test from which on they are taken, the same in all processes.

    Args:
        turn: A week or another word; empty: the first one.
        count: Of its parameters.
    """
    return zlib.crc32(f"{turn} {test}".encode()) % count if turn else 0
