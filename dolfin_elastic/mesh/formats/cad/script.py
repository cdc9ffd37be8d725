"""Gmsh's .geo files are programs: their commands are named here, and kept from harm by Landlock.

This tells an honest author which line does more than describe a body.  A command that hides in what
only Gmsh's scanner takes for code is carried out by a process that can run no program and write no
file (see `process`); so a kernel without Landlock reads no scripts but trusted ones.
"""

from __future__ import annotations

import re
from pathlib import Path

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh.formats.cad import landlock

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
_TOKEN = re.compile(
    r"//[^\n\r]*|/\*.*?(?:\*/|\Z)|\"[^\"]*(?:\"|\Z)|'[^']*(?:'|\Z)"
    r"|(?P<read>\b(?:Include|Merge(?:WithBoundingBox)?|ShapeFromFile)\b[^;\"']*[\"'](?P<file>[^\"']*)[\"'])"
    r"|(?P<word>\b[A-Za-z_]\w*)",
    re.DOTALL | re.ASCII,
)


def files_of_script(path: Path) -> dict[Path, bytes]:
    """A script and the files that it reads, by their paths relative to its folder. Local.

    Raises:
        MeshError: One of them would run commands, write files or read others from elsewhere, or
            this kernel has no Landlock.
    """
    if not landlock.version():
        raise MeshError(
            "a .geo file is a program, from whose commands only Landlock protects, which this "
            "kernel does not have (Linux 5.13 and later)",
            where=path.name,
            expected="the body as STEP; --trust is for scripts of your own",
        )
    folder, result = path.parent, dict[Path, bytes]()
    scripts = [Path(path.name)]
    while scripts:
        script = scripts.pop()
        result[script] = (folder / script).read_bytes()
        for file in _read_by(folder, script, result[script].decode("latin-1")):
            if file in result or not (folder / file).is_file():
                continue  # of a missing one Gmsh tells
            if file.suffix in (*SCRIPTS, ""):
                scripts.append(file)
            else:
                result[file] = (folder / file).read_bytes()
    return result


def files_named(text: str) -> list[str]:
    """Names of the files that a script reads; those in comments and texts are none."""
    return [token["file"] for token in _TOKEN.finditer(text) if token["read"]]


def without_comments(text: str) -> str:
    """A script without its comments."""
    return _TOKEN.sub(lambda token: " " if token[0].startswith(("//", "/*")) else token[0], text)


def _read_by(folder: Path, script: Path, text: str) -> list[Path]:
    """The files that a script reads, relative to the folder; refuses commands and other folders."""
    result = []
    for token in _TOKEN.finditer(text):
        fault = ""
        if token["word"] in _REFUSED:
            fault = f"'{token['word']}' {_REFUSED[token['word']]}"
        elif token["read"]:
            result.append(script.parent / token["file"])
            # Its copy has the same path in another folder, from which ".." would lead elsewhere.
            leaves = result[-1].is_absolute() or ".." in result[-1].parts or "\0" in token["file"]
            if leaves or not (folder / result[-1]).resolve().is_relative_to(folder.resolve()):
                fault = f"reads '{token['file']}', which is not in the folder of the script"
        if fault:
            raise MeshError(
                f"line {text.count(chr(10), 0, token.start()) + 1}: {fault}; a mesh file may only "
                "describe a body",
                where=script.name,
                expected="leave the line out; --trust is for scripts of your own",
            )
    return result
