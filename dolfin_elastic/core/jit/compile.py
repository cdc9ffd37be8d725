"""Compiling forms and expressions: flags, and all ranks at work."""

from __future__ import annotations

import importlib.util
import logging
import os
import signal
import sysconfig
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from threading import Timer
from time import monotonic
from typing import TypeAlias, TypedDict, TypeVar, cast
from uuid import uuid4

import dolfinx
import ffcx
import numpy as np
import ufl
from dolfinx import fem, jit
from ffcx.naming import compute_signature
from ffcx.options import FFCX_DEFAULT_OPTIONS
from mpi4py import MPI
from ufl.classes import Label
from ufl.core.expr import Expr
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.traversal import traverse_unique_terminals

from dolfin_elastic.core.jit.cache import (
    Compile,
    cache_folder,
    find,
    find_or_compile,
    private_folders,
)
from dolfin_elastic.core.native.functions import Library
from dolfin_elastic.core.parallel import agree, on_root, smallest
from dolfin_elastic.core.signals import interruptible
from dolfin_elastic.core.startup.elsewhere import without_settings
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray

log = logging.getLogger("dolfin_elastic")


class NewProcesses:
    """Processes that this one starts from now on, and what they start.

    Python ends the C compiler, a driver, when an exception interrupts the waiting for it; the
    compiler proper, a process of the driver's, would go on for minutes.
    """

    def __init__(self) -> None:
        self._before = set(_children(os.getpid()))

    def end(self) -> None:
        """Kills them."""
        new = set(_children(os.getpid())) - self._before
        for process in [*new, *(one for parent in new for one in _descendants(parent))]:
            with suppress(OSError):  # it has ended meanwhile
                os.kill(process, signal.SIGKILL)


def _children(process: int) -> list[int]:
    """Those that a process has started; none where the system does not say."""
    result: list[int] = []
    with suppress(OSError):
        for thread in Path(f"/proc/{process}/task").iterdir():
            result += map(int, (thread / "children").read_text(encoding="ascii").split())
    return result


def _descendants(process: int) -> Iterator[int]:
    for child in _children(process):
        yield child
        yield from _descendants(child)


T = TypeVar("T")
SLOW = 3.0
"""Seconds of compiling, of one form or of several, after which a line says so."""
AGAIN = 120.0
"""Seconds since that line before which no other one says so: a run compiles its forms in turn."""
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

# Both read files of options with the first call: ffcx_options.json and dolfinx_jit_options.json in
# the current folder and in the user's home, where a number such as table_atol changes the code of
# forms.  Here they find none; if somebody has called them before, all of theirs are overruled.
with without_settings():
    ffcx.get_options()
    jit.get_options()
FFCX_OPTIONS = {name: row[1] for name, row in FFCX_DEFAULT_OPTIONS.items()}
"""All of FFCx's options, with its own defaults."""
FFCX_OPTIONS["scalar_type"] = dolfinx.default_scalar_type


class JitOptions(TypedDict):
    """Options of DOLFINx's form compiler: all of them.

    Attributes:
        cffi_extra_compile_args: Flags of the C compiler.
        cffi_debug: Compile for a debugger.
        cffi_verbose: Show what the C compiler prints.
        cffi_libraries: Further libraries to link.
        timeout: Seconds for which FFCx waits for another process; no process here meets that.
        cache_dir: Folder of compiled forms.
    """

    cffi_extra_compile_args: list[str]
    cffi_debug: bool
    cffi_verbose: bool
    cffi_libraries: list[str] | None
    timeout: int
    cache_dir: Path


Compilable: TypeAlias = ufl.Form | tuple[Expr, FloatArray]
"""A form, or an expression with points."""

_private_names: dict[Path, str] = {}
"""Folder of the cache to the name of the folders in its place, the same on all ranks."""


def options(comm: MPI.Comm) -> JitOptions:
    """Options for `fem.form` and `fem.Expression`, the same on all ranks. Collective."""
    folder, name = on_root(comm, _cache_and_private_name)
    _private_names[folder] = name
    return {
        "cffi_extra_compile_args": list(FLAGS),
        "cffi_debug": False,
        "cffi_verbose": False,
        "cffi_libraries": None,
        "timeout": 600,
        "cache_dir": folder,
    }


