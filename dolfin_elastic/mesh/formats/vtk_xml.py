"""VTK's XML files in every encoding: text, base64, raw; compressed.

Read here rather than through meshio 5.3, which refuses files of VTK 9.1 and newer (version 2),
mistakes bytes of raw appended data for the end of the data, needs every appended array to be
followed by another one that it knows, and believes the sizes that a damaged file states.
Source: https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

import base64
import binascii
import lzma
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files.xml import parsed
from dolfin_elastic.core.types import AnyArray

TYPES = {
    "Float32": "f4",
    "Float64": "f8",
    "Int8": "i1",
    "Int16": "i2",
    "Int32": "i4",
    "Int64": "i8",
    "UInt8": "u1",
    "UInt16": "u2",
    "UInt32": "u4",
    "UInt64": "u8",
}


@dataclass(frozen=True)
class _Source:
    """Bytes that arrays are decoded from: `take(start, count)` gives them, or fewer at the end."""

    take: Callable[[int, int], bytes]
    size: int


class VtkXml:
    """One file.

    Args:
        content: Of the file.
        kind: Its data set, such as "UnstructuredGrid".

    Attributes:
        root: The XML without its appended data.

    Raises:
        MeshError: It is damaged, or of another kind.
    """

    def __init__(self, content: bytes, kind: str) -> None:
        self.root, self._appended, self._encoding = _split(content)
        if self.root.tag != "VTKFile" or self.root.get("type") != kind:
            what, an = self.root.get("type", self.root.tag), "an" if kind[0] in "IU" else "a"
            raise MeshError(f"this is a {what} file", expected=f"{an} {kind} is needed")
        self._endian = ">" if self.root.get("byte_order") == "BigEndian" else "<"
        header = self.root.get("header_type", "UInt32")
        if header not in ("UInt32", "UInt64"):
            raise MeshError(f"header_type {header} is unknown", expected="UInt32 or UInt64")
        self._header = np.dtype(self._endian + TYPES[header])
        self._decompress = _decompressor(self.root.get("compressor", ""))

    def array(self, array: ElementTree.Element, rows: int, columns: int) -> AnyArray:
        """As many numbers of an array as it must have, flat. Local.

        Args:
            array: A DataArray element of the same file.
            rows: Number of its points or cells, not larger than the file can have.
            columns: Numbers of each, where the array does not state them.

        Raises:
            MeshError: It is damaged, or has more or fewer.
        """
        name, kind = array.get("Name", "Points"), array.get("type", "")
        if kind not in TYPES:
            raise MeshError(f"the array '{name}' is of the unknown type '{kind}'")
        dtype = np.dtype(self._endian + TYPES[kind])
        columns = count_of(array, "NumberOfComponents", columns) or columns
        need = rows * columns
        try:
            values = self._decoded(array, dtype, need)
        except MeshError as error:
            raise MeshError(f"the array '{name}': {error.what}", expected=error.expected) from None
        except (ValueError, binascii.Error, zlib.error, lzma.LZMAError, OverflowError) as error:
            raise MeshError(f"the array '{name}' is damaged: {error}") from None
        if len(values) != need:
            raise MeshError(f"the array '{name}' has {len(values)} numbers, {need} are needed")
        return values

    def _decoded(
        self, array: ElementTree.Element, dtype: np.dtype[np.generic], need: int
    ) -> AnyArray:
        layout = array.get("format", "ascii")
        if layout == "ascii":
            words = (array.text or "").split()
            if len(words) != need:
                raise MeshError(f"{len(words)} numbers, {need} are needed")
            return np.array(words, dtype=dtype.newbyteorder("="))
        if layout == "binary":
            source = _base64_source("".join((array.text or "").split()).encode())
            start, encoded = 0, True
        elif layout == "appended":
            source, encoded = self._appended_source()
            start = count_of(array, "offset")
        else:
            raise MeshError(
                f"the format '{layout}' is unknown", expected="ascii, binary or appended"
            )
        data = self._bytes(source, start, need * dtype.itemsize, encoded=encoded)
        return np.frombuffer(data, dtype).astype(dtype.newbyteorder("="))

    def _appended_source(self) -> tuple[_Source, bool]:
        if self._encoding == "base64":
            return _base64_source(self._appended), True
        if self._encoding != "raw":
            raise MeshError(
                f"appended data of the encoding '{self._encoding}' are not read",
                expected="raw or base64",
            )
        content = self._appended
        return _Source(lambda start, count: content[start : start + count], len(content)), False

    def _bytes(self, source: _Source, start: int, need: int, *, encoded: bool) -> bytes:
        """The bytes of an array: its size, or sizes of compressed blocks, and then the data.

        Args:
            source: Where they are.
            need: Number of bytes that there must be; more are never made.
            encoded: The source is base64, in which `start` counts characters.
        """
        width = self._header.itemsize
        first = source.take(start, width)
        if self._decompress is None:
            size = self._sizes(first, 1)[0]
            if size != need:
                raise MeshError(f"{size} bytes, {need} are needed")
            # The data are encoded together with their size, or after its padding.
            if encoded and source.take(start, width + 1) == first:
                return _whole(source.take(start + _characters(width), need), need)
            return _whole(source.take(start, width + need)[width:], need)
        count = self._sizes(first, 1)[0]
        if count == 0 and need == 0:
            return b""
        if not 0 < count <= source.size // width:
            raise MeshError(f"{count} compressed blocks do not fit into it")
        head = width * (3 + count)
        sizes = self._sizes(source.take(start, head), 3 + count)
        block, last = sizes[1], sizes[2] or sizes[1]
        if block * (count - 1) + last != need:
            raise MeshError(f"{block * (count - 1) + last} bytes, {need} are needed")
        at = start + (_characters(head) if encoded else head)
        packed = _whole(source.take(at, sum(sizes[3:])), sum(sizes[3:]))
        parts, offset = [], 0
        for i, size in enumerate(sizes[3:]):
            want = block if i < count - 1 else last
            parts.append(_whole(self._decompress(packed[offset : offset + size], want), want))
            offset += size
        return b"".join(parts)

    def _sizes(self, data: bytes, count: int) -> list[int]:
        data = _whole(data, count * self._header.itemsize)
        return [int(size) for size in np.frombuffer(data, self._header)]


def _split(content: bytes) -> tuple[ElementTree.Element, bytes, str]:
    """The XML without its appended data; these data from after their underscore; their encoding."""
    tag = content.find(b"<AppendedData")
    text, data = content, b""
    if tag >= 0:
        start, end = content.find(b">", tag), content.rfind(b"</AppendedData")
        mark = content.find(b"_", start)
        if start < 0 or end < 0 or not start < mark < end:
            raise MeshError("the appended data have no beginning or no end")
        text, data = content[: start + 1] + content[end:], content[mark + 1 : end]
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise MeshError("XML with definitions of its own is not read")
    try:
        root = parsed(text)
    except ElementTree.ParseError as error:
        raise MeshError(f"this is no XML file: {error}") from None
    appended = root.find("AppendedData")
    encoding = "" if appended is None else appended.get("encoding", "raw")
    return root, data, encoding


def _base64_source(text: bytes) -> _Source:
    """Bytes of base64: from a character on, whatever lies behind a padding is not part of it."""

    def take(start: int, count: int) -> bytes:
        characters = text[start : start + _characters(count)]
        padding = characters.find(b"=")
        if padding >= 0:
            characters = characters[: -(-(padding + 1) // 4) * 4]
        return base64.b64decode(characters, validate=True)[:count]

    return _Source(take, len(text))


def _characters(count: int) -> int:
    return -(-count // 3) * 4


def _whole(data: bytes, size: int) -> bytes:
    if len(data) != size:
        raise MeshError(f"the data end after {len(data)} of {size} bytes")
    return data


def _decompressor(name: str) -> Callable[[bytes, int], bytes] | None:
    """Decompression of a block to no more than a number of bytes."""
    if not name:
        return None
    if name == "vtkZLibDataCompressor":
        return lambda data, most: zlib.decompressobj().decompress(data, most)
    if name == "vtkLZMADataCompressor":
        return lambda data, most: lzma.LZMADecompressor().decompress(data, most)
    if name == "vtkLZ4DataCompressor":
        return _lz4()
    raise MeshError(
        f"data compressed by {name} are not read",
        expected="save it with ZLib, LZ4, LZMA or none (in ParaView: Save Data, Compressor Type)",
    )


def _lz4() -> Callable[[bytes, int], bytes]:
    """Decompression of LZ4 blocks, by a package that Matplotlib's fonts bring along in Debian."""
    try:
        import lz4.block
    except ImportError:
        raise MeshError(
            "its data are compressed by LZ4, for which the Python package lz4 is missing",
            expected="install it, or save with ZLib (in ParaView: Save Data, Compressor Type)",
        ) from None

    def decompress(data: bytes, most: int) -> bytes:
        try:
            return bytes(lz4.block.decompress(data, uncompressed_size=most))
        except lz4.block.LZ4BlockError as error:
            raise MeshError(f"a compressed block is damaged: {error}") from None

    return decompress


def count_of(element: ElementTree.Element, key: str, default: int | None = None) -> int:
    """A number in an attribute; without a default it is needed."""
    text = (element.get(key) or "").strip()
    if not text and default is not None:
        return default
    if not text.isdigit() or len(text) > 15:
        raise MeshError(f"{element.tag} has {key} = '{text}'", expected="a whole number")
    return int(text)
