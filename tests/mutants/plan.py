"""Which tests are to find a mutant, and in which order."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from mutate import Mutant
from visits import ROOT, digest

NEAR, FAR, RANKS = 30.0, 20.0, 20.0
"""Seconds of tests of the nearest folder, of others, and of tests on two ranks."""
ALIKE = 3
"""Parameters of one test that come before other tests."""


@dataclass(frozen=True)
class Visit:
    """A test that executes some lines of a module.

    Attributes:
        test: Its name.
        seconds: How long it takes.
        digest: Of the module as it was.
        lines: The lines, as bits.
    """

    test: str
    seconds: float
    digest: str
    lines: int


@dataclass(frozen=True)
class Stage:
    """Tests that run in one process.

    Attributes:
        tests: Their names.
        seconds: How long they take, roughly.
        ranks: On so many ranks.
    """

    tests: list[str]
    seconds: float
    ranks: int = 1


class Visited:
    """What `--record` wrote: of a test, the last time."""

    def __init__(self, folder: Path) -> None:
        rows = {}
        for path in sorted(folder.glob("*.jsonl"), key=lambda path: path.stat().st_mtime):
            for line in path.read_text().splitlines():
                row = json.loads(line)
                rows[row["test"]] = row
        if not rows:
            raise SystemExit("no test is known: `docker/run python3 tests/mutants --record` first")
        self.modules: dict[str, list[Visit]] = {}
        self.seconds = {row["test"]: row["seconds"] for row in rows.values()}
        for row in rows.values():
            for module, (of, bits) in row["files"].items():
                visit = Visit(row["test"], row["seconds"], of, int(bits, 16))
                self.modules.setdefault(module, []).append(visit)

    def tests(self, mutant: Mutant) -> list[str]:
        """Tests that execute the statement of a mutant.

        Of those executed at import, and of modules that have changed since, all that execute
        anything of the module.
        """
        now = digest(ROOT / mutant.module)
        wanted = sum(1 << line for line in mutant.lines)
        visits = self.modules.get(mutant.module, [])
        all_of = not mutant.inside
        return [v.test for v in visits if all_of or v.digest != now or v.lines & wanted]


class Plan:
    """The tests of each mutant: those of the nearest folder first, and of these the quickest."""

    def __init__(self, visited: Visited) -> None:
        self.visited = visited

    def stages(self, mutant: Mutant) -> Iterator[Stage]:
        """Tests to be run one stage after the other, until one fails."""
        tests = self.visited.tests(mutant)
        known = self.visited.seconds
        # Programs that tests start are not looked into, and a table is read without executing any
        # line: the folder's tests, whatever they execute.
        folder = self._folder(mutant)
        blind = [t for t in known if t.startswith(f"{folder}/") and t not in set(tests)]
        near = [t for t in tests if _nearness(t, mutant) == self._nearest(tests, mutant)]
        far = [t for t in tests if t not in set(near)]
        yield from self._stage(self._fill(near, NEAR))
        yield from self._stage(self._fill(far, FAR))
        if not (tests and mutant.inside) or "/cli/" in mutant.module:
            yield from self._stage(self._fill(blind, 2 * NEAR))
        on_two = self._fill((t for t in near or tests if not _on_one_rank(t)), RANKS)
        yield from self._stage(on_two, ranks=2)

    @staticmethod
    def _nearest(tests: list[str], mutant: Mutant) -> int:
        return max((_nearness(test, mutant) for test in tests), default=0)

    def _folder(self, mutant: Mutant) -> str:
        """The folder of tests that stands for the module's."""
        folder = Path("tests", *Path(mutant.module).parts[1:-1])
        while not any(test.startswith(f"{folder}/") for test in self.visited.seconds):
            folder = folder.parent
        return folder.as_posix()

    def _fill(self, tests: Iterable[str], limit: float) -> list[str]:
        """Tests for so many seconds: a few parameters of each first, the quickest first."""
        seen: Counter[str] = Counter()
        ordered = []
        for test in sorted(tests, key=self.visited.seconds.__getitem__):
            name = test.partition("[")[0]
            ordered.append((seen[name] // ALIKE, self.visited.seconds[test], test))
            seen[name] += 1
        taken, spent = [], 0.0
        for _, seconds, test in sorted(ordered):
            if spent + seconds <= limit or not taken:
                taken.append(test)
                spent += seconds
        return taken

    def _stage(self, tests: list[str], ranks: int = 1) -> Iterator[Stage]:
        """A stage, if there is anything to run."""
        if tests:
            yield Stage(tests, sum(self.visited.seconds[test] for test in tests), ranks)


def _nearness(test: str, mutant: Mutant) -> int:
    """How many folders a test and a module have in common."""
    ours, theirs = Path(mutant.module).parts[1:-1], Path(test.partition("::")[0]).parts[1:-1]
    same = 0
    for a, b in zip(ours, theirs, strict=False):
        if a != b:
            break
        same += 1
    return same


def _on_one_rank(test: str) -> bool:
    """Whether ranks have no part in a test."""
    words = ("tests/cli/", "tests/core/test_formula", "tests/core/test_units", "tests/hostile/")
    return test.startswith((*words, "tests/test_"))