def _cache_and_private_name() -> tuple[Path, str]:
    folder = cache_folder()
    return folder, _private_names.get(folder) or f"{os.getuid()}-{uuid4().hex}"


def compile_forms(
    comm: MPI.Comm,
    forms: Sequence[ufl.Form],
    jit_options: JitOptions,
) -> list[fem.Form]:
    """Compiles UFL forms, each on one of the ranks, and makes DOLFINx forms of them.

    Collective.

    Args:
        comm: The ranks of the forms' mesh.

    Returns:
        The forms ready to be assembled.

    Raises:
        OutputError: There is no folder for compiled forms.
        StoppedError: A signal has asked for the end of the run meanwhile.
        Exception: What the form compiler raised on any rank.
    """
    with stage("compile"):
        compiled_forms = _compiled(comm, forms, jit_options)
        return [
            on_all_ranks(comm, partial(_made_of, folder, partial(fem.form, form)))[0]
            for form, folder in zip(forms, compiled_forms, strict=True)
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

    Raises:
        Exception: What the form compiler raised on any rank.
    """
    return expression_and_module(comm, expression, points, jit_options)[0]


def expression_and_module(
    comm: MPI.Comm,
    expression: Expr,
    points: FloatArray,
    jit_options: JitOptions,
) -> tuple[fem.Expression, Library]:
    """See `compile_expression`; and the module that it is in. Collective."""
    expression = _with_numbered_labels(expression)
    coordinates = np.reshape(points, (-1, np.shape(points)[-1]))
    with stage("compile"):
        folder = _compiled(comm, [(expression, coordinates)], jit_options)[0]
        make = partial(fem.Expression, expression, points)
        return on_all_ranks(comm, partial(_made_of, folder, make))


def _with_numbered_labels(expression: Expr) -> Expr:
    """The expression with the labels of its variables (`ufl.variable`) counted from zero.

    FFCx names a compiled expression by its content, and a label by the number of variables that the
    process had made before: without this, the same expression has another name in each problem of a
    process and is compiled again.  (In forms UFL counts the labels anew by itself.)
    """
    result = {node for node in traverse_unique_terminals(expression) if isinstance(node, Label)}
    labels = {old: Label(i) for i, old in enumerate(sorted(result, key=Label.count))}

    def numbered(node: Expr, *operands: Expr) -> Expr:
        if isinstance(node, Label):
            return labels[node]
        kept = all(a is b for a, b in zip(operands, node.ufl_operands, strict=True))
        return node if kept else node._ufl_expr_reconstruct_(*operands)

    # A class of UFL's for this looks at 200 signatures when it is first made: 5 ms.
    return map_expr_dag(numbered, expression) if labels else expression


def _compiled(comm: MPI.Comm, objects: Sequence[Compilable], jit_options: JitOptions) -> list[Path]:
    """The folder of the code of each of several forms. Collective."""

    def names() -> list[tuple[str, Compile]]:
        with interruptible():  # UFL takes as long as FFCx where expressions are large
            return [_named(one, jit_options) for one in objects]

    named = on_all_ranks(comm, names)
    wanted = dict(named)  # equal forms once
    folders = dict(zip(wanted, find_on_all_ranks(comm, roots(jit_options), wanted), strict=True))
    return [folders[key] for key, _ in named]


def roots(jit_options: JitOptions) -> list[Path]:
    """The cache, and folders in its place where it cannot be written."""
    root = jit_options["cache_dir"]
    return [root, *private_folders(_private_names[root])]


def find_on_all_ranks(
    comm: MPI.Comm, folders: Sequence[Path], wanted: Mapping[str, Compile]
) -> list[Path]:
    """Folder of each of several compiled forms, see `find_or_compile`. Collective.

    Where any rank misses one, each compiles its share; DOLFINx would compile all on rank 0.  Then
    each looks for itself: ranks on other machines may have folders of their own.

    Args:
        folders: From `roots`.
        wanted: Name of each form, by all that its code depends on, to what compiles it.
    """
    before = [folder for key in wanted if (folder := find(folders, key))]
    if smallest(comm, len(before)) == len(wanted):
        return before
    every = list(wanted.items())
    local = every[comm.rank :: comm.size]
    with _silence.broken_after(SLOW):
        for share in [local, every] if comm.size > 1 else [every]:
            result: list[Path] = []
            error: Exception | None = None
            try:
                with interruptible(NewProcesses().end):
                    result = [find_or_compile(folders, key, compile_) for key, compile_ in share]
            except Exception as caught:  # raised on all ranks just below
                error = caught
            agree(comm, error)
    return result


def _named(form: Compilable, jit_options: JitOptions) -> tuple[str, Compile]:
    """Name of a form, or of an expression with its points, and what compiles it."""
    # All that FFCx makes the name of a module from: its options, the flags, Python and the C
    # compiler's own settings.
    flags = [jit_options["cffi_extra_compile_args"], jit_options["cffi_debug"]]
    python = [sysconfig.get_config_var(name) for name in ("CFLAGS", "SOABI")]
    tag = "".join(map(str, [sorted(ffcx.get_options(FFCX_OPTIONS).items()), *flags, *python]))

    def compile_into(folder: Path) -> None:
        with _root_log_kept():
            jit.ffcx_jit(
                MPI.COMM_SELF,
                form,
                jit_options={**jit_options, "cache_dir": folder},
                form_compiler_options=FFCX_OPTIONS,
            )

    return compute_signature([form], tag), compile_into


class _Silence:
    """How long forms have been compiled, one after the other, since a line has last said so."""

    def __init__(self) -> None:
        self._seconds, self._since, self._told = 0.0, 0.0, -AGAIN

    def _break(self) -> None:
        self._since = monotonic()
        if self._since - self._told >= AGAIN:
            self._told = self._since
            log.info("compiling ... (only in the first run)")

    @contextmanager
    def broken_after(self, seconds: float) -> Iterator[None]:
        """A line says what is waited for, be it FFCx, gcc or another rank.

        Args:
            seconds: Of silence, those of the forms before among them.
        """
        self._since = monotonic() - self._seconds
        timer = Timer(max(seconds - self._seconds, 0.0), self._break)
        timer.daemon = True  # it keeps no run from its end
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            self._seconds = monotonic() - self._since


_silence = _Silence()


@contextmanager
def _given(library: Library) -> Iterator[None]:
    """Lets DOLFINx take a form from a library, and each rank for itself.

    It would let the others wait until rank 0 has compiled the form, which has been done here, and
    look for it by its name, which FFCx would make three times: 3 ms.
    """
    compiling = jit.ffcx_jit
    name = next(name for name in dir(library.lib) if name.startswith(("form_", "expression_")))
    function = (getattr(library.lib, name), library, (None, None))
    jit.ffcx_jit = lambda *_, **__: function
    try:
        yield
    finally:
        jit.ffcx_jit = compiling


def load_library(folder: Path) -> Library:
    """The module that cffi has compiled into a folder, whose name is its file's. Not collective."""
    file = next(folder.glob("*.so"))
    name = file.name.partition(".")[0]
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return cast("Library", module)


@contextmanager
def _root_log_kept() -> Iterator[None]:
    """FFCx exchanges the handlers of the root logger, and leaves them so after an error."""
    root = logging.getLogger()
    before = root.handlers
    try:
        yield
    finally:
        root.handlers = before


def on_all_ranks(comm: MPI.Comm, make: Callable[[], T]) -> T:
    """Calls a function on every rank, which is not collective; all raise the error of any.

    Collective.
    """
    error: Exception | None = None
    made: T | None = None
    try:
        made = make()
    except Exception as caught:  # raised on all ranks just below
        error = caught
    agree(comm, error)
    return cast("T", made)


def _made_of(folder: Path, make: Callable[[], T]) -> tuple[T, Library]:
    """A compiled object of DOLFINx, made of what `jit.ffcx_jit` returns, and its library. Local."""
    library = load_library(folder)
    with _given(library):
        return make(), library
