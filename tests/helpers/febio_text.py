"""FEBio files written by hand."""

from __future__ import annotations

from collections.abc import Mapping

from dolfin_elastic.core.types import AnyArray


def row(numbers: AnyArray) -> str:
    """Numbers of rows with commas, from 1."""
    return ",".join(str(i + 1) for i in numbers)


def listed(tag: str, rows: AnyArray) -> str:
    """A line for each row of nodes."""
    return "\n".join(f'<{tag} id="{i}">{row(r)}</{tag}>' for i, r in enumerate(rows, 1))


def nodes_text(points: AnyArray, name: str = "") -> str:
    """The section of nodes."""
    lines = "\n".join(
        f'<node id="{i}">{x!r},{y!r},{z!r}</node>' for i, (x, y, z) in enumerate(points.tolist(), 1)
    )
    title = f' name="{name}"' if name else ""
    return f"<Nodes{title}>\n{lines}\n</Nodes>"


def node_set(name: str, rows: AnyArray, version: str) -> str:
    """A set of nodes as a specification writes it."""
    ids = {"2.5": "node", "3.0": "n"}.get(version)
    inside = "".join(f'<{ids} id="{i + 1}"/>' for i in rows) if ids else row(rows)
    return f'<NodeSet name="{name}">{inside}</NodeSet>'


def febio_text(
    points: AnyArray,
    parts: Mapping[str, AnyArray],
    *,
    sets: Mapping[str, AnyArray] | None = None,
    surfaces: Mapping[str, AnyArray] | None = None,
    more: str = "",
    version: str = "4.0",
) -> str:
    """A model; numbers are those of the rows from 1.

    Args:
        points: Coordinates, shape (n, 3).
        parts: Name to rows of points of its tetrahedra; each is of the material of its number.
        sets: Name to rows of points.
        surfaces: Name to rows of points of its triangles.
        more: Sections below.
        version: Of the specification.
    """
    text = [nodes_text(points)]
    first = 1
    for number, (name, cells) in enumerate(parts.items(), 1):
        titles = {"2.0": f'mat="{number}" elset="{name}"', "2.5": f'mat="{number}" name="{name}"'}
        title = titles.get(version, f'name="{name}"')
        rows = "\n".join(f'<elem id="{first + i}">{row(c)}</elem>' for i, c in enumerate(cells))
        first += len(cells)
        text.append(f'<Elements type="tet{cells.shape[1]}" {title}>\n{rows}\n</Elements>')
    for name, rows in (sets or {}).items():
        text.append(node_set(name, rows, version))
    for name, facets in (surfaces or {}).items():
        inside = listed(f"tri{facets.shape[1]}", facets)
        text.append(f'<Surface name="{name}">\n{inside}\n</Surface>')
    mesh = "Mesh" if version >= "3" else "Geometry"
    body = "\n".join(text)
    return (
        f'<?xml version="1.0" encoding="ISO-8859-1"?>\n<febio_spec version="{version}">\n'
        f'<Module type="solid"/>\n<{mesh}>\n{body}\n</{mesh}>\n{more}\n</febio_spec>\n'
    )
