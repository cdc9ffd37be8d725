"""Gmsh's .geo files are programs: those that run commands or write files are refused.

Words, comments, texts and numbers are distinguished as by Gmsh's scanner (src/parser/Gmsh.l of
Gmsh 4), lest a command hide in what only one of the two takes for a comment.  Where Gmsh skips a
block (If, For, Macro) its scanner loses count of quotation marks; so in files with blocks nothing
that looks like a command may stand in a comment or text either.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from dolfin_elastic.core.errors import MeshError

_REFUSED = {
    **dict.fromkeys(
        ("System", "SystemCall", "NonBlockingSystemCall", "OnelabRun", "OnelabAction"),
        "would run a program",
    ),
    "ExternalProcess": "would run a program",
    **dict.fromkeys(("Save", "Print", "CreateDir", "Plugin"), "would write files"),
    "SendToServer": "would send data to another program",
    "Exit": "would end the run",
    # Their argument can become any word of this table.
    **dict.fromkeys(("StringToName", "S2N"), "would make a statement from a text"),
}
"""Words of statements of Gmsh.y that do more than describe a body, and what they do."""
SCRIPTS = (".geo", ".geo_unrolled")
_READING = ("Include", "Merge", "MergeWithBoundingBox")
_SHAPES = (".step", ".stp", ".brep", ".iges", ".igs", ".stl")
"""Files that Gmsh reads by their suffix, in small or capital letters, and never as a script."""
_PERHAPS_SCRIPTS = (*SCRIPTS, ".msh", ".pos", ".opt", "")
"""Others: scripts, unless they begin with a line of `_SECTIONS`."""
_SECTIONS = (b"$MeshFormat", b"$PostFormat")
_LONGEST = 1000
"""Letters of a text; Gmsh's scanner ends one after 1023 and reads on as if it were closed."""

_BLOCKS = ("If", "ElseIf", "For", "Macro", "Function")
_HIDDEN = re.compile(
    r"(?:SystemCall|Onelab(?:Run|Action)|ExternalProcess|StringToName|S2N)"
    r"|(?:System|Save|Print|Printf|CreateDir|Plugin|Include|Merge(?:WithBoundingBox)?)"
    r"\s*(?:[\"'(\[/]|Str|Sprintf|View)"
    r"|Exit\s*[;/]"
)
"""Commands in a comment or text, without prose such as "Save the mesh"."""
_TOKEN = re.compile(
    r"(?P<comment>//[^\n\r]*|/\*.*?(?:\*/|\Z))"
    r"|(?P<text>\"[^\"]*(?:\"|\Z)|'[^']*(?:'|\Z))"
    r"|(?P<number>(?:\d+\.\d*|\d*\.\d+)(?:[Ee][-+]?\d+)?|\d+[Ee][-+]?\d+|\d+)"
    r"|(?P<word>[A-Za-z_][A-Za-z0-9_]*)"
    r"|(?P<sign>\S)",
    re.DOTALL | re.ASCII,
)


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    line: int


def files_of_script(path: Path) -> dict[Path, bytes]:
    """A script and the files that it reads, by their paths relative to its folder. Local.

    Raises:
        MeshError: One of them would run commands, write files or read others from elsewhere, or
            whether it would cannot be seen without running it.
    """
    found: dict[Path, bytes] = {}
    _collect(path.parent, Path(path.name), found)
    return found


def _collect(folder: Path, script: Path, found: dict[Path, bytes], depth: int = 0) -> None:
    """Checks a script and adds it and what it reads.

    Args:
        script: Relative to it.
        depth: Number of scripts that include one another to reach it.
    """
    if depth > 10:
        raise MeshError(
            "scripts include one another without end",
            where=script.name,
            expected="leave out that of a script that includes this one",
        )
    found[script] = (folder / script).read_bytes()
    for name in _checked(script, found[script]):
        file = script.parent / name
        if file in found or not (folder / file).is_file():
            continue  # of a missing one Gmsh tells
        if not (folder / file).resolve().is_relative_to(folder.resolve()):
            raise MeshError(
                f"reads '{name}', which is outside of its folder",
                where=script.name,
                expected="copy it there; --trust is for scripts of your own",
            )
        content = (folder / file).read_bytes()
        if _is_shape(name) or content.split(b"\n", 1)[0].rstrip(b"\r") in _SECTIONS:
            found[file] = content
        else:
            _collect(folder, file, found, depth + 1)


