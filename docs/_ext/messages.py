"""Pages of the messages: what each means and what to do.

The meanings stand in docs/reference/meanings/*.toml, one table a page, the messages in the program.
"""

from __future__ import annotations

import re
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from said import HOLE, ROOT, Message, constants, messages

MEANINGS = ROOT / "docs/reference/meanings"


@dataclass(frozen=True)
class Page:
    """What is known of one message, or of several that say the same.

    Attributes:
        name: Of the file, without a suffix.
        messages: Texts of the messages, as in `Message`.
        title: Heading; by default the first of the messages.
        means: What was checked, and why the program does not go on.
        do: What to do, beyond what the messages say; may be empty.
        guide: Path of the page to read on, from docs/, without a suffix.
        example: Something to be written, in TOML or as a command; may be empty.
        cause: Key of a diagnosis that this is; empty: none.
    """

    name: str
    messages: tuple[str, ...]
    means: str
    guide: str
    title: str = ""
    do: str = ""
    example: str = ""
    cause: str = ""

    @property
    def command(self) -> bool:
        """Whether the example is one."""
        return self.example.lstrip().startswith("dolfin-elastic")


def pages() -> list[Page]:
    """All pages of docs/reference/meanings."""
    found = []
    for file in sorted(MEANINGS.glob("*.toml")):
        for name, table in tomllib.loads(file.read_text(encoding="utf-8")).items():
            found.append(Page(name, tuple(table.pop("messages", ())), **table))
    return found


def unknown(known: Iterable[Message]) -> list[str]:
    """Texts of meanings that the program does not say.

    Args:
        known: The messages that were found.  Others are made of texts that stand somewhere in the
            program, such as the diagnoses.
    """
    texts = {one.text for one in known}
    rest = [text for page in pages() for text in page.messages if text not in texts]
    said = "\n".join(constants()) if rest else ""
    return [
        text
        for text in rest
        if not all(piece.strip(" :,;()'") in said for piece in text.split(HOLE))
    ]


# --- pages ---


def write(folder: Path) -> str:
    """Writes a page for each meaning.

    Args:
        folder: Where to, docs/reference/messages; files of other pages are removed.

    Returns:
        The tables of all messages, by the part of the program.
    """
    folder.mkdir(exist_ok=True)
    every, by_text = pages(), defaultdict[str, list[Message]](list)
    for one in messages():
        by_text[one.text].append(one)
    for page in every:
        file = folder / f"{page.name}.md"
        text = _page(page, [one for text in page.messages for one in by_text.get(text, ())])
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")
    names = {page.name for page in every}
    for file in folder.glob("*.md"):
        if file.stem not in names:
            file.unlink()
    return _tables(by_text, every)


def _page(page: Page, known: Sequence[Message]) -> str:
    advice: dict[str, dict[str, None]] = {text: {} for text in page.messages}
    for one in known:
        if re.search(r"[a-z0-9]{2}", one.advice):
            advice[one.text][code(one.advice)] = None
    single = not page.title and len(page.messages) == 1
    codes = sorted({one.code for one in known} or {"3" if page.cause else "2"})
    parts = [f"---\norphan: true\n---\n\n# {page.title or code(page.messages[0])}"]
    if page.messages and not single:
        rows = [f"| {code(text)} | {'; '.join(advice[text])} |" for text in page.messages]
        plain = "\n".join(f"- {code(text)}" for text in page.messages)
        table = _table("| message | what it says to do |\n|---|---|", rows)
        parts.append(table if any(advice.values()) else plain)
    parts.append(f"**What it means.** {_sentence(page.means)}")
    if page.do:
        parts.append(f"**What to do.** {_sentence(page.do)}")
    if single and advice[page.messages[0]]:
        start = "The message says" if page.do else "**What to do.** The message says"
        parts.append(f"{start}: {'; '.join(advice[page.messages[0]])}.")
    if page.example:
        kind = "console" if page.command else "toml"
        shown = re.sub("^(?=dolfin-elastic)", "$ ", page.example.strip(), flags=re.MULTILINE)
        parts.append(f"```{kind}\n{shown}\n```")
    if page.cause:
        parts.append(f"In `summary.json`, `diagnosis.cause` is `{page.cause}`.")
    if codes == ["0"]:
        parts.append("This is a warning, or a note of `check`: the program goes on.")
    else:
        parts.append(f"Exit code: {' or '.join(codes)}, see [exit codes](../../guide/errors.md).")
    parts.append(f"Read on: [](../../{page.guide}.md). [All messages](../messages.md).")
    return "\n\n".join(parts) + "\n"


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:].rstrip(".") + "."


def _tables(by_text: Mapping[str, Sequence[Message]], every: Iterable[Page]) -> str:
    rows: dict[str, set[str]] = defaultdict(set)
    others, causes = set(), set()
    for page in every:
        for text in page.messages or (page.title,):
            link = f"[{code(text)}](messages/{page.name}.md)"
            for one in by_text.get(text, ()):
                rows[f"`{one.part}`"].add(f"| {link} | {cell(one.advice)} | {one.code} |")
            if page.cause:
                causes.add(f"| {link} | `{page.cause}`: {cell(page.do)} | 3 |")
            elif text not in by_text:
                others.add(f"| {link} | {cell(page.do)} | 2 |")
    parts = [*sorted(rows.items()), ("In several parts", others), ("Diagnoses", causes)]
    head = "| message | what to do | code |\n|---|---|---|"
    return "\n\n".join(f"## {part}\n\n{_table(head, sorted(one))}" for part, one in parts) + "\n"


def _table(head: str, rows: Iterable[str]) -> str:
    """A table whose cells wrap."""
    return "\n".join(["```{table}", ":class: messages", "", head, *rows, "```"])


def code(text: str) -> str:
    """A text as it stands on the screen, also in a cell of a table."""
    text = text.replace("|", "\\|")
    return f"`` {text} ``" if "`" in text else f"`{text}`"


def cell(text: str) -> str:
    """A text in a cell of a table."""
    return escaped(" ".join(text.split())).replace("|", "\\|")


def escaped(text: str) -> str:
    """Text of docstrings as Markdown: brackets are no links, stars no emphasis."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(
        part if part.startswith("`") else re.sub(r"([\[\]*_<>{}$])", r"\\\1", part)
        for part in parts
    )
