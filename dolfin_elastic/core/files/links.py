"""Folders of results in which a name stands for something elsewhere."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.files.regular import irregular

_STEMS = (
    *("results", "history", "summary", "picture", "modes", "mode", "failed_state"),
    *("converge", "sweep", "row", "report", "plot", "checkpoints", "lock"),
    *("statics", "modal", "buckling", "dynamics"),  # folders of several analyses
)
"""What names of results begin with, but for those that the case gives its pictures."""


def refuse_links(folder: Path, files: Iterable[str] = ()) -> None:
    """Refuses a folder of results in which a name of ours stands for something elsewhere.

    The folder itself may be a link: its user has named it.  Not collective.

    Args:
        folder: Of the results, which need not exist.
        files: Names in it that the case gives.

    Raises:
        InputError: A link, a pipe or a device has a name under which results are written.
    """
    names = [Path(file) for file in files]
    stems = {*_STEMS, *(name.stem for name in names)}
    below = {folder / parent for name in names for parent in name.parents}
    for path in sorted({folder, *below}):
        _check_folder(folder, path, stems)


def _check_folder(folder: Path, path: Path, stems: Iterable[str]) -> None:
    if path != folder and irregular(path):
        raise _not_ours(folder, path)
    for one in _entries(path):
        if not _is_ours(one.name, stems):
            continue
        if irregular(one.path):
            raise _not_ours(folder, Path(one.path))
        if one.is_dir(follow_symlinks=False):
            for file in _entries(Path(one.path)):
                if irregular(file.path):
                    raise _not_ours(folder, Path(file.path))


def _is_ours(name: str, stems: Iterable[str]) -> bool:
    """Whether a name is one of these stems, or begins with it: ".history.csv.part"."""
    plain = name.removeprefix(".")
    return any(plain == stem or plain.startswith((f"{stem}.", f"{stem}_")) for stem in stems)


def _entries(path: Path) -> list[os.DirEntry[str]]:
    """What is in a folder; nothing in one that is not there or may not be looked at."""
    try:
        with os.scandir(path) as entries:
            return sorted(entries, key=lambda one: one.name)
    except OSError:
        return []


def _not_ours(folder: Path, path: Path) -> InputError:
    return InputError(
        f"'{path.relative_to(folder)}' in it is {irregular(path)}: results are written into files "
        "of this folder alone",
        where=str(folder),
        expected="remove it, or choose another folder",
    )
