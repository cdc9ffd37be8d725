"""What slicers say of the parts of a 3MF file, of which not all are material.

PrusaSlicer names ranges of triangles, Bambu Studio and OrcaSlicer components, each in a file of
their own beside the model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from xml.etree.ElementTree import ParseError

import numpy as np

from dolfin_elastic.core.files.xml import walk
from dolfin_elastic.core.types import BoolArray

FILES = ("Metadata/Slic3r_PE_model.config", "Metadata/model_settings.config")

_MATERIAL = ("ModelPart", "normal_part")
_NEGATIVE = ("NegativeVolume", "negative_part")
NEGATIVE = "volume to subtract"
_WORDS = {
    **dict.fromkeys(_NEGATIVE, NEGATIVE),
    **dict.fromkeys(("ParameterModifier", "modifier_part"), "modifier"),
    **dict.fromkeys(("SupportEnforcer", "support_enforcer"), "support enforcer"),
    **dict.fromkeys(("SupportBlocker", "support_blocker"), "support blocker"),
}


class Roles:
    """Parts that are no material.

    Args:
        contents: Of those of `FILES` that there are.

    Raises:
        ParseError: One is damaged.
    """

    def __init__(self, contents: list[bytes]) -> None:
        self._parts: dict[tuple[str, str], str] = {}
        self._ranges: dict[str, list[tuple[int, int, str]]] = {}
        self._object, self._range = "", (0, -1)
        for content in contents:
            walk(content, self._start)

    def _start(self, tag: str, attributes: Mapping[str, str]) -> None:
        key, value = attributes.get("key", ""), attributes.get("value", "")
        if tag == "object":
            self._object = attributes.get("id", "")
        elif tag == "part" and (role := attributes.get("subtype", "")) not in ("", *_MATERIAL):
            self._parts[self._object, attributes.get("id", "")] = _WORDS.get(role, role[:40])
        elif tag == "volume":
            try:
                self._range = int(attributes["firstid"]), int(attributes["lastid"])
            except (KeyError, ValueError):
                raise ParseError("a volume has no range of triangles") from None
        elif tag == "metadata" and key == "volume_type" and value not in _MATERIAL:
            self._mark(_WORDS.get(value, value[:40]))
        elif tag == "metadata" and (key, value) == ("modifier", "1"):
            self._mark("modifier")

    def _mark(self, role: str) -> None:
        found = self._ranges.setdefault(self._object, [])
        if (*self._range, role) not in found:
            found.append((*self._range, role))

    def of_part(self, parent: str, number: str) -> str:
        """What a component of an object is; empty: material."""
        return self._parts.get((parent, number), "")

    def material(self, number: str, count: int, say: Callable[[str], object]) -> BoolArray:
        """Which triangles of an object are material, shape (count,).

        Args:
            number: Of the object, as the file has it.
            count: Number of its triangles, in the order of the file.
            say: Called with the role of each range that is not.
        """
        result = np.ones(count, dtype=bool)
        for first, last, role in self._ranges.get(number, ()):
            say(role)
            result[max(first, 0) : max(last + 1, 0)] = False
        return result
