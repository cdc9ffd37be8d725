"""Restart: what is in the folder of a run that was stopped, and what must be unchanged."""

from __future__ import annotations

import json
import logging
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfin_elastic.case.analysis import ANALYSES
from dolfin_elastic.case.case import Case, read_case
from dolfin_elastic.case.curve_files import CURVED
from dolfin_elastic.case.toml import toml_text
from dolfin_elastic.core.errors import InputError, RestartError, nearest_file
from dolfin_elastic.core.files.links import refuse_links
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.si_text import time_or_load
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.model.records import RecordTable
from dolfin_elastic.results.checkpoint.checkpoints import (
    CASE,
    FOLDER,
    Checkpoint,
    RunDescription,
    digest,
    last_step,
    newest_checkpoint,
    read_case_text,
)
from dolfin_elastic.results.checkpoint.checksums import fingerprint
from dolfin_elastic.results.checkpoint.lock import check_free
from dolfin_elastic.results.files import replace_text

log = logging.getLogger("dolfin_elastic")

_FILES = ("file", "image", "library", "viscous", "prony")
"""Keys of a case, at any depth, whose texts name files or folders."""


@dataclass(frozen=True)
class Unfinished:
    """A run that was stopped and can be continued.

    Attributes:
        case: What it computes.
        folder: Of its results.
        found: Its newest undamaged checkpoint.
        newest: Step of its newest checkpoint, damaged or not.
        rest: Other analyses of the same case that are to be computed afterwards.
    """

    case: Case
    folder: Path
    found: Checkpoint
    newest: int | None
    rest: tuple[Case, ...] = ()

    @property
    def step(self) -> int:
        """Step of the checkpoint."""
        return int(self.found.content["step"])

    @property
    def done(self) -> float:
        """Share of the run that was done at the checkpoint."""
        return float(self.found.content["done"])

    def message(self) -> str:
        """Step, time or load, and date of the checkpoint, for the log."""
        content = self.found.content
        place = time_or_load(content["t"], timed=self.case.timed)
        return f"going on after step {self.step} ({place}), written {content['written']}"

    def check_newest(self) -> None:
        """Checks that nobody has continued the run since it was found. Collective.

        Raises:
            RestartError: The run is complete, or has other checkpoints now.
        """
        on_root(self.found.comm, self._check_newest)

    def _check_newest(self) -> None:
        _check_unfinished(self.folder)
        if last_step(self.folder) != self.newest or not self.found.path.is_file():
            raise RestartError(
                "another run has gone on from these checkpoints meanwhile",
                where=str(self.folder),
                expected="restart it again",
            )

    def check_mesh(self, description: RunDescription) -> None:
        """Checks that the mesh is that of the checkpoint. Collective.

        Raises:
            RestartError: It is another one.
        """
        before = self.found.content["mesh"]
        if before == json.loads(json.dumps(description.mesh)):
            return
        words = {"cells": "number of elements", "geometry": "positions of elements"}
        words["obstacles"] = "surfaces of obstacles"
        which = next(
            (key for key in description.mesh if before.get(key) != description.mesh[key]), "cells"
        )
        raise RestartError(
            f"the mesh is not that of the checkpoint: its {words.get(which, which)} differ",
            where=str(self.folder),
            expected="the mesh as it was (a CAD file must be meshed by the same Gmsh), or "
            "compute the case anew",
        )


def unfinished(
    folder: str | PathLike[str],
    *,
    case: Case | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    trust: bool = False,
) -> Unfinished:
    """Finds the run in a folder of results. Collective.

    Of a case with several analyses, in their common folder, that is the first one with a
    checkpoint; those after it that are not complete are its rest.

    Args:
        case: What it computes; needed only of a case with Python functions, which is no text.
        comm: The ranks that continue it.
        trust: See `read_case`.

    Raises:
        RestartError: There is nothing to go on from, the case is another one, or it is still going.
    """
    path = Path(folder)
    if part := on_root(comm, lambda: _stopped_part(path)):
        one = unfinished(path / part, case=case, comm=comm, trust=trust)
        after = one.case.whole.analyses()[one.case.whole.given.index(one.case.analysis) + 1 :]
        left = on_root(comm, lambda: [_status(path / p.analysis) != "completed" for p in after])
        return replace(one, rest=tuple(p for p, open_ in zip(after, left, strict=True) if open_))
    on_root(comm, lambda: _check_folder(path))
    latest = on_root(comm, lambda: last_step(path))
    checkpoint = newest_checkpoint(comm, path)
    if checkpoint is None:
        raise RestartError(
            "all its checkpoints are damaged", where=str(path), expected="compute the case anew"
        )
    copy = path / FOLDER / CASE
    text = on_root(comm, lambda: _case_text(path, checkpoint.content))
    if digest(text) != checkpoint.content["case"]:
        raise RestartError(
            "this is not the case of the checkpoint any more",
            where=str(copy),
            expected="the file as the run has left it, or compute the case anew",
        )
    if not text and case is None:
        raise RestartError(
            "the case was made in Python and cannot be written down",
            where=str(path),
            expected="in Python: restart(folder, case=...)",
        )
    written = read_case(copy, comm=comm, trust=trust) if text else None
    if written is not None and case is not None and _tables(case) != _tables(written):
        raise RestartError(
            "the case is not that of the checkpoint: " + _difference(case, written),
            where=str(path),
            expected="the same case, or compute it anew",
        )
    if written is not None and case is None:
        _warn_if_changed(written, checkpoint.content["file"], comm)
    known = case or written
    assert known is not None
    parts, which = known.analyses(), checkpoint.content.get("analysis")
    stopped = next((one for one in parts if one.analysis == which), parts[0])
    return Unfinished(stopped, path, checkpoint, latest)


