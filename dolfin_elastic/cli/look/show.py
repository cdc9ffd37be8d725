"""What the command line shows of a body, in the unit of its file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.table import Table

from dolfin_elastic.cli.console import console, described_tables, show_tables

if TYPE_CHECKING:
    from dolfin_elastic.case.check.sizes import PartSize
    from dolfin_elastic.case.look.image import ImageLook
    from dolfin_elastic.case.look.listing import FaceRow, Look

_AXES = ("x", "y", "z")


def show_look(annotated: Look) -> None:
    """Prints the list."""
    screen = console()
    size = Lengths(annotated.unit, annotated.metres, annotated.dim, max(annotated.extent))
    title = f"{annotated.case}: {annotated.source}" if annotated.case else annotated.source
    screen.tell(title, style="bold")
    extent = size.text(*annotated.extent)
    screen.tell(f"  extent {extent}, {annotated.dim}D, {annotated.cells} elements")
    for text in annotated.information:
        screen.tell(f"  {text}")
    tables = [_faces(annotated, size, annotated.faces)] if annotated.faces else []
    for kind in ("surface", "region", "edge", "point"):
        rows: Sequence[PartSize] = getattr(annotated, f"{kind}s")
        if rows:
            tables.append(parts_table(kind, rows, size, directions=True))
    show_tables(screen, [*tables, *described_tables(annotated.described)])
    if annotated.faces and not annotated.case:
        one = next((face for face in annotated.faces if face.form), annotated.faces[0])
        by_size = one.description.split(",")[0].replace(one.kind, one.form or one.kind, 1)
        names = [f"face {one.number}", *([by_size] if one.radius and not one.major else [])]
        said = "  or  ".join(f'on = "{name}"' for name in names)
        screen.print(f"A case names faces like this:  {said}", markup=False)
    for note in annotated.notes:
        screen.tell(f"note: {note}")
    if annotated.picture:
        screen.tell(f"picture in {annotated.picture}")


def show_image(image: ImageLook) -> None:
    """Prints the values of an image."""
    screen, unit = console(), image.unit or "of a unit that the file does not state"
    screen.tell(image.source, style="bold")
    size, edges = (" x ".join(f"{n:.4g}" for n in row) for row in (image.shape, image.spacing))
    screen.tell(f"  {size} voxels of {edges} {unit}, values {image.low:g} to {image.high:g}")
    if not image.values:
        screen.tell("  a grey image: [mesh] takes threshold = ... in place of labels")
        return
    table = _table([("value", True), ("voxels", True), (f"[{image.unit or 'unit'}^3]", True)])
    for row in image.values:
        table.add_row(f"{row.value:g}", str(row.voxels), f"{row.volume:.6g}")
    show_tables(screen, [table])


def _table(heads: Sequence[tuple[str, bool]]) -> Table:
    """A table of columns with their heads, and whether they hold numbers."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for text, number in heads:
        table.add_column(text, justify="right" if number else "left")
    return table


def _faces(annotated: Look, size: Lengths, rows: Sequence[FaceRow]) -> Table:
    thing, power = ("face", "^2") if annotated.dim == 3 else ("curve", "")
    table = _table(
        [
            (thing, True),
            ("kind", False),
            (f"[{annotated.unit}{power}]", True),
            (f"centroid [{annotated.unit}]", False),
            ("normal or axis", False),
            ("names", False),
        ]
    )
    for row in rows:
        flat = row.kind == "plane" or not row.axis
        direction = _direction(row.normal) if flat else f"axis {_direction(row.axis)}"
        table.add_row(
            str(row.number),
            row.description,
            f"{row.area / annotated.metres ** (annotated.dim - 1):.4g}",
            size.place(row.centroid),
            direction,
            ", ".join(row.names),
        )
    return table


def parts_table(
    kind: str,
    rows: Sequence[PartSize],
    size: Lengths,
    *,
    directions: bool = False,
    use: str = "used by",
) -> Table:
    """A table of named parts.

    Args:
        kind: "surface", "region", "material", "edge" or "point".
        size: Of the body, and the unit in which lengths are shown.
        directions: Normals and CAD faces of surfaces are shown.
    """
    power = {"surface": size.dim - 1, "edge": 1, "point": 0}.get(kind, size.dim)
    things = {"surface": "facets", "edge": "mesh edges", "point": "nodes"}.get(kind, "elements")
    directions = directions and kind == "surface"
    columns: list[tuple[str, bool, Callable[[PartSize], str]]] = [
        (kind, False, lambda row: row.name),
        (things, True, lambda row: str(row.count)),
    ]
    if power:
        unit = f"[{size.unit}{f'^{power}' if power > 1 else ''}]"
        columns.append((unit, True, lambda row: f"{row.measure / size.metres**power:.4g}"))
    columns.append((f"centroid [{size.unit}]", False, lambda row: size.place(row.centroid)))
    if directions:
        columns.append(("normal", False, lambda row: _direction(row.normal)))
    if directions and any(row.faces for row in rows):
        columns.append(("faces", False, lambda row: _numbers(row.faces)))
    if any(row.mass is not None for row in rows):
        columns.append(
            ("mass [kg]", True, lambda row: "" if row.mass is None else f"{row.mass:.4g}")
        )
    if any(row.use for row in rows):
        columns.append((use, False, lambda row: row.use))
    table = _table([(head, number) for head, number, _ in columns])
    for row in rows:
        table.add_row(*(text(row) for _, _, text in columns))
    return table


@dataclass(frozen=True)
class Lengths:
    """How lengths are shown.

    Attributes:
        unit: Its name.
        metres: Its length [m].
        dim: Of the body.
        span: Its longest side [m]: coordinates that are tiny beside it are 0.
    """

    unit: str
    metres: float
    dim: int
    span: float

    def text(self, *lengths: float) -> str:
        """Lengths [m] with their unit: "100 x 10 mm"."""
        return " x ".join(f"{one / self.metres:.4g}" for one in lengths) + f" {self.unit}"

    def place(self, point: Sequence[float]) -> str:
        """A point with four digits; empty of none."""
        parts = (f"{x / self.metres:.4g}" if abs(x) > 1e-6 * self.span else "0" for x in point)
        return f"({', '.join(parts)})" if point else ""


def _direction(vector: Sequence[float]) -> str:
    """A unit vector: "-x" along an axis, else its components."""
    for i, x in enumerate(vector):
        if abs(abs(x) - 1.0) < 1e-6:
            return f"{'-' if x < 0 else '+'}{_AXES[i]}"
    parts = (f"{x:.2f}" if abs(x) >= 0.005 else "0" for x in vector)
    return f"({', '.join(parts)})" if vector else ""


def _numbers(numbers: Iterable[int]) -> str:
    every = list(numbers)
    return ", ".join(map(str, every[:8])) + (" ..." if len(every) > 8 else "")
