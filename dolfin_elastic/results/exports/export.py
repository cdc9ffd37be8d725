"""`export`: a finished run in the format of a file's ending."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.results.exports.settings import ExportSettings
from dolfin_elastic.results.files import make_folder

if TYPE_CHECKING:
    from dolfin_elastic.results.exports.moving import Moving
    from dolfin_elastic.results.finished.run import FinishedRun

_SURFACES = {
    ".glb": ("glb", "write_glb"),
    ".ply": ("series", "write_ply"),
    ".obj": ("series", "write_obj"),
    ".usd": ("usd", "write_usd"),
    ".usdc": ("usd", "write_usd"),
    ".usda": ("usd", "write_usd"),
}
_TABLES = {
    ".frd": ("tables", "write_frd"),
    ".csv": ("tables", "write_csv"),
    ".vtkhdf": ("vtkhdf", "write_vtkhdf"),
}
SUFFIXES = (*_SURFACES, *_TABLES)
_HERE = "dolfin_elastic.results.exports"


@dataclass(frozen=True)
class Exported:
    """What was written.

    Attributes:
        files: In the order of the states.
        content: In words.
        notes: What is left out, or does not fit.
    """

    files: list[Path]
    content: str
    notes: tuple[str, ...] = ()


def check_export(file: Path, settings: ExportSettings, where: str) -> None:
    """Checks what can be checked without results.

    Args:
        where: The key or argument that names the file.

    Raises:
        InputError: No such format, or a setting without effect in it, or a package is missing.
    """
    if file.suffix not in SUFFIXES:
        raise InputError(
            f"'{file.name}' is of no format that results are exported to",
            where=where,
            expected=nearest(file.suffix, SUFFIXES),
        )
    if file.suffix in _TABLES:
        unused = ("field", "fps", "limits", "skin", *(["scale"] if file.suffix != ".frd" else []))
        plain = ExportSettings()
        for name in unused:
            if getattr(settings, name) != getattr(plain, name):
                option = "range" if name == "limits" else name
                raise InputError(
                    f"'{file.name}' holds all nodes and fields, `{option}` is of surfaces",
                    where=where,
                    expected="leave it out, or write .glb, .ply, .obj or .usdc",
                )
    elif _SURFACES[file.suffix][0] == "usd":
        import_module(f"{_HERE}.usd").need_usd(file)


def export(run: FinishedRun, file: Path, settings: ExportSettings) -> Exported:
    """Writes results of a run for another program. Not collective.

    Args:
        file: Its ending says the format; series of files get numbers in their names.

    Raises:
        InputError: See `check_export`; or the run has no such field or mode, or no states.
        MeshError: The surface that is to follow cannot be read.
        OutputError: A file cannot be written.
    """
    from dolfin_elastic.results.exports import moving as of
    from dolfin_elastic.results.exports import skin
    from dolfin_elastic.results.finished.modes import as_modes

    check_export(file, settings, str(file))
    make_folder(file.parent)
    run = as_modes(run, settings.mode)
    if file.suffix in _TABLES:
        module, name = _TABLES[file.suffix]
        notes = getattr(import_module(f"{_HERE}.{module}"), name)(run, settings, file)
        states = len(of.chosen(run, settings.frames))
        return Exported([file], _count(states, "mode" if run.modal else "state"), notes)
    binding = None if settings.skin is None else skin.bound(run, settings.skin)
    moving = of.Moving(run, settings, binding)
    module, name = _SURFACES[file.suffix]
    write: Callable[[Moving, Path], list[Path]] = getattr(import_module(f"{_HERE}.{module}"), name)
    files = write(moving, file)
    note = moving.body.note
    return Exported(files, _described(moving), (note,) if note else ())


def _described(moving: Moving) -> str:
    from dolfin_elastic.results.scene.colour_bar import prefixed

    low, high = moving.ends
    factor, unit = prefixed(max(abs(low), abs(high)), moving.unit)
    body = moving.body
    size = f"{len(body.points)} points, {len(body.triangles)} triangles"
    ends = f"{moving.field} from {low / factor:.4g} to {high / factor:.4g} {unit}".rstrip()
    return (
        f"{_count(len(moving), 'mode' if moving.run.modal else 'state')}, {size}, colours: {ends}"
    )


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' if number > 1 else ''}"
