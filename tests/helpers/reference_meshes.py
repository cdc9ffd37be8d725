"""Meshes of the reference cases, as text for Gmsh, and how such a case is run.

A case refers to its `.geo` file as a user's would.  Patches have four sides and a regular net of
triangles; sides may be arcs of circles and ellipses about the origin, along which the cells are
curved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfin_elastic import Case, run
from dolfin_elastic.problem.state import State

FREE = "free"
Corners = Sequence[tuple[float, float]]


def patch(
    corners: Corners,
    cells: tuple[int, int],
    *,
    kinds: Mapping[int, str] | None = None,
    grading: tuple[float, float] = (1.0, 1.0),
    bump: float = 0.0,
    diagonals: str = "Alternate",
    order: int = 1,
) -> str:
    """One patch.

    Args:
        corners: Its four corners against the clock; side i goes from corner i to corner i + 1.
        cells: Along sides 0 and 2, and along sides 1 and 3.
        kinds: Side to "circle" or "ellipse" about the origin, with axes along x and y.
        grading: Length of a cell over that of the one before, from side 3 to 1 and from 0 to 2.
        bump: Instead of that: size of the cells at the ends of all sides over those amid, about.
        diagonals: Which way squares are cut: "Left", "Right" or "Alternate".
        order: Degree of the cells' geometry.
    """
    lines = [
        f"Mesh.ElementOrder = {order};",
        # Nodes of curved sides stay where they are: on the arc, evenly.
        "Mesh.HighOrderOptimize = 0;",
        "Point(9) = {0, 0, 0};",
    ]
    lines += [f"Point({i + 1}) = {{{x:.17g}, {y:.17g}, 0}};" for i, (x, y) in enumerate(corners)]
    for i in range(4):
        a, b = i + 1, (i + 1) % 4 + 1
        lines.append(_side((kinds or {}).get(i, "line"), i + 1, a, b, corners))
        growth = grading[i % 2] if i < 2 else 1 / grading[i % 2]
        spread = f"Bump {bump:.17g}" if bump else f"Progression {growth:.17g}"
        lines.append(f"Transfinite Curve {{{i + 1}}} = {cells[i % 2] + 1} Using {spread};")
    lines += [
        "Curve Loop(1) = {1, 2, 3, 4};",
        "Plane Surface(1) = {1};",
        "Transfinite Surface {1} = {1, 2, 3, 4} " + diagonals + ";",
        'Physical Surface("body") = {1};',
        *(f'Physical Curve("side{i}") = {{{i + 1}}};' for i in range(4)),
    ]
    return "\n".join(lines)


def _side(kind: str, number: int, a: int, b: int, corners: Corners) -> str:
    if kind == "line":
        return f"Line({number}) = {{{a}, {b}}};"
    if kind == "circle":
        return f"Circle({number}) = {{{a}, 9, {b}}};"
    longest = a if max(map(abs, corners[a - 1])) > max(map(abs, corners[b - 1])) else b
    return f"Ellipse({number}) = {{{a}, 9, {longest}, {b}}};"


def ring(
    inner: float, outer: float, cells: tuple[int, int], grading: float = 1.0, **how: Any
) -> str:
    """A quarter of a ring: side0 on the x axis, side1 outside, side2 on the y axis, side3 inside.

    Args:
        inner: Inner radius.
        outer: Outer radius.
        cells: Through the thickness, and around.
        grading: Thickness of a cell over that of the one inside of it.
        how: More about the patch.
    """
    corners = [(inner, 0.0), (outer, 0.0), (0.0, outer), (0.0, inner)]
    arcs = {1: "circle", 3: "circle"}
    return patch(corners, cells, kinds=arcs, grading=(grading, 1.0), order=2, **how)


def tables(
    folder: Path, geo: str, material: Mapping[str, Any], *, degree: int = 2, **mesh: Any
) -> dict[str, Any]:
    """The tables [mesh], [materials] and [output] of a case on a `.geo` file, which is written."""
    if MPI.COMM_WORLD.rank == 0:
        (folder / "body.geo").write_text(geo)
    MPI.COMM_WORLD.barrier()
    return {
        "mesh": {"file": str(folder / "body.geo"), "degree": degree, **mesh},
        "materials": {"body": dict(material)},
        "output": {"fields": ["displacement"]},
    }


def solved(case: dict[str, Any], folder: Path) -> State:
    """The last state of a case."""
    *_, state = run(Case.from_dict(case), output=folder / "out")
    return state


def probing(case: dict[str, Any], **points: Any) -> dict[str, Any]:
    """The case with probes."""
    return {**case, "output": {**case["output"], "probes": points}}
