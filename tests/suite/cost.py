"""What tests cost, in processor time too, which a busy machine does not change much."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import ffcx.codegeneration.jit as compiler
import pytest
from mpi4py import MPI

SLOWEST = 25


def _cpu() -> float:
    """Seconds of processor time of this process and of those it has waited for."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


class Meter:
    """Adds up what is spent on compilation."""

    def __init__(self) -> None:
        self.compiling = 0.0
        self._compile = compiler._compile_objects
        compiler._compile_objects = self.compile

    def compile(self, *args: object, **keys: object) -> object:
        begin = _cpu()
        try:
            return self._compile(*args, **keys)
        finally:
            self.compiling += _cpu() - begin


METER = Meter()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Notes where a test begins."""
    item.stash[_BEGIN] = _cpu(), METER.compiling
    return (yield)


_BEGIN = pytest.StashKey[tuple[float, float]]()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo) -> Iterator[None]:
    """Adds the cost of a test to the report of its end."""
    report = yield
    if call.when == "teardown":
        cpu, compiling = item.stash[_BEGIN]
        cost = (MPI.COMM_WORLD.size, _cpu() - cpu, METER.compiling - compiling)
        report.user_properties = [*report.user_properties, ("cost", cost)]
    return report


def pytest_addoption(parser: pytest.Parser) -> None:
    """An option for the whole table."""
    group = parser.getgroup("suite")
    group.addoption("--costs", metavar="FILE", help="write what each test costs to a CSV file")


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """The slowest tests, and the sums for each number of ranks."""
    reports = [one for group in terminalreporter.stats.values() for one in group]
    reports = [one for one in reports if isinstance(one, pytest.TestReport)]
    if len(reports) < 3 * SLOWEST:
        return
    rows: dict[str, list[float]] = defaultdict(lambda: [1, 0.0, 0.0, 0.0])
    ranks: dict[str, int] = {}
    for one in reports:
        row = rows[one.nodeid]
        row[1] += one.duration
        for name, (size, cpu, compiling) in one.user_properties:
            if name == "cost":
                ranks[one.nodeid] = size
                row[2], row[3] = cpu, compiling
    total: dict[int, list[float]] = defaultdict(lambda: [0, 0.0, 0.0, 0.0])
    for nodeid, row in rows.items():
        size = ranks.get(nodeid, 0)
        total[size] = [a + b for a, b in zip(total[size], row, strict=True)]
    if file := config.getoption("costs"):
        lines = [f"{nodeid};{row[1]:.2f};{row[2]:.2f};{row[3]:.2f}" for nodeid, row in rows.items()]
        Path(file).write_text("test;seconds;processor;compiling\n" + "\n".join(lines) + "\n")
    write = terminalreporter.write_line
    terminalreporter.write_sep("=", f"slowest {SLOWEST} tests (seconds, of processor, compiling)")
    for nodeid, row in sorted(rows.items(), key=lambda item: -item[1][1])[:SLOWEST]:
        write(f"{row[1]:8.1f} {row[2]:8.1f} {row[3]:8.1f}  {re.sub('^tests/', '', nodeid)}")
    write("")
    for size, row in sorted(total.items()):
        if size:
            word = "rank: " if size == 1 else "ranks:"
            write(
                f"{size} {word} {row[0]:.0f} tests, {row[1]:.0f} s, {row[2]:.0f} s of processor"
                f" (rank 0 and its compilers), of which compiling {row[3]:.0f} s"
            )
