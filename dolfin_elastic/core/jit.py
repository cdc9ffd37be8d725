"""Compiling forms: flags, a cache that is safe to share, all ranks at work."""

from __future__ import annotations

import fcntl
import hashlib
import os
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import IO, TypedDict, TypeVar, cast

import dolfinx
import numpy as np
import ufl
from dolfinx import fem, jit
from mpi4py import MPI
from ufl.classes import Label
from ufl.core.expr import Expr
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction
from ufl.corealg.traversal import traverse_unique_terminals

from dolfin_elastic.core.parallel import agree, on_root
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray

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


class JitOptions(TypedDict):
    """Options of DOLFINx's form compiler.

    Attributes:
        cffi_extra_compile_args: Flags of the C compiler.
        timeout: Seconds to wait for another process that compiles the same form.
        cache_dir: Folder of compiled forms.
    """

    cffi_extra_compile_args: list[str]
    timeout: int
    cache_dir: Path


def cache_folder() -> Path:
    """Folder of compiled forms, one for each kind of processor.

    Forms are compiled with -march=native: in a home directory shared by unlike machines, none may
    load the code of another.
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


def options(comm: MPI.Comm) -> JitOptions:
    """Options for `fem.form` and `fem.Expression`, the same on all ranks. Collective."""
    folder = on_root(comm, cache_folder)
    return {"cffi_extra_compile_args": list(FLAGS), "timeout": 600, "cache_dir": folder}


@contextmanager
def _locked_cache(folder: Path) -> Iterator[None]:
    """Exclusive use of one part of the cache, for compiling into it.  Not collective.

    A killed compilation leaves a C file, and every later run would wait for its end.  Whoever holds
    the lock knows that nobody compiles there and removes such files.  The cache has several parts,
    so that runs that compile different forms rarely wait for each other.
    """
    lock = _lock(folder)
    try:
        yield
    finally:
        if lock is not None:
            lock.close()


def _cache_part(jit_options: JitOptions, key: str) -> JitOptions:
    """The options with the part of the cache for a form, by the first letter of its hash."""
    return {**jit_options, "cache_dir": jit_options["cache_dir"] / key[0]}


def _lock(folder: Path) -> IO[str] | None:
    """Acquires the lock of a part of the cache and removes files of killed compilations.

    None on file systems without locks.
    """
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
    jit_options: JitOptions,
) -> list[fem.Form]:
    """Compiles UFL forms, each on one of the ranks, and makes DOLFINx forms of them.

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
    parts = [_cache_part(jit_options, form.signature()) for form in forms]
    with stage("compile"):
        if comm.size > 1:
            _compile_shares(comm, forms, parts)
        return [
            _on_all_ranks(comm, part, lambda f=form, p=part: fem.form(f, jit_options=p))  # type: ignore[misc]
            for form, part in zip(forms, parts, strict=True)
        ]


def compile_expression(
    comm: MPI.Comm,
    expression: Expr,
    points: FloatArray,
    jit_options: JitOptions,
) -> fem.Expression:
    """Compiles a UFL expression at points of the reference cell. Collective.

    Args:
        comm: The ranks of the expression's mesh.
        expression: UFL expression of any shape.
        points: Points of the reference cell, shape (n, dim).
        jit_options: From `options`.

    Raises:
        Exception: What the form compiler raised on any rank.
    """
    expression = _with_numbered_labels(expression)
    key = f"{expression.ufl_shape}{np.asarray(points).round(9).tolist()}"
    part = _cache_part(jit_options, hashlib.sha256(key.encode()).hexdigest())
    with stage("compile"):
        return _on_all_ranks(
            comm, part, lambda: fem.Expression(expression, points, jit_options=part)
        )


class _Relabelling(MultiFunction):
    """Exchanges the labels of variables."""

    expr = MultiFunction.reuse_if_untouched

    def __init__(self, labels: dict[Label, Label]) -> None:
        super().__init__()
        self._labels = labels

    def label(self, label: Label) -> Label:
        """The other label."""
        return self._labels[label]


def _with_numbered_labels(expression: Expr) -> Expr:
    """The expression with the labels of its variables (`ufl.variable`) counted from zero.

    FFCx names a compiled expression by its content, and a label by the number of variables that the
    process had made before: without this, the same expression has another name in each problem of a
    process and is compiled again.  (In forms UFL counts the labels anew by itself.)
    """
    found = {node for node in traverse_unique_terminals(expression) if isinstance(node, Label)}
    labels = {old: Label(i) for i, old in enumerate(sorted(found, key=Label.count))}
    return map_expr_dag(_Relabelling(labels), expression) if labels else expression


def _on_all_ranks(comm: MPI.Comm, part: JitOptions, make: Callable[[], T]) -> T:
    """Calls a function on every rank; an error of any rank is raised on all. Collective."""
    error: Exception | None = None
    made: T | None = None
    # Rank 0 compiles what is not in the cache; the others wait for it inside DOLFINx.
    with _locked_cache(part["cache_dir"]) if comm.rank == 0 else nullcontext():
        try:
            made = make()
        except Exception as caught:  # raised on all ranks just below
            error = caught
        agree(comm, error)
    return cast("T", made)


def _compile_shares(comm: MPI.Comm, forms: Sequence[ufl.Form], parts: Sequence[JitOptions]) -> None:
    """Compiles this rank's share of forms into the cache; DOLFINx would compile all on rank 0.

    Collective.
    """
    error: Exception | None = None
    mine = slice(comm.rank, None, comm.size)
    try:
        for form, part in zip(forms[mine], parts[mine], strict=True):
            with _locked_cache(part["cache_dir"]):
                jit.ffcx_jit(
                    MPI.COMM_SELF,
                    form,
                    jit_options=part,
                    form_compiler_options={"scalar_type": dolfinx.default_scalar_type},
                )
    except Exception as caught:  # raised on all ranks just below
        error = caught
    agree(comm, error)
