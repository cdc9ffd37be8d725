"""Which lines of the package each test executes: a plugin of pytest (`-p visits`).

Each line reports itself once a test (`sys.monitoring`), so tests run about as fast as without.
Lines that processes of their own execute are not seen.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from types import CodeType

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
PACKAGE = ROOT / "dolfin_elastic"
PREFIX = f"{PACKAGE}{os.sep}"


def digest(path: Path) -> str:
    """A fingerprint of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12]


class Visits:
    """Lines executed since the last test began."""

    def __init__(self) -> None:
        self.lines: dict[str, set[int]] = defaultdict(set)
        events = sys.monitoring
        events.use_tool_id(events.COVERAGE_ID, "visits")
        events.register_callback(events.COVERAGE_ID, events.events.LINE, self.line)
        events.set_events(events.COVERAGE_ID, events.events.LINE)

    def line(self, code: CodeType, line: int) -> object:
        """A line that is executed for the first time in a test."""
        if code.co_filename.startswith(PREFIX):
            self.lines[code.co_filename].add(line)
        return sys.monitoring.DISABLE

    def begin(self) -> None:
        """Forgets all lines."""
        self.lines.clear()
        sys.monitoring.restart_events()

    def found(self) -> dict[str, str]:
        """Files of the package, and of each its lines as the bits of a hexadecimal number."""
        return {
            Path(file).relative_to(ROOT).as_posix(): f"{sum(1 << line for line in lines):x}"
            for file, lines in self.lines.items()
        }


def pytest_addoption(parser: pytest.Parser) -> None:
    """Where to write."""
    parser.addoption("--visits", help="JSON lines: a test, its seconds, and the lines it executes")


def pytest_configure(config: pytest.Config) -> None:
    """Begins to look."""
    config.pluginmanager.register(_Recorder(Path(config.getoption("visits"))))


class _Recorder:
    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.file, self.visits = path.open("a"), Visits()
        self.seconds: dict[str, float] = defaultdict(float)
        self.good: dict[str, bool] = {}
        self.digests = {p.relative_to(ROOT).as_posix(): digest(p) for p in PACKAGE.rglob("*.py")}

    def pytest_unconfigure(self) -> None:
        sys.monitoring.set_events(sys.monitoring.COVERAGE_ID, 0)
        self.file.close()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self.visits.begin()
        done = yield
        if self.good.get(item.nodeid):
            files = {file: [self.digests[file], bits] for file, bits in self.visits.found().items()}
            row = {"test": item.nodeid, "seconds": round(self.seconds[item.nodeid], 3)}
            self.file.write(json.dumps({**row, "files": files}) + "\n")
            self.file.flush()
        return done

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.seconds[report.nodeid] += report.duration
        if report.when == "call":
            self.good[report.nodeid] = report.passed
