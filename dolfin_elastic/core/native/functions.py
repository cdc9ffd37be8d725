"""Compiled C functions, called with numpy arrays whose types and lengths are checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, cast

import cffi
import numpy as np

from dolfin_elastic.core.native.lengths import Length, length_of
from dolfin_elastic.core.native.source import Parameter
from dolfin_elastic.core.types import AnyArray


class Library(Protocol):
    """A module that cffi has compiled."""

    lib: object
    ffi: cffi.FFI
    __file__: str


class _Function(Protocol):
    """A function in C."""

    def __call__(self, *arguments: int | cffi.FFI.CData) -> int: ...


class _Array(NamedTuple):
    """An array that a function in C takes.

    Attributes:
        name: In the prototype.
        dtype: Of its entries.
        kind: The same for cffi.
        length: Of a call.
    """

    name: str
    dtype: np.dtype[np.generic]
    kind: cffi.FFI.CType
    length: Length


class CFunctions:
    """Compiled C functions, whose arguments are integers and contiguous numpy arrays.

    Args:
        library: As cffi compiled it.
        functions: From `prototypes`.
    """

    def __init__(self, library: Library, functions: Mapping[str, Sequence[Parameter]]) -> None:
        self._lib, self._ffi, self._functions = library.lib, library.ffi, functions
        every = {name: getattr(library.lib, name) for name in dir(library.lib)}
        self._macros = {name: value for name, value in every.items() if isinstance(value, int)}
        self._known: dict[str, tuple[_Function, list[_Array | None]]] = {}

    def call(self, name: str, *arguments: int | AnyArray) -> int:
        """Calls a function; arrays are handed on as pointers. Not collective.

        Args:
            name: Of the function; it returns an integer.
            arguments: Integers, and arrays of the types and at least the lengths of its prototype.

        Raises:
            TypeError: An array has another type, or gaps.
            ValueError: An array is too short.
        """
        if name not in self._known:
            self._known[name] = self._declared(name)
        function, parameters = self._known[name]
        pairs = zip(arguments, parameters, strict=True)
        return function(*[a if p is None else self._pointer(a, p, arguments) for a, p in pairs])

    def _declared(self, name: str) -> tuple[_Function, list[_Array | None]]:
        """A function and its parameters; None: no array."""
        names = [one.name for one in self._functions[name]]
        parameters: list[_Array | None] = []
        for one in self._functions[name]:
            if one.length is None:
                parameters.append(None)
                continue
            kind = one.kind.removeprefix("const ")
            bare = kind.removesuffix("_t")
            dtype = np.dtype("float32" if bare == "float" else bare)
            length = length_of(one.length, names[: len(parameters)], self._macros)
            parameters.append(_Array(one.name, dtype, self._ffi.typeof(f"{kind}[]"), length))
        return cast("_Function", getattr(self._lib, name)), parameters

    def _pointer(
        self, values: int | AnyArray, array: _Array, arguments: Sequence[int | AnyArray]
    ) -> cffi.FFI.CData:
        if not isinstance(values, np.ndarray):
            raise TypeError(f"{array.name}: {values!r} is no array of {array.dtype}")
        if values.dtype != array.dtype:
            raise TypeError(f"{array.name}: an array of {values.dtype} is none of {array.dtype}")
        if not values.flags.c_contiguous:
            raise TypeError(f"{array.name}: the entries of an array do not stand in a row")
        if values.size < (least := array.length(arguments)):
            raise ValueError(f"{array.name}: an array of {values.size} entries, not of {least}")
        return self._ffi.from_buffer(array.kind, values)
