"""Loops in C whose sizes the compiler knows, kept in the cache of compiled forms."""

from __future__ import annotations

import hashlib
import sysconfig
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple, Protocol, TypeAlias, cast

import cffi
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dolfin_elastic.core.jit.compile import (
    JitOptions,
    Library,
    find_on_all_ranks,
    load_library,
    on_all_ranks,
    roots,
)
from dolfin_elastic.core.timing import stage

Array: TypeAlias = NDArray[np.generic]

NAME = "dolfin_elastic_loops"


class _Function(Protocol):
    """A function in C."""

    def __call__(self, *arguments: int | cffi.FFI.CData) -> int: ...


class _Parameter(NamedTuple):
    """An array that a function in C takes.

    Attributes:
        dtype: Of its entries.
        kind: The same for cffi.
    """

    dtype: np.dtype[np.generic]
    kind: cffi.FFI.CType


class Code(NamedTuple):
    """Code in C that is made where it is not yet compiled.

    Attributes:
        key: All that it depends on, the same on all ranks.
        make: Makes it.
    """

    key: str
    make: Callable[[], str]


class CFunctions:
    """Compiled C functions, whose arguments are integers and contiguous numpy arrays.

    Args:
        library: As cffi compiled it.
    """

    def __init__(self, library: Library) -> None:
        self._lib, self._ffi = library.lib, library.ffi
        self._known: dict[str, tuple[_Function, list[_Parameter | None]]] = {}

    def call(self, name: str, *arguments: int | Array) -> int:
        """Calls a function; arrays are handed on as pointers. Not collective.

        Args:
            name: Of the function; it returns an integer.
            arguments: Integers, and arrays of the types in its declaration.

        Raises:
            TypeError: An array has another type, or gaps.
        """
        if name not in self._known:
            self._known[name] = self._declared(name)
        function, parameters = self._known[name]
        pairs = zip(arguments, parameters, strict=True)
        return function(*[self._pointer(a, p) if p is not None else a for a, p in pairs])

    def _declared(self, name: str) -> tuple[_Function, list[_Parameter | None]]:
        """A function and its parameters; None: no array."""
        function = getattr(self._lib, name)
        parameters: list[_Parameter | None] = []
        for kind in self._ffi.typeof(function).args:
            if kind.kind != "pointer":
                parameters.append(None)
                continue
            cname = kind.item.cname.removeprefix("const ")
            bare = cname.removesuffix("_t")
            dtype = np.dtype("float32" if bare == "float" else bare)
            parameters.append(_Parameter(dtype, self._ffi.typeof(f"{cname}[]")))
        return cast("_Function", function), parameters

    def _pointer(self, values: int | Array, parameter: _Parameter) -> cffi.FFI.CData:
        if not isinstance(values, np.ndarray):
            raise TypeError(f"{values!r} is no array of {parameter.dtype}")
        if values.dtype != parameter.dtype:
            raise TypeError(f"an array of {values.dtype} is none of {parameter.dtype}")
        if not values.flags.c_contiguous:
            raise TypeError("the entries of an array do not stand in a row")
        return self._ffi.from_buffer(parameter.kind, values)


def compile_c(
    comm: MPI.Comm,
    declarations: str,
    source: str | Code,
    sizes: Mapping[str, int],
    jit_options: JitOptions,
) -> CFunctions:
    """Compiles C functions, or takes them from the cache. Collective.

    Args:
        comm: The ranks.
        declarations: Of the functions, for cffi.
        source: In C, the same on all ranks.
        sizes: Macros that the source uses, by name.
        jit_options: From `options`.

    Raises:
        OutputError: There is no folder for compiled code.
        StoppedError: A signal has asked for the end of the run meanwhile.
    """
    macros = "".join(f"#define {name} {size}\n" for name, size in sizes.items())
    plain = source
    source = Code(plain, lambda: plain) if isinstance(plain, str) else plain
    # Products and sums may be fused; in forms FFCx decides, and gcc fuses by default, too.
    # Vectors are handed on by functions that are all inlined: no ABI is concerned.
    flags = [*jit_options["cffi_extra_compile_args"], "-ffp-contract=fast", "-Wno-psabi"]
    soabi = str(sysconfig.get_config_var("SOABI"))
    text = "\n".join([declarations, macros + source.key, *flags, cffi.__version__, soabi])
    key = "loops_" + hashlib.sha256(text.encode()).hexdigest()

    def compile_into(folder: Path) -> None:
        ffi = cffi.FFI()
        ffi.cdef(declarations)
        ffi.set_source(NAME, macros + source.make(), extra_compile_args=flags)
        ffi.compile(tmpdir=str(folder))

    with stage("compile"):
        folder = find_on_all_ranks(comm, roots(jit_options), {key: compile_into})[0]
        return CFunctions(on_all_ranks(comm, lambda: load_library(folder)))
