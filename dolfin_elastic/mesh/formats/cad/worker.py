"""The process in which Gmsh runs: it reads questions and writes answers as lines of JSON.

Whatever a file makes Gmsh do, it can read the folder that it was given, write the one beside it,
and nothing else.  What it answers is data for the process that has started it, and no objects.
"""

from __future__ import annotations

import ctypes
import json
import os
import resource
import signal
import sys
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.mesh.formats.cad import landlock
from dolfin_elastic.mesh.formats.cad.faces import describe_faces, named_bodies
from dolfin_elastic.mesh.formats.cad.meshing import (
    load,
    load_file,
    logged_errors,
    mesh_model,
    save,
    save_normals,
)
from dolfin_elastic.mesh.formats.cad.shapes import Lengths
from dolfin_elastic.mesh.formats.cad.sizes import LocalField
from dolfin_elastic.mesh.formats.surfaces.filling.in_gmsh import GIVEN, fill_in_gmsh

ASKED_OF_MODEL = ("getEntities", "getBoundingBox", "getClosestPoint", "getType", "getAdjacencies")
"""Functions of Gmsh's model that tell something of it and change nothing."""
_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG


def main() -> None:
    """Answers questions until there are no more. The first line tells what it may do."""
    # What libraries print to the standard output is no answer.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    ctypes.CDLL(None).prctl(_DEATH_SIGNAL, signal.SIGKILL)
    terms = json.loads(sys.stdin.readline())
    worker = None
    for line in sys.stdin:
        try:
            worker = worker or _Worker(terms)
            answer = {"answer": worker.answer(json.loads(line))}
        except MeshError as error:
            answer = {"refused": [error.what, error.where, error.expected]}
        except MemoryError:
            answer = {"short": True}
        except Exception:
            answer = {"fault": traceback.format_exc()}
        answers.write(json.dumps(answer, default=_plain) + "\n")
        answers.flush()


def _plain(value: AnyArray) -> object:
    """Arrays and numbers of numpy as JSON has them."""
    return value.tolist()


class _Worker:
    """Gmsh, confined.

    Args:
        terms: The `file`, the folders that are `readable` and `writable`, the largest `memory`
            [byte], the size of its largest file on the `disk` [byte], and whether to be `confined`
            to these folders.
    """

    def __init__(self, terms: Mapping[str, Any]) -> None:
        self._path, self._folder = Path(terms["file"]), Path(terms["writable"])
        try:
            import gmsh
        except ImportError:
            raise MeshError(
                "Gmsh is needed for this file but its Python module is not installed",
                where=self._path.name,
                expected="install python3-gmsh",
            ) from None
        resource.setrlimit(resource.RLIMIT_AS, (terms["memory"], terms["memory"]))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        # Gmsh does not look whether its files are written: beyond the limit its process ends.
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_FSIZE, (terms["disk"], terms["disk"]))
        if terms["confined"]:
            # numpy imports some of its modules when they are needed.
            landlock.confine(map(Path, [terms["readable"], *sys.path]), self._folder)
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.logger.start()
        gmsh.model.add(self._path.stem)
        self._gmsh = gmsh
        self._tasks: Mapping[str, Callable[..., object]] = {
            "shapes": self._shapes,
            "mesh": self._mesh,
            "convert": self._convert,
            "load": self._load,
            "ask": self._ask,
            "fill": self._fill,
        }

    def answer(self, question: Mapping[str, Any]) -> object:
        """What a question asks for: the name of a task, and its arguments.

        Raises:
            MeshError: Gmsh cannot do it.
        """
        name = self._path.name
        # Errors of earlier questions, which did no harm there, are no reason for this one's.
        self._gmsh.logger.stop()
        self._gmsh.logger.start()
        try:
            return self._tasks[question["do"]](**question["with"])
        except UnicodeDecodeError:
            raise MeshError(
                "Gmsh cannot read it: a text is not UTF-8",
                where=name,
                expected="names of plain letters, or a file saved in UTF-8",
            ) from None
        except Exception as error:
            if type(error) is not Exception:  # Gmsh raises this base class itself
                raise
            told = self._errors() or str(error)
        told = told.replace(f"{self._path.parent}{os.sep}", "")
        raise MeshError(
            f"Gmsh cannot read or mesh it: {told}",
            where=name,
            expected="a file that Gmsh opens and meshes by itself",
        )

    def _errors(self) -> str:
        try:
            return logged_errors(self._gmsh)
        except UnicodeDecodeError:
            return "an error at a text that is not UTF-8"

    def _shapes(self, dim: int | None, join: bool, unit: str, factor: float) -> dict[str, object]:
        """Loads the file; returns remarks, the body's dimension, its faces, and named bodies."""
        lengths = Lengths(unit, factor)
        remarks, dim = load_file(self._gmsh, self._path, dim=dim, join=join, lengths=lengths)
        return {
            "notes": remarks.notes,
            "information": remarks.information,
            "dim": dim,
            "faces": describe_faces(self._gmsh, dim),
            "bodies": named_bodies(self._gmsh, dim),
        }

    def _mesh(
        self,
        size: float | None,
        local: list[LocalField],
        curved: bool | None,
        dim: int,
        unit: str,
        factor: float,
    ) -> dict[str, object]:
        """Meshes what is loaded; returns notes and information, and the faces with normals."""
        remarks = mesh_model(
            self._gmsh,
            self._path.name,
            size=size,
            local=local,
            curved=curved,
            dim=dim,
            lengths=Lengths(unit, factor),
        )
        save(self._gmsh, self._folder)
        return {
            "notes": remarks.notes,
            "information": remarks.information,
            "normals": save_normals(self._gmsh, dim, self._folder),
        }

    def _convert(self) -> None:
        """Saves a mesh in the version that is read."""
        self._gmsh.open(str(self._path))
        save(self._gmsh, self._folder)

    def _load(self) -> None:
        """Loads a CAD file, of which the next questions are."""
        load(self._gmsh, self._path)

    def _fill(self, way: dict[str, float]) -> None:
        """Fills the complex in the file's folder with tetrahedra."""
        fill_in_gmsh(self._gmsh, self._path.parent / GIVEN, self._folder, way)

    def _ask(self, name: str, arguments: list[list[float] | int]) -> object:
        """The result of a function of the model, one of `ASKED_OF_MODEL`."""
        assert name in ASKED_OF_MODEL
        converted = [np.array(a) if isinstance(a, list) else a for a in arguments]
        return getattr(self._gmsh.model, name)(*converted)
