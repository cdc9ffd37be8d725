"""Versions, libraries and processors: what a result may depend on."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI

import dolfinx.cpp
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core import __version__
from dolfin_elastic.core.jit import cache_folder

_FAST = ("openblas", "mkl", "blis", "atlas", "accelerate")


def describe() -> tuple[dict[str, str], list[str]]:
    """Name to value, and advice where the installation is slow."""
    blas, advice = _blas()
    threads = os.environ.get("OMP_NUM_THREADS", "")
    if threads != "1" and MPI.COMM_WORLD.size > 1:
        advice.append("set OMP_NUM_THREADS=1, so that ranks do not compete for cores")
    versions = {
        "dolfin-elastic": __version__,
        "dolfinx": dolfinx.cpp.__version__,
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "mpi": MPI.Get_library_version().split(",")[0].strip(),
        "ranks": str(MPI.COMM_WORLD.size),
        "cores": str(len(os.sched_getaffinity(0))),
        "threads": threads or "not set (OMP_NUM_THREADS)",
        "blas": blas,
        "mumps": "yes" if PETSc.Sys.hasExternalPackage("mumps") else "no",
        "compiled code": str(cache_folder()),
    }
    return versions, advice


def _blas() -> tuple[str, list[str]]:
    """The BLAS library loaded by this process, by its file, and advice if it is slow."""
    try:
        maps = Path("/proc/self/maps").read_text(encoding="utf-8")
    except OSError:
        return "unknown", []
    files = {line.split()[-1] for line in maps.splitlines() if "/" in line}
    libraries = sorted(f for f in files if any(k in f.lower() for k in (*_FAST, "libblas")))
    fast = [f for f in libraries if any(name in f.lower() for name in _FAST)]
    if fast or not libraries:
        return (fast or ["unknown"])[0], []
    return libraries[0], [
        "this is the reference BLAS: direct solves take several times as long; "
        "install OpenBLAS (Debian: libopenblas0-pthread)"
    ]
