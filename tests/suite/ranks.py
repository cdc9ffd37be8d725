"""The suite again on 2 and 3 ranks, one mpirun each, after the tests on one rank.

First one rank, spread over the cores, which compiles the forms; then the sessions on several ranks,
one after the other as long as there are no cores for both: the cores are always busy and never
shared, which ranks that wait for each other bear badly.  The outcomes of a
session are written to files and reported here, so that there is one verdict and one table of times.
Where a test fails on some ranks only, or none answers, the session ends, for its ranks are out of
step; another one runs the tests after that one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.processes import clean_environment
from mpi4py import MPI

from suite.selection import TESTS, alone, asked, whole

RANKS = (2, 3)
LIMIT = 3600.0
"""Seconds that a session may take."""
SILENCE = 720.0
"""Seconds without a word from any rank: more than one test may take, by its own timeout.

That timeout comes too late for ranks that are out of step: no thread of Python runs in a rank that
waits inside PETSc or DOLFINx.
"""
PATIENCE = 60.0
"""Seconds that other ranks have to end a test that failed on one: they may wait for that one."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of the sessions on several ranks."""
    group = parser.getgroup("suite")
    group.addoption("--after", metavar="TEST", help="only the tests behind this one")
    group.addoption("--reports-to", metavar="FOLDER", help="where a rank writes what it finds")


def pytest_configure(config: pytest.Config) -> None:
    """Makes this process the rank of a session, or the one that starts sessions."""
    if MPI.COMM_WORLD.size > 1:
        # A program that a test starts would find itself described as this rank, take its place
        # and write into the memory that it shares with the others: a rank crashed at its next
        # message.
        for name in os.environ.keys() - clean_environment().keys():
            del os.environ[name]
    if folder := config.getoption("reports_to"):
        config.pluginmanager.register(_Reporter(config, Path(folder)))
    elif whole(config) and alone(config) and not config.option.collectonly:
        config.pluginmanager.register(_Sessions(config))


class _Reporter:
    """Writes the reports of one rank, one a line."""

    def __init__(self, config: pytest.Config, folder: Path) -> None:
        self.config = config
        self.failed = False
        self.file = (folder / f"{MPI.COMM_WORLD.rank}.jsonl").open("w")

    def _write(self, kind: str, data: Any) -> None:
        self.file.write(json.dumps({kind: data}) + "\n")
        self.file.flush()

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Leaves the tests behind the one that ended the session before."""
        if last := self.config.getoption("after"):
            del items[: [item.nodeid for item in items].index(last) + 1]

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        self._write("tests", len(session.items))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.failed |= report.failed
        serial = self.config.hook.pytest_report_to_serializable
        self._write("report", serial(config=self.config, report=report))

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._write("begin", nodeid)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Where a test fails on some ranks only, all of them stop: they are out of step."""
        self.failed = False
        done = yield
        counts = MPI.COMM_WORLD.allgather(self.failed)
        if any(counts) and not all(counts):
            item.session.shouldstop = "a test failed on some of the ranks only"
        return done

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self._write("broken", f"{report.nodeid}: {report.longreprtext}")

    def pytest_sessionfinish(self, exitstatus: int) -> None:
        self._write("end", int(exitstatus))


