"""What all tests share.

`pytest` alone runs the quick set, `pytest --all` everything (suite/selection.py): on one rank,
spread over the cores, and again under `mpirun -n 2` and `-n 3` (suite/ranks.py).
"""

from __future__ import annotations

import gc
import logging
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMPI_ALLOW_RUN_AS_ROOT", "1")
os.environ.setdefault("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")

from mpi4py import MPI

from dolfin_elastic import Problem
from dolfin_elastic.results.scene.renderer import RENDERER

pytest_plugins = ["suite.selection", "suite.ranks", "suite.cost"]
pytest.register_assert_rewrite("helpers")

_ENDED = pytest.StashKey[int]()
"""Tests that have ended in this session."""

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def comm() -> MPI.Comm:
    return MPI.COMM_WORLD


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh folder that all ranks share."""
    return shared_folder(tmp_path_factory)


@pytest.fixture(scope="module")
def folder_of_module(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for what all tests of a file read, on all ranks."""
    return shared_folder(tmp_path_factory)


def shared_folder(paths: pytest.TempPathFactory) -> Path:
    """A fresh folder that all ranks share. Collective."""
    comm = MPI.COMM_WORLD
    return Path(comm.bcast(tempfile.mkdtemp(dir=paths.getbasetemp()) if comm.rank == 0 else ""))


def pytest_collection_finish() -> None:
    """Several ranks free what Python finds in cycles, PETSc's objects too, together only."""
    if MPI.COMM_WORLD.size > 1:
        gc.disable()


@pytest.fixture(autouse=True)
def _together(request: pytest.FixtureRequest):
    """PETSc objects are freed together, and no rank runs ahead into the next test."""
    yield
    if MPI.COMM_WORLD.size > 1:
        # All that is alive takes 0.2 s to look through, what the test made next to nothing.
        request.config.stash[_ENDED] = ended = request.config.stash.get(_ENDED, 0) + 1
        gc.collect(0 if ended % 50 else 2)
        MPI.COMM_WORLD.barrier()


@pytest.fixture(autouse=True, scope="session")
def _one_renderer() -> Iterator[None]:
    """One process draws the pictures of all tests: its start takes 2 s, a picture 0.2 s."""
    RENDERER.hold(pytest)
    yield
    RENDERER.release(pytest)


@pytest.fixture
def own_renderer(_one_renderer: None) -> Iterator[None]:
    """For tests of the start and the end of that process, and of what it needs: none is running."""
    RENDERER.release(pytest)
    yield
    RENDERER.hold(pytest)


@pytest.fixture(autouse=True)
def _own_log():
    """What a command line run in this process does to log and garbage collection is undone.

    A command looks for garbage from its start on; ranks that go on with it free what is collective
    at times of their own.
    """
    log = logging.getLogger("dolfin_elastic")
    before = log.handlers[:], log.level, log.propagate
    collects = gc.isenabled()
    yield
    (gc.enable if collects else gc.disable)()
    gc.unfreeze()
    log.handlers[:], log.propagate = before[0], before[2]
    log.setLevel(before[1])


@pytest.fixture
def serial_only(comm: MPI.Comm) -> None:
    """For tests that start processes of their own."""
    if comm.size > 1:
        pytest.skip("starts its own processes: runs in the serial session")


def displacement_at(problem: Problem, place: tuple[float, ...]) -> np.ndarray:
    """Displacement of the node at a place, on every rank."""
    dim, x = problem.body.dim, problem.V.tabulate_dof_coordinates()
    u = problem.u.x.array.reshape(-1, dim)
    near = np.flatnonzero(np.linalg.norm(x[:, :dim] - np.array(place), axis=1) < 1e-9)
    found = u[near[0]] if len(near) else None
    return next(value for value in problem.body.comm.allgather(found) if value is not None)
