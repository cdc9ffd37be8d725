"""XML without definitions of its own."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import ParseError

import pytest

from dolfin_elastic.core.files.xml import read_xml

pytestmark = pytest.mark.usefixtures("serial_only")

LAUGHS = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]><x>&b;</x>'
OTHER = '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><x>&a;</x>'


@pytest.mark.parametrize("text", [LAUGHS, OTHER, " " * 100000 + LAUGHS])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_definitions(tmp_path: Path, text: str, encoding: str) -> None:
    (tmp_path / "a.xml").write_bytes(text.encode(encoding))
    with pytest.raises(ParseError, match=r"<!ENTITY"):
        read_xml(tmp_path / "a.xml")


def test_documents(tmp_path: Path) -> None:
    """DOLFINx's name a definition of types, which is not looked for."""
    text = '<?xml version="1.0"?><!DOCTYPE Xdmf SYSTEM "Xdmf.dtd" []><Xdmf><A b="&lt;"/></Xdmf>'
    (tmp_path / "a.xml").write_text(text)
    assert read_xml(tmp_path / "a.xml").find("A").get("b") == "<"  # type: ignore[union-attr]
    (tmp_path / "a.xml").write_text("hello")
    with pytest.raises(ParseError, match="syntax error"):
        read_xml(tmp_path / "a.xml")