class _Sessions:
    """Starts the sessions and tells what they find."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.waiting = [(ranks, "") for ranks in RANKS if ranks in asked(config)]
        self.cores = len(os.sched_getaffinity(0))

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> Iterator[None]:
        found = yield
        running: list[_Session] = []
        try:
            while self.waiting or running:
                free = self.cores - sum(one.ranks for one in running)
                while self.waiting and (self.waiting[0][0] <= free or not running):
                    free -= self.waiting[0][0]
                    running.append(_Session(session, *self.waiting.pop(0)))
                time.sleep(0.2)
                ended = [one for one in running if not one.goes_on()]
                running = [one for one in running if one not in ended]
                self.waiting[:0] = [(one.ranks, one.test) for one in ended if one.unfinished]
        finally:
            for one in running:
                one.process.terminate()
        return found


class _Session:
    """One mpirun.

    Args:
        session: The one that it reports to.
        ranks: Their number.
        after: The test behind which it begins; empty: with the first.

    Attributes:
        ranks: As given.
        test: The last test to begin.
        unfinished: It ended before its last test.
    """

    def __init__(self, session: pytest.Session, ranks: int, after: str) -> None:
        self.session, self.config, self.ranks, self.after = session, session.config, ranks, after
        self.unfinished, self.failed = False, 0.0
        self.folder = Path(tempfile.mkdtemp(prefix=f"ranks{ranks}_"))
        self.begin, self.failures, self.read, self.ends = time.monotonic(), 0, [0] * ranks, 0
        self.heard, self.test = self.begin, ""
        optional = filter(None, [os.environ.get("PYTHONPATH")])  # packages beside Debian's
        with (self.folder / "out").open("w") as out:
            self.process = subprocess.Popen(
                self._command(),
                cwd=TESTS.parent,
                stdout=out,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env={
                    **clean_environment(),
                    "PYTHONPATH": os.pathsep.join([str(TESTS.parent), *optional]),
                    "TMPDIR": str(self.folder),
                    "OMPI_MCA_mpi_yield_when_idle": "1",  # more ranks than cores must not spin
                },
            )

    def _command(self) -> list[str]:
        option = self.config.option
        words = ["mpirun", "-n", str(self.ranks), "--oversubscribe", sys.executable, "-m", "pytest"]
        words += ["-q", "-p", "no:cacheprovider", f"--reports-to={self.folder}"]
        # A rank that waits in MPI hears no signal; a thread ends it, and so all.
        words += ["--timeout-method=thread"]
        words += [f"--after={self.after}"] if self.after else []
        words += [f"--{name}" for name in ("all", "rest") if self.config.getoption(name)]
        words += [f"--turn={option.turn}"]
        words += ["-k", option.keyword] if option.keyword else []
        words += ["-m", option.markexpr] if option.markexpr else []
        return words

    def goes_on(self) -> bool:
        """Tells what is new; False at the end."""
        ended = self.process.poll() is not None
        for rank in range(self.ranks):
            self._tell(rank)
        now = time.monotonic()
        apart = self.failed and now - self.failed > PATIENCE
        late = not ended and (now - self.begin > LIMIT or now - self.heard > SILENCE or apart)
        if late:
            self._stop()
        elif not ended:
            return True
        option = self.config.option
        few = option.keyword or option.markexpr or self.after
        good = {0, pytest.ExitCode.NO_TESTS_COLLECTED} if few else {0}
        bad = late or self.process.returncode not in good
        stopped = self.ends < self.ranks or self.process.returncode == pytest.ExitCode.INTERRUPTED
        self.unfinished = bool(stopped and self.test and now - self.begin < LIMIT)
        if (bad and not self.failures) or self.ends < self.ranks:
            why = f"ended with {self.process.returncode}"
            if late:
                why = f"took {now - self.begin:.0f} s, the last {now - self.heard:.0f} in silence"
            why += f", the last test to begin was {self.test}"
            self._fail(why, (self.folder / "out").read_text(errors="replace")[-8000:])
        return False

    def _stop(self) -> None:
        """Ends mpirun, which ends the ranks."""
        self.process.terminate()
        try:
            self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()

    def _tell(self, rank: int) -> None:
        file = self.folder / f"{rank}.jsonl"
        text = file.read_text()[self.read[rank] :] if file.exists() else ""
        lines = text[: text.rfind("\n") + 1]
        self.read[rank] += len(lines)
        for line in lines.splitlines():
            self.heard = time.monotonic()
            self._hear(rank, **json.loads(line))

    def _hear(
        self,
        rank: int,
        *,
        tests: int = 0,
        report: dict[str, Any] | None = None,
        broken: str = "",
        begin: str = "",
        end: int | None = None,
    ) -> None:
        self.ends += end is not None
        if begin and begin != self.test:
            self.test, self.failed = begin, 0.0
        if rank == 0 and not self.after:
            self.session.testscollected += tests
        if broken:
            self._fail(f"rank {rank}", broken)
        if report is None:
            return
        hook = self.config.hook
        made = hook.pytest_report_from_serializable(config=self.config, data=report)
        self.failures += made.failed
        if made.failed and not self.failed:
            self.failed = time.monotonic()
        if isinstance(made.longrepr, list):  # where and why a test was skipped
            made.longrepr = tuple(made.longrepr)
        # All ranks run the same tests: the others matter where they fail.
        if rank == 0 or made.failed:
            made.nodeid += f" [{self.ranks} ranks]" if not rank else f" [rank {rank}/{self.ranks}]"
            hook.pytest_runtest_logreport(report=made)
            hook.pytest_runtest_logfinish(nodeid=made.nodeid, location=made.location)

    def _fail(self, why: str, text: str) -> None:
        self.failures += 1
        name = f"session on {self.ranks} ranks"
        report = pytest.TestReport(
            name, ("tests", None, name), {}, "failed", f"{why}\n{text}", "call", duration=0.0
        )
        self.config.hook.pytest_runtest_logreport(report=report)
