"""Pages of the documentation whose files are written and whose commands are run, in their order.

    docker/run python3 docs/_ext/tutorials.py docs/tutorials/bracket.md

writes its outputs and pictures anew.

A block of `console` has commands after `$`, each followed by what it prints.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"(?:^`([\w./]+)`:\n\n)?^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PICTURE = re.compile(r"!\[[^]]*\]\(([\w-]+\.png)\)")
LONGEST = 36
"""Lines of an output that a page shows; of more the middle is left out."""


@dataclass(frozen=True)
class Ran:
    """A command of a page.

    Attributes:
        command: As it stands there, of one line or more.
        recorded: Output that stands beneath it; may be empty.
        printed: What it has printed now.
        code: Its exit code.
        errors: What it has written to standard error.
    """

    command: str
    recorded: str
    printed: str
    code: int
    errors: str


def commands(block: str) -> Iterator[tuple[str, str]]:
    """Each command of a console block with the output beneath it."""
    for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
        lines = part.splitlines()
        count = next(n for n in range(1, len(lines) + 1) if _complete("\n".join(lines[:n])))
        yield "\n".join(lines[:count]), "\n".join(lines[count:]).rstrip()


def _complete(command: str) -> bool:
    """All quotes are closed."""
    try:
        shlex.split(command)
    except ValueError:
        return False
    return True


def perform(page: Path, folder: Path, environment: Mapping[str, str]) -> Iterator[Ran]:
    """Writes the files of a page and runs its commands in a folder."""
    path = f"{ROOT / 'docker/bin'}{os.pathsep}{environment['PATH']}"
    variables = {"PATH": path, "PYTHONPATH": str(ROOT), "REPOSITORY": str(ROOT)}
    for name, language, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        if name:
            (folder / name).write_text(text, encoding="utf-8")
        for command, recorded in commands(text) if language == "console" else ():
            done = subprocess.run(
                ["bash", "-c", command],
                cwd=folder,
                env={**environment, **variables},
                capture_output=True,
                text=True,
                timeout=240,
                check=False,
            )
            yield Ran(command, recorded, shown(done.stdout), done.returncode, done.stderr)


def shown(output: str) -> str:
    """What a page shows of an output: without times, of many load steps the ends."""
    lines = [
        line.rstrip()
        for line in re.sub("\n{2,}", "\n\n", output).strip("\n").splitlines()
        if not line.startswith(" time:")
    ]
    steps = [n for n, line in enumerate(lines) if re.match(r"(step|time) +\S", line)]
    if len(steps) > 3 and steps[-1] - steps[0] == len(steps) - 1:
        lines[steps[1] : steps[-1]] = ["..."]
    if len(lines) > LONGEST:
        lines[LONGEST // 2 : -LONGEST // 2] = ["..."]
    return "\n".join(lines)


def words(output: str) -> list[str]:
    """The lines of an output without what differs from machine to machine: numbers, spaces."""
    lines = (re.sub(r"[-+]?\d[\d.:]*(e[-+]?\d+)?", "#", line) for line in output.splitlines())
    kept = [line for line in lines if not re.match(r"(step|time) +\S|\.\.\.$", line)]
    return [re.sub(r"[\s─]+", " ", line).strip() for line in kept]


def pictures(page: Path) -> list[str]:
    """Names of the pictures of a page that its commands draw."""
    return PICTURE.findall(page.read_text(encoding="utf-8"))


def drawn(name: str, folder: Path) -> Path | None:
    """The file of a picture that the commands of a page have drawn."""
    return next(folder.rglob(name), None)


def record(page: Path) -> None:
    """Writes the outputs of a page's commands into it, and its pictures beside it."""
    text = page.read_text(encoding="utf-8")
    with TemporaryDirectory() as name:
        folder = Path(name)
        ran = list(perform(page, folder, os.environ))
        for one in ran:
            if one.code:
                sys.exit(f"{page.name}: {one.command}\n{one.printed}\n{one.errors}")
        for picture in pictures(page):
            shutil.copy(next(folder.rglob(picture)), page.parent)
    outputs = iter(ran)

    def anew(block: re.Match[str]) -> str:
        if block[2] != "console":
            return block[0]
        count = len(list(commands(block[3])))
        parts = [
            f"$ {one.command}\n" + (f"{one.printed}\n" if one.printed else "")
            for one in (next(outputs) for _ in range(count))
        ]
        return f"```console\n{''.join(parts)}```"

    page.write_text(BLOCK.sub(anew, text), encoding="utf-8")


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        record(Path(argument))
