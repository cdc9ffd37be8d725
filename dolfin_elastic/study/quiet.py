"""Solutions of which nobody needs a log."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quietly(level: int = logging.ERROR) -> Iterator[None]:
    """Inside, nothing is logged below a level: of solutions and problems that are like others."""
    log = logging.getLogger("dolfin_elastic")
    before = log.level
    log.setLevel(level)
    try:
        yield
    finally:
        log.setLevel(before)