def _stopped_part(folder: Path) -> str:
    """The first analysis of several that goes on from a checkpoint, or else the first that failed.

    Empty where there is no checkpoint.  On rank 0.
    """
    if (folder / "summary.json").exists() or not folder.is_dir():
        return ""
    refuse_links(folder)
    parts = [one for one in ANALYSES if last_step(folder / one) is not None]
    return next((one for one in parts if _status(folder / one) != "failed"), "".join(parts[:1]))


def _case_text(folder: Path, content: Mapping[str, Any]) -> str:
    """Text of the case of a run; that in the checkpoint, where the file is damaged. On rank 0.

    A file that can be read and is another case is the user's, and refused elsewhere.
    """
    known = content.get("case_text")
    try:
        text = read_case_text(folder)
        tomllib.loads(text)
        fault = "is cut" if known and text != known and known.startswith(text) else ""
    except (RestartError, tomllib.TOMLDecodeError) as error:
        if known is None:  # of an older version
            raise
        fault = str(error)
    if not fault:
        return text
    copy = folder / FOLDER / CASE
    log.warning("%s is damaged: its copy in the checkpoint takes its place", copy)
    replace_text(copy, str(known))
    return str(known)


def _check_folder(folder: Path) -> None:
    """Checks that a stopped run is in the folder. On rank 0."""
    where = str(folder)
    if folder.is_file():
        raise RestartError(
            "this is a file", where=where, expected="expected the folder of the results of a run"
        )
    if not folder.is_dir():
        parent = folder.parent
        others = [p.parent.parent for p in parent.glob(f"*/{FOLDER}/{CASE}")]
        hint = nearest_file(folder.name, [p.name for p in others]) if others else ""
        raise RestartError("there is no such folder", where=where, expected=hint)
    refuse_links(folder)
    check_free(folder)
    _check_unfinished(folder)


def _check_unfinished(folder: Path) -> None:
    """Checks that a run is not complete and has a checkpoint. On rank 0."""
    where, status = str(folder), _status(folder)
    if status == "completed":
        raise RestartError(
            "this run is complete", where=where, expected="nothing is left to compute"
        )
    if last_step(folder) is None:
        parts = {one: state for one in ANALYSES if (state := _status(folder / one))}
        if parts and not status:
            words = ", ".join(f"{one} {state}" for one, state in parts.items())
            raise RestartError(
                f"no analysis has a checkpoint here: {words}",
                where=where,
                expected="compute the case anew; modes and buckling have no checkpoints",
            )
        if not status:
            raise RestartError(
                "this is no folder of results",
                where=where,
                expected="expected one that a run has written",
            )
        raise RestartError(
            "the run has ended before its first checkpoint",
            where=where,
            expected="compute the case anew; output.checkpoint says how often there is one, "
            "modes and buckling have none",
        )


