"""C functions of the files of this folder, called with numpy arrays that are checked.

A file is handed to the compiler with the headers it includes put in.  So the text is what compiled
code depends on, and needs no folder where headers are found.  Functions that Python calls are those
that return an int64_t and are not static.  The prototypes in front of their bodies are the only
ones; they name the length of each array, which is checked with its type at each call.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.resources import files
from typing import NamedTuple, Protocol, TypeAlias, cast

import cffi
import numpy as np

from dolfin_elastic.core.types import AnyArray

_OWN_HEADER = re.compile(r'#include "([\w.]+)"')
_PROTOTYPE = re.compile(r"^int64_t (\w+)\(([^;{]*)\)\n\{", re.M)
_PARAMETER = re.compile(r"(?P<kind>(const )?\w+) (?P<name>\w+)(\[(?P<length>.+)\])?", re.S)
_WORD = re.compile(r"[A-Za-z_]\w*")


def read(name: str, generated: Mapping[str, str] | None = None) -> str:
    """The text of a file, with each of our headers where it is first included.

    Args:
        name: Of the file.
        generated: Headers that are in no file, by name.
    """
    return "".join(_lines(name, generated or {}, set()))


def _lines(name: str, generated: Mapping[str, str], seen: set[str]) -> Iterator[str]:
    seen.add(name)
    text = generated[name] if name in generated else written(name)
    for line in text.splitlines(keepends=True):
        if not (own := _OWN_HEADER.match(line)):
            yield line
        elif own.group(1) not in seen:
            yield from _lines(own.group(1), generated, seen)


def written(name: str) -> str:
    """What stands in a file."""
    return files("dolfin_elastic.core.native").joinpath(name).read_text(encoding="utf-8")


class Parameter(NamedTuple):
    """What a function takes.

    Attributes:
        name: In its prototype.
        kind: Type of the number, or of the entries of an array.
        length: Of the array at least, an expression in C of integers and arrays before it, and of
            macros; None: a number.
    """

    name: str
    kind: str
    length: str | None


def prototypes(text: str) -> dict[str, list[Parameter]]:
    """Parameters of the functions that Python calls, by name.

    Args:
        text: From `read`.

    Raises:
        ValueError: An array has no length.
    """
    result: dict[str, list[Parameter]] = {}
    for name, listed in _PROTOTYPE.findall(text):
        result[name] = []
        for one in listed.split(",") if listed != "void" else []:
            if not (parsed := _PARAMETER.fullmatch(one.strip())):
                raise ValueError(f"{name}: {one.strip()} is neither a number nor an array[length]")
            result[name].append(Parameter(parsed["name"], parsed["kind"], parsed["length"]))
    return result


def declarations(functions: Mapping[str, Sequence[Parameter]]) -> str:
    """The same for cffi, which knows no lengths, and the macros that they are made of.

    Args:
        functions: From `prototypes`.
    """
    lines, macros = [], set()
    for name, parameters in functions.items():
        listed = [p.kind + (" " if p.length is None else "* ") + p.name for p in parameters]
        lines.append(f"int64_t {name}({', '.join(listed) or 'void'});\n")
        used = {word for p in parameters for word in _WORD.findall(p.length or "")}
        macros |= used - {p.name for p in parameters}
    return "".join([*(f"#define {name} ...\n" for name in sorted(macros)), *lines])


Arguments: TypeAlias = Sequence[int | AnyArray]
Length: TypeAlias = Callable[[Arguments], int]

_OPERATORS: dict[type[ast.operator], Callable[[int, int], int]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.floordiv,  # of integers, none of which is negative
}


def length_of(expression: str, names: Sequence[str], macros: Mapping[str, int]) -> Length:
    """What an expression in C gives for the arguments of a call.

    Args:
        expression: Of integers, their names, entries of arrays, + - * / and brackets.

    Raises:
        ValueError: There is something else in it.
    """
    return _compiled(ast.parse(" ".join(expression.split()), mode="eval").body, names, macros)


def _compiled(node: ast.expr, names: Sequence[str], macros: Mapping[str, int]) -> Length:
    match node:
        case ast.Constant(value=int(value)):
            return lambda _: value
        case ast.Name(id=name) if name in names:
            return operator.itemgetter(names.index(name))
        case ast.Name(id=name) if name in macros:
            number = macros[name]
            return lambda _: number
        case ast.Subscript(value=ast.Name(id=name), slice=index) if name in names:
            return _entry(names.index(name), _compiled(index, names, macros))
        case ast.BinOp(left=left, op=sign, right=right) if type(sign) in _OPERATORS:
            apply = _OPERATORS[type(sign)]
            one, two = _compiled(left, names, macros), _compiled(right, names, macros)
            if not any(_depends(side, names) for side in (left, right)):
                known = apply(one(()), two(()))
                return lambda _: known
            return lambda arguments: apply(one(arguments), two(arguments))
    raise ValueError(f"{ast.unparse(node)} is no length")


def _entry(array: int, index: Length) -> Length:
    """An entry of an argument, as int."""
    return lambda arguments: int(arguments[array][index(arguments)])  # type: ignore[index]


def _depends(node: ast.expr, names: Sequence[str]) -> bool:
    return any(isinstance(one, ast.Name) and one.id in names for one in ast.walk(node))


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