def _checked(path: Path, content: bytes) -> list[str]:
    """Names of the files that a script reads, which may do nothing but describe a body."""
    data = content.replace(b"\r\n", b"\n")
    if b"\0" in data or b"\r" in data:
        raise MeshError(
            "the file holds a zero byte or a carriage return without line feed",
            where=path.name,
            expected="save it as plain text",
        )
    everything = list(_tokens(data.decode("latin-1"), path.name))
    if any(token.kind == "word" and token.text in _BLOCKS for token in everything):
        _check_hidden(path, everything)
    tokens = [token for token in everything if token.kind != "comment"]
    read = []
    for i, token in enumerate(tokens):
        if token.kind != "word":
            continue
        if token.text in _REFUSED:
            raise _refusal(path, token, _REFUSED[token.text])
        if token.text == "Printf" and _redirected(tokens, i + 1):
            raise _refusal(path, token, "would write files")
        if token.text in _READING:
            read.append(_file_read(path, token, _statement(tokens, i + 1)))
    return read


def _check_hidden(path: Path, tokens: Sequence[_Token]) -> None:
    for token in tokens:
        hidden = _HIDDEN.search(token.text) if token.kind in ("comment", "text") else None
        if hidden:
            word = re.match(r"\w+", hidden[0])
            command = _Token("word", word[0] if word else "", token.line)
            raise _refusal(path, command, f"in a {token.kind} looks like a command")


def _refusal(path: Path, token: _Token, what: str) -> MeshError:
    return MeshError(
        f"line {token.line}: '{token.text}' {what}; a mesh file may only describe a body",
        where=path.name,
        expected="leave the line out; --trust is for scripts of your own",
    )


def _tokens(text: str, name: str) -> Iterator[_Token]:
    line, at = 1, 0
    for match in _TOKEN.finditer(text):
        line += text.count("\n", at, match.start())
        at = match.start()
        kind = str(match.lastgroup)
        if kind == "text" and len(match[0]) > _LONGEST:
            raise MeshError(
                f"line {line}: a text of more than {_LONGEST} letters",
                where=name,
                expected="shorter texts; is a quotation mark missing?",
            )
        yield _Token(kind, match[0], line)


def _statement(tokens: Sequence[_Token], start: int) -> list[_Token]:
    """Tokens from `start` up to the semicolon."""
    end = next((i for i in range(start, len(tokens)) if tokens[i].text == ";"), len(tokens))
    return list(tokens[start:end])


def _redirected(tokens: Sequence[_Token], start: int) -> bool:
    """Printf(...) > "file"; a comparison stands within the parentheses."""
    depth = 0
    for token in _statement(tokens, start):
        depth += {"(": 1, ")": -1}.get(token.text, 0)
        if depth <= 0 and token.text == ">":
            return True
    return False


def _file_read(path: Path, token: _Token, statement: Sequence[_Token]) -> str:
    """The file of an Include or Merge; its name must be seen without running the script."""
    words = [t.text for t in statement if t.kind == "word"]
    texts = [t.text[1:-1] for t in statement if t.kind == "text"]
    here = ("StrCat", "Str", "CurrentDirectory", "CurrentDir")
    if len(texts) != 1 or any(word not in here for word in words):
        raise MeshError(
            f"line {token.line}: the file of '{token.text}' is not a plain text",
            where=path.name,
            expected=f'for example {token.text} "part.step";',
        )
    name = texts[0]
    if not _is_shape(name) and Path(name).suffix not in _PERHAPS_SCRIPTS:
        raise _refusal(path, token, f"reads '{name}', a file of a kind that may hold commands")
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise _refusal(path, token, f"reads '{name}', which is not in the folder of the script")
    return name


def _is_shape(name: str) -> bool:
    suffix = Path(name).suffix
    return suffix in _SHAPES or suffix in [shape.upper() for shape in _SHAPES]