def _status(folder: Path) -> str:
    """Status of a run in its summary; empty if there is none."""
    try:
        return str(json.loads((folder / "summary.json").read_text(encoding="utf-8"))["status"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return ""


def describe_run(
    case: Case, body: Body, petsc: PetscOptions, before: Unfinished | None = None
) -> RunDescription:
    """The description of a run that its checkpoints carry. Not collective.

    Args:
        petsc: PETSc options from outside the case.
        before: The run that is continued. Its case is read from the copy in the folder of results,
            but the file to compare with at the next restart stays the user's.
    """
    try:
        tables = portable(case.whole)
        text = toml_text(tables)
    except TypeError:  # TOML has no Python functions
        text = ""
    file = str(Path(case.file).resolve()) if case.file else ""
    if before is not None:
        file = before.found.content["file"] or file
    return RunDescription(text, file, partial(fingerprint, body), petsc, case.analysis)


def portable(case: Case) -> dict[str, Any]:
    """The tables of a case, with numbers in place of CSV files and an absolute mesh path."""
    given = {key: rows for key in CURVED if (rows := getattr(case, key))}
    inlined = {
        key: [_inline(row) for row in rows] if isinstance(rows, list) else _inline(rows)
        for key, rows in given.items()
    }
    tables = case.model_copy(update=inlined).to_dict()
    if (file := case.file_of_start) is not None:
        tables["dynamics"]["start"]["file"] = str((case.folder / file).resolve())
    for mesh, key in meshes_of(tables):
        mesh[key] = str((case.folder / mesh[key]).resolve())
    return tables


def meshes_of(tables: dict[str, Any]) -> list[tuple[dict[str, Any], str]]:
    """Tables of meshes and obstacles from files, each with the key of the file."""
    mesh = tables["mesh"]
    obstacles = [row["mesh"] for row in tables.get("contact", []) if "mesh" in row]
    every = (mesh, *mesh.get("parts", {}).values(), *obstacles)
    return [(one, key) for one in every for key in ("file", "image") if key in one]


def tables_in(case: Case, folder: Path) -> dict[str, object]:
    """The tables of a case as they were written, for a file in another folder. Not collective."""

    def moved(value: object, key: str = "") -> object:
        if isinstance(value, Mapping):
            return {name: moved(inner, name) for name, inner in value.items()}
        if isinstance(value, list | tuple):
            return [moved(inner) for inner in value]
        if key not in _FILES or not isinstance(value, str) or Path(value).is_absolute():
            return value
        path = case.folder / value
        return os.path.relpath(path.resolve(), folder.resolve()) if path.exists() else value

    tables = case.written if case.file else case.to_dict()  # Python's own types become TOML's
    return {key: moved(value, key) for key, value in tables.items()}


def written_tables(case: Case) -> dict[str, Any]:
    """As `portable`, for results that may be given away: without the folders of this machine.

    Not collective.

    Returns:
        The tables; empty of a case with Python functions, which no file holds.
    """
    tables = portable(case)
    if (file := case.file_of_start) is not None:
        tables["dynamics"]["start"]["file"] = Path(file).name
    for mesh, key in meshes_of(tables):
        mesh[key] = Path(mesh[key]).name
    if case.output.folder is not None and Path(case.output.folder).is_absolute():
        tables["output"]["folder"] = Path(case.output.folder).name
    try:
        toml_text(tables)
    except TypeError:
        return {}
    return tables


def _inline(row: Record) -> Record:
    """A record with tables in place of the CSV files of its curve and of its values over time."""
    update: dict[str, object] = {}
    for key in type(row).model_fields:
        value = getattr(row, key)
        if isinstance(value, Amplitude) and value.rows:
            update[key] = Amplitude(value.rows)
        elif isinstance(value, list) and any(isinstance(one, RecordTable) for one in value):
            update[key] = [_inline_value(one) for one in value]
        elif isinstance(value, RecordTable):
            update[key] = _inline_value(value)
    return row.model_copy(update=update) if update else row


def _inline_value(value: object) -> object:
    if not isinstance(value, RecordTable):
        return value
    unit = {"unit": value["unit"]} if "unit" in value else {}
    return {"table": [list(pair) for pair in value.rows], **unit}


def _warn_if_changed(written: Case, file: str, comm: MPI.Comm) -> None:
    """Warns where the case file has been changed since the run began. Collective."""
    if not file or not on_root(comm, Path(file).is_file):
        return  # there is none on this machine
    try:
        now = read_case(file, comm=comm)
    except InputError as error:
        log.warning(
            "the case file cannot be compared with the case as it was, with which the run goes on: "
            "%s",
            error,
        )
        return
    if _tables(now) != _tables(written):
        log.warning(
            "%s has been changed (%s); the run goes on with the case as it was",
            file,
            _difference(now, written),
        )


def _tables(case: Case) -> dict[str, Any]:
    """Tables by which two cases are compared; without mesh files, which have a fingerprint."""
    tables = json.loads(json.dumps(portable(case.whole), default=repr))
    for mesh in (tables["mesh"], *tables["mesh"].get("parts", {}).values()):
        mesh.pop("file", None)
    return dict(tables)


def _difference(case: Case, other: Case) -> str:
    """The first dotted key in which two cases differ."""
    here, there = _tables(case), _tables(other)
    return _first_difference(here, there) or "the case"


def _first_difference(here: object, there: object, path: str = "") -> str:
    if isinstance(here, dict) and isinstance(there, dict):
        pairs = [(f".{key}", here.get(key), there.get(key)) for key in {**here, **there}]
    elif isinstance(here, list) and isinstance(there, list) and len(here) == len(there):
        pairs = [(f"[{i}]", a, b) for i, (a, b) in enumerate(zip(here, there, strict=True))]
    else:
        return path.lstrip(".")
    return next((_first_difference(a, b, path + key) for key, a, b in pairs if a != b), "")
