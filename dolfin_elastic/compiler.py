"""Compiling forms: flags, a cache that is safe to share, all ranks at work."""

from __future__ import annotations

import fcntl
import hashlib
import os
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, TypeVar, cast

import dolfinx
import ufl
from dolfinx import fem, jit
from mpi4py import MPI

from dolfin_elastic.parallel import agree, on_root
from dolfin_elastic.timing import stage

T = TypeVar("T")
# No -ffast-math: it would hide the NaN and Inf by which an inverted element is seen.
# Without the second scheduling pass: on the long straight-line code of a tangent at one point gcc
# takes minutes for it (130 s against 0.4 s for a neo-Hookean solid), and the code is no faster.
FLAGS = (
    "-O3",
    "-march=native",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-schedule-insns2",
    "-g0",
)


def cache_folder() -> Path:
    """Where compiled forms are kept: one folder a kind of processor.

    Forms are compiled for the processor at hand, so a home shared by unlike machines must not
    hand one's code to the other.
    """
    root = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(root) / "dolfin_elastic" / "forms" / _processor()


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.machine()
    flags = next((line for line in text.splitlines() if line.startswith(("flags", "Features"))), "")
    return f"{platform.machine()}-{hashlib.sha256(flags.encode()).hexdigest()[:10]}"


def options(comm: MPI.Comm) -> dict[str, Any]:
    """Options for `fem.form` and `fem.Expression`, the same on all ranks. Collective."""
    folder = on_root(comm, lambda: str(cache_folder()))
    return {"cffi_extra_compile_args": list(FLAGS), "timeout": 600, "cache_dir": folder}


@contextmanager
def compiling(comm: MPI.Comm, jit_options: dict[str, Any]) -> Iterator[None]:
    """Everything that may compile happens inside: one run at a time works on a cache.

    Collective.  A compilation that was killed leaves a C file that makes every later run wait for
    its end in vain; while no other run compiles, such files are known to be dead and are removed.
    """
    with stage("compile"):
        lock = _lock(Path(jit_options["cache_dir"])) if comm.rank == 0 else None
        comm.barrier()
        try:
            yield
        finally:
            if lock is not None:
                lock.close()


def _lock(folder: Path) -> IO[str] | None:
    """Waits for the cache's lock and clears what killed compilations left; None without locks."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / "lock").open("w")
        fcntl.flock(lock, fcntl.LOCK_EX)
        for source in folder.glob("*.c"):
            if not source.with_suffix(".c.cached").exists():
                source.unlink(missing_ok=True)
    except OSError:  # a file system without locks: as safe as DOLFINx itself
        return None
    return lock


def compile_forms(
    comm: MPI.Comm,
    forms: Sequence[ufl.Form],
    jit_options: dict[str, Any],
) -> list[fem.Form]:
    """Compiles UFL forms, shared out among the ranks, and makes DOLFINx forms of them.

    Collective.

    Args:
        comm: The ranks of the forms' mesh.
        forms: UFL forms.
        jit_options: From `options`.

    Returns:
        The forms ready to be assembled.

    Raises:
        Exception: What the form compiler raised on any rank.
    """
    with compiling(comm, jit_options):
        if comm.size > 1:
            _share_out(comm, forms, jit_options)
        return [
            _together(comm, lambda form=form: fem.form(form, jit_options=jit_options))  # type: ignore[misc]
            for form in forms
        ]


def compile_expression(
    comm: MPI.Comm,
    expression: Any,
    points: Any,
    jit_options: dict[str, Any],
) -> fem.Expression:
    """Compiles a UFL expression at reference points of a cell. Collective."""
    with compiling(comm, jit_options):
        return _together(comm, lambda: fem.Expression(expression, points, jit_options=jit_options))


def _together(comm: MPI.Comm, make: Callable[[], T]) -> T:
    """What every rank makes, or the error that one of them met, for example in the cache."""
    error: Exception | None = None
    made: T | None = None
    try:
        made = make()
    except Exception as caught:  # told to all ranks just below
        error = caught
    agree(comm, error)
    return cast("T", made)


def _share_out(comm: MPI.Comm, forms: Sequence[ufl.Form], jit_options: dict[str, Any]) -> None:
    """Each rank compiles its share into the cache; DOLFINx would let rank 0 do it all."""
    error: Exception | None = None
    try:
        for form in forms[comm.rank :: comm.size]:
            jit.ffcx_jit(
                MPI.COMM_SELF,
                form,
                jit_options=jit_options,
                form_compiler_options={"scalar_type": dolfinx.default_scalar_type},
            )
    except Exception as caught:  # told to all ranks just below
        error = caught
    agree(comm, error)
