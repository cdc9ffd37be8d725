"""Bytes of images, of which memory is taken as they come, and no more than the header says."""

from __future__ import annotations

import zlib
from typing import BinaryIO

from dolfin_elastic.core.errors import MeshError

RATIO = 1040
"""Bytes that a byte of compressed data can become; zlib's limit is 1032."""
CHUNK = 1 << 22


def read_exactly(stream: BinaryIO, count: int) -> bytearray:
    """As many bytes.

    Raises:
        MeshError: There are fewer.
    """
    data = bytearray()
    while len(data) < count:
        some = stream.read(min(count - len(data), CHUNK))
        if not some:
            break
        data += some
    return _whole(data, count)


def read_unpacked(stream: BinaryIO, count: int) -> bytearray:
    """As many bytes, compressed by zlib or gzip.

    Raises:
        MeshError: There are fewer, or they are damaged.
    """
    machine, data = zlib.decompressobj(wbits=47), bytearray()
    try:
        while len(data) < count and not machine.eof:
            if not (chunk := machine.unconsumed_tail or stream.read(CHUNK)):
                break
            data += machine.decompress(chunk, count - len(data))
    except zlib.error as error:
        raise MeshError(f"its compressed data are damaged: {error}") from None
    return _whole(data, count)


def _whole(data: bytearray, count: int) -> bytearray:
    if len(data) != count:
        raise MeshError(
            f"the file ends after {len(data)} of {count} bytes of its image",
            expected="the whole file",
        )
    return data
