"""XML files that others have written, without definitions of their own.

A definition (``<!ENTITY``) can stand for a text that is far longer than the file, or for another
file.  Definitions stand before the first element, so that is where they are looked for.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from dolfin_elastic.core.errors import why_no_file

_CHUNK = 1 << 16


class UnsafeXmlError(ElementTree.ParseError):
    """A file with definitions of its own, or that is none."""


class _RootReached(Exception):  # noqa: N818 (no error)
    """The first element begins."""


def read_xml(path: Path) -> ElementTree.Element:
    """The root of a document. Not collective.

    Raises:
        ElementTree.ParseError: It is no XML file, or has definitions of its own.
        OSError: It cannot be read.
    """
    if fault := why_no_file(path, sys.maxsize):
        raise UnsafeXmlError(fault)
    return parsed(path.read_bytes())


def parsed(content: bytes) -> ElementTree.Element:
    """As `read_xml`, of the content of a file."""
    _refuse_definitions(content)
    return ElementTree.fromstring(content)


def _refuse_definitions(content: bytes) -> None:
    parser = expat.ParserCreate()
    parser.StartElementHandler = _stop
    parser.EntityDeclHandler = _refuse
    try:
        for start in range(0, len(content), _CHUNK):
            parser.Parse(content[start : start + _CHUNK], False)
    except _RootReached:
        return
    except expat.ExpatError:
        return  # ElementTree says where


def _stop(*_: object) -> None:
    raise _RootReached


def _refuse(*_: object) -> None:
    raise UnsafeXmlError("definitions of entities (<!ENTITY) are not read")


def walk(
    content: bytes,
    start: Callable[[str, Mapping[str, str]], None],
    end: Callable[[str], None] | None = None,
) -> None:
    """Calls for each element as it begins and ends, for files too large for a tree. Not collective.

    Args:
        start: Called with its name, "{namespace}name" where it has a namespace, and its attributes.

    Raises:
        ElementTree.ParseError: It is no XML file, or has definitions of its own.
    """
    parser = expat.ParserCreate(namespace_separator="}")
    parser.buffer_text = True
    parser.EntityDeclHandler = _refuse
    parser.StartElementHandler = start
    if end is not None:
        parser.EndElementHandler = end
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise UnsafeXmlError(str(error)) from None
