"""Loops in C whose sizes the compiler knows, kept in the cache of compiled forms."""

from __future__ import annotations

import hashlib
import sysconfig
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import cffi
from mpi4py import MPI

from dolfin_elastic.core.jit.compile import (
    JitOptions,
    find_on_all_ranks,
    load_library,
    on_all_ranks,
    roots,
)
from dolfin_elastic.core.native.functions import CFunctions, declarations, prototypes, read
from dolfin_elastic.core.timing import stage

NAME = "dolfin_elastic_loops"


class Code(NamedTuple):
    """Code in C that is made where it is not yet compiled.

    Attributes:
        key: All that it depends on, the same on all ranks.
        make: Makes it.
    """

    key: str
    make: Callable[[], str]


def compile_c(
    comm: MPI.Comm,
    file: str,
    sizes: Mapping[str, int],
    jit_options: JitOptions,
    *,
    kernel: Code | None = None,
) -> CFunctions:
    """Compiles the functions of a file in `core.native`, or takes them from the cache. Collective.

    Args:
        sizes: Macros that it uses, by name.
        kernel: The header "kernel.h", where it includes one.

    Raises:
        OutputError: There is no folder for compiled code.
        StoppedError: A signal has asked for the end of the run meanwhile.
    """
    macros = "".join(f"#define {name} {size}\n" for name, size in sizes.items())

    def text(of_kernel: str | None = None) -> str:
        return macros + read(file, {} if of_kernel is None else {"kernel.h": of_kernel})

    keyed = text(kernel and kernel.key)
    functions = prototypes(keyed)
    # Products and sums may be fused; in forms FFCx decides, and gcc fuses by default, too.
    # Vectors are handed on by functions that are all inlined: no ABI is concerned.
    flags = [*jit_options["cffi_extra_compile_args"], "-ffp-contract=fast", "-Wno-psabi"]
    soabi = str(sysconfig.get_config_var("SOABI"))
    whole = "\n".join([keyed, *flags, cffi.__version__, soabi])
    key = "loops_" + hashlib.sha256(whole.encode()).hexdigest()

    def compile_into(folder: Path) -> None:
        ffi = cffi.FFI()
        ffi.cdef(declarations(functions))
        ffi.set_source(NAME, text(kernel and kernel.make()), extra_compile_args=flags)
        ffi.compile(tmpdir=str(folder))

    with stage("compile"):
        folder = find_on_all_ranks(comm, roots(jit_options), {key: compile_into})[0]
        return CFunctions(on_all_ranks(comm, lambda: load_library(folder)), functions)
