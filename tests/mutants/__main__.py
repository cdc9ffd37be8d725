"""How many faults do the tests find?  See docs/mutants.md.

docker/run python3 tests/mutants --record      # once: which test executes which line
docker/run python3 tests/mutants               # the 200 mutants, from where it was interrupted
docker/run python3 tests/mutants --table       # writes the tables of docs/mutants.md
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from mutate import Mutant, chosen
from plan import Plan, Visited
from visits import ROOT

WORK = ROOT / "build" / "mutants"
RESULTS = WORK / "results.csv"
COLUMNS = ("key", "mutant", "outcome", "by", "tests", "seconds")
DOCUMENT = ROOT / "docs" / "mutants.md"
BEGIN = "<!-- tests/mutants --table writes what follows -->"
LEFT_OUT = (".git", "build", "__pycache__", ".*_cache", ".hypothesis", ".test-run.*")
CACHES = ("dolfin_elastic", "fenics", "matplotlib")
FAILED, NOT_COLLECTED, USAGE = 1, 2, 4  # exit codes of pytest


def equivalent() -> dict[str, str]:
    """Keys of equivalent mutants to the reasons."""
    text = (Path(__file__).parent / "equivalent.toml").read_text(encoding="utf-8")
    return {row["key"]: row["reason"] for row in tomllib.loads(text).get("mutant", [])}


def results() -> list[dict[str, str]]:
    """The rows of all runs so far, in their order."""
    if not RESULTS.exists():
        return []
    with RESULTS.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write(row: dict[str, object]) -> None:
    """Adds a row to the table: one write, so that several runs may share it."""
    if not RESULTS.exists():
        RESULTS.parent.mkdir(parents=True, exist_ok=True)
        RESULTS.write_text(",".join(COLUMNS) + "\n", encoding="utf-8")
    with RESULTS.open("a", encoding="utf-8", newline="") as file:
        csv.DictWriter(file, COLUMNS, lineterminator="\n").writerow(row)


class Copy:
    """A copy of the repository with one mutant, with a cache of compiled forms of its own.

    The cache begins with links to the forms of the common one, but for mutants of what looks after
    it: those begin with an empty one.  What a mutant compiles, and what it leaves behind, ends with
    the copy.
    """

    def __init__(self, mutant: Mutant) -> None:
        WORK.mkdir(parents=True, exist_ok=True)
        self.folder = Path(tempfile.mkdtemp(prefix="copy-", dir=WORK))
        # Hard links need one file system, so this cache stands beside the common one.
        common = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        self.cache = Path(tempfile.mkdtemp(prefix="mutant-", dir=common.parent))
        if "/jit/" not in mutant.module:
            for folder in filter(Path.exists, (common / name for name in CACHES)):
                subprocess.run(["cp", "-al", folder, self.cache], check=False)
        tree = self.folder / "tree"
        shutil.copytree(ROOT, tree, symlinks=True, ignore=shutil.ignore_patterns(*LEFT_OUT))
        source = (ROOT / mutant.module).read_bytes()
        (tree / mutant.module).write_bytes(mutant.applied(source))
        (self.folder / "tmp").mkdir()
        self.tree = tree

    def pytest(self, tests: list[str], ranks: int, limit: float) -> tuple[int | None, str]:
        """The exit code of pytest, None beyond the limit, and what it says.

        Args:
            tests: Files or tests.
            ranks: On so many ranks.
            limit: Seconds.
        """
        words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--tb=line"]
        words += ["--color=no"]
        if ranks > 1:
            reports = tempfile.mkdtemp(dir=self.folder)
            words = ["mpirun", "-n", str(ranks), "--oversubscribe", *words]
            words += ["--timeout-method=thread", f"--reports-to={reports}"]
        else:
            words += ["-n0"]
        chosen = self.folder / "tests"
        chosen.write_text("\n".join(tests))
        said = self.folder / "said"
        with said.open("w") as out:
            process = subprocess.Popen(
                [*words, f"@{chosen}"],
                cwd=self.tree,
                env={
                    **os.environ,
                    "PYTHONPATH": str(self.tree),
                    "XDG_CACHE_HOME": str(self.cache),
                    "TMPDIR": str(self.folder / "tmp"),
                    "PATH": f"{self.tree}/docker/bin:{os.environ['PATH']}",
                },
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            try:
                code = process.wait(limit)
            except subprocess.TimeoutExpired:
                code = None
            finally:
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait()
        return code, said.read_text(errors="replace")

    def close(self) -> None:
        """Removes it."""
        shutil.rmtree(self.folder, ignore_errors=True)
        shutil.rmtree(self.cache, ignore_errors=True)


@dataclass(frozen=True)
class Verdict:
    """What became of a mutant.

    Attributes:
        outcome: "found" or "lived".
        by: The test that failed, or how else it was found.
        tests: How many tests there were.
    """

    outcome: str
    by: str
    tests: int


def verdict_on(mutant: Mutant, plan: Plan) -> Verdict:
    """Runs the tests of a mutant until one fails.

    Args:
        mutant: The mutant.
        plan: Its tests.
    """
    copy, ran = Copy(mutant), 0
    try:
        for stage in plan.stages(mutant):
            ran += len(stage.tests)
            by = _failure(copy, stage.tests, stage.ranks, 120 + 8 * stage.seconds)
            if by:
                return Verdict("found", by, ran)
    finally:
        copy.close()
    return Verdict("lived", "", ran)


def _failure(copy: Copy, tests: list[str], ranks: int, limit: float) -> str:
    """The test that fails, or what else goes wrong; "" if nothing does."""
    code, said = copy.pytest(tests, ranks, limit)
    gone = set(re.findall(r"ERROR: not found: \S*?(tests/.*)", said))
    if code == USAGE and gone:  # names of parameters are another's, or tests were renamed
        left = [test for test in tests if test not in gone]
        files = sorted({test.partition("::")[0] for test in gone})
        code, said = copy.pytest(left + files, ranks, 2 * limit)
    failed = re.search(r"^(?:FAILED|ERROR) (tests/\S+)", said, re.MULTILINE)
    if code == 0:
        return ""
    if failed:
        return failed[1]
    if code is None:
        return f"not done after {limit:.0f} s"
    last = " ".join(said.strip().splitlines()[-1:])[:120]
    return f"exit code {code}: {last}"


def run(mutants: list[tuple[int, Mutant]], jobs: int, plan: Plan) -> None:
    """Runs mutants, so many side by side.

    Args:
        mutants: With their numbers.
        jobs: How many at a time.
        plan: Their tests.
    """

    def one(number: int, mutant: Mutant) -> None:
        begin = time.monotonic()
        verdict = verdict_on(mutant, plan)
        seconds = f"{time.monotonic() - begin:.0f}"
        row = (mutant.key, mutant, verdict.outcome, verdict.by, verdict.tests, seconds)
        write(dict(zip(COLUMNS, row, strict=True)))
        print(f"{number:3} {verdict.outcome:5} {seconds:>4} s {mutant}  {verdict.by}", flush=True)

    with ThreadPoolExecutor(jobs) as pool:
        for done in [pool.submit(one, *each) for each in mutants]:
            done.result()


def numbers(text: str) -> set[int]:
    """The numbers of "1-20,33"."""
    spans = [word.partition("-") for word in text.split(",")]
    return {n for low, _, high in spans for n in range(int(low), int(high or low) + 1)}


def tables(mutants: list[Mutant]) -> str:
    """The tables of the documentation."""
    reasons, rows = equivalent(), results()
    last = {row["key"]: row for row in rows}
    first = {row["key"]: row for row in reversed(rows)}
    outcome = {
        one.key: "equivalent" if one.key in reasons else last.get(one.key, {}).get("outcome", "")
        for one in mutants
    }
    kinds = ("found", "lived", "equivalent")
    lines = []
    for title, of in (
        ("folder", lambda one: "/".join(one.module.split("/")[1:-1][:2]) or "."),
        ("change", lambda one: one.kind),
    ):
        groups: dict[str, Counter[str]] = {}
        for one in mutants:
            groups.setdefault(of(one), Counter()).update([outcome[one.key], "all"])
        lines += [f"| {title} | mutants | found | lived | equivalent | not run |"]
        lines += ["|---|---|---|---|---|---|"]
        groups = dict(sorted(groups.items()))
        groups["**all**"] = sum(groups.values(), Counter())
        for name, count in groups.items():
            cells = [count["all"], *(count[kind] for kind in kinds), count[""]]
            lines += [f"| {name} | " + " | ".join(str(cell or "") for cell in cells) + " |"]
        lines += [""]
    total = Counter(outcome.values())
    judged = total["found"] + total["lived"]
    lines += [
        f"{judged + total['equivalent']} of {len(mutants)} were run; of {judged} that are not "
    ]
    lines[-1] += f"equivalent {total['found']} were found: {100 * total['found'] / judged:.1f} %."
    lines += ["", "Equivalent, and why:", ""]
    lines += [f"* {one}: {reasons[one.key]}" for one in mutants if one.key in reasons]
    lines += ["", "Living:", ""]
    lines += [f"* {one}" for one in mutants if outcome[one.key] == "lived"] or ["none"]
    lines += ["", "Lived at first, and the test that finds it now:", ""]
    later = [
        one
        for one in mutants
        if outcome[one.key] == "found" and first[one.key]["outcome"] == "lived"
    ]
    lines += [f"* {one}: `{last[one.key]['by']}`" for one in later] or ["none"]
    return "\n".join(lines) + "\n"


def record(paths: list[str]) -> int:
    """Runs the quick set on one rank, or some of its folders, and writes down what it visits.

    Args:
        paths: Folders or files.
    """
    words = [sys.executable, "-m", "pytest", "-q", "-n0", "-p", "visits", "--ranks", "1"]
    words += ["--visits", str(WORK / "visits" / f"{time.time():.0f}.jsonl")]
    words += ["-o", f"testpaths={' '.join(paths or ['tests'])}"]
    path = f"{ROOT}{os.pathsep}{Path(__file__).parent}"
    env = {**os.environ, "PYTHONPATH": path}
    return subprocess.run(words, cwd=ROOT, env=env, check=False).returncode


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="tests/mutants", description=__doc__.split("\n")[0])
    parser.add_argument("--record", nargs="*", metavar="PATH", help="what tests execute")
    parser.add_argument("--list", action="store_true", help="the mutants, without running them")
    parser.add_argument("--table", action="store_true", help="writes the tables of docs/mutants.md")
    parser.add_argument("--only", type=numbers, metavar="N", help="these: 7, or 1-20,33")
    parser.add_argument("--again", action="store_true", help="those that lived, once more")
    parser.add_argument("--jobs", type=int, default=1, help="so many at a time")
    parser.add_argument("--count", type=int, default=200, help="size of the sample")
    parser.add_argument("--seed", type=int, default=15, help="of the sample")
    options = parser.parse_args()
    if options.record is not None:
        return record(options.record)
    mutants = chosen(ROOT, options.count, options.seed)
    if options.table:
        head = DOCUMENT.read_text(encoding="utf-8").partition(BEGIN)[0]
        DOCUMENT.write_text(f"{head}{BEGIN}\n\n{tables(mutants)}", encoding="utf-8")
        return 0
    done = {row["key"]: row["outcome"] for row in results()}
    done.update(dict.fromkeys(equivalent(), "equivalent"))
    wanted = [(n, one) for n, one in enumerate(mutants, 1) if n in (options.only or {n})]
    if options.list:
        for number, one in wanted:
            print(f"{number:3} {one.key} {done.get(one.key, '-'):10} {one}")
        return 0
    wanted = [
        each for each in wanted if done.get(each[1].key) == ("lived" if options.again else None)
    ]
    run(wanted, options.jobs, Plan(Visited(WORK / "visits")))
    return 0


if __name__ == "__main__":
    sys.exit(main())
