"""The surface of a body, its deformed states and what acts on it, to be drawn.

`Scene` is plain numbers; `still.py` makes pictures of it, and `packed` the data of the viewer.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.si_text import scaled_unit
from dolfin_elastic.core.startup.elsewhere import elsewhere
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.results.derived.spectral import von_mises
from dolfin_elastic.results.fields import FIELDS, SAFEST
from dolfin_elastic.results.scene.scene import SMALL_MATTERS, label_of

if TYPE_CHECKING:
    import pyvista

MOST_TRIANGLES = 120_000
"""Of the viewer; larger surfaces are drawn with fewer."""
_ROOM = 2_500_000
"""Bytes for the displacements and values of all frames."""
MOST_FRAMES = 24
_SHARP = 30.0
"""Angle [degrees] between facets from which on the edge between them is drawn."""
_VISIBLE = 0.08
"""Largest displacement, over the body's size, to which small ones are scaled up."""
_NOT_SMALL = 0.04
"""The same from which on they are shown as they are."""
FIRST = ("von_mises", "displacement", "safety_factor", "contact_pressure")
"""Fields that are offered first, and that have room in any page: the first two of them."""
_NO_SIZES = re.compile(r"fibre2?|normal|(principal|stretch)_direction_\d|region|material|rank")
"""Fields whose length says nothing, or whose numbers are names."""
_ALWAYS = 2
_ALL_ROOM = 4_400_000
"""Bytes of a scene up to which further fields are added; as text they are a third more."""
_LARGEST_SAFETY = 5.0
"""Safety factor above which all have one colour."""
_EQUAL = 1e-9
"""Relative difference below which values count as equal."""
_LAST, _UNKNOWN = 65534, 65535
"""16 bit numbers of the last colour, and of nodes without a value."""


@dataclass(frozen=True)
class Shown:
    """A field as it is drawn.

    Attributes:
        name: Of the field.
        title: For people.
        low: Value of the first colour, SI units.
        high: Of the last one.
        factor: What to divide by for `unit`.
        unit: For people.
    """

    name: str
    title: str
    low: float
    high: float
    factor: float
    unit: str


@dataclass(frozen=True)
class View:
    """A deformed state, or a mode.

    Attributes:
        label: Its load, time or frequency.
        u: Displacements of the nodes [m], shape (n, 3).
        values: Field's name to its values at the nodes, shape (n,).
    """

    label: str
    u: FloatArray
    values: Mapping[str, FloatArray]


@dataclass(frozen=True)
class Marks:
    """Arrows of a support or load.

    Attributes:
        name: The parts it acts on.
        load: Of a load; otherwise of a support.
        nodes: Of the scene where they stand; -1: in the middle of the body.
        along: Directions, shape (n, 3).
        tails: Those that begin at the node; the others end there.
    """

    name: str
    load: bool
    nodes: IntArray
    along: FloatArray
    tails: tuple[bool, ...]


@dataclass(frozen=True)
class Scene:
    """What is drawn.

    Attributes:
        points: Nodes [m], undeformed, shape (n, 3).
        triangles: Shape (m, 3).
        edges: Sharp edges and boundaries, shape (k, 2).
        views: At least one.
        plane: The body is plane.
        modes: The views are modes, whose size means nothing.
        of: Triangles of the surface before it was thinned out.
        marks: Supports and loads.
        fields: What can be shown, in the order in which it is offered.
        left_out: Titles of fields for which the page has no room.
    """

    points: FloatArray
    triangles: IntArray
    edges: IntArray
    views: tuple[View, ...]
    plane: bool = False
    modes: bool = False
    of: int = 0
    marks: tuple[Marks, ...] = ()
    fields: tuple[Shown, ...] = field(init=False)
    left_out: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        names = _offered(self.views)
        titles = _titles(names)
        shown = [_shown(name, titles[name], self.views, modes=self.modes) for name in names]
        # Numbers of 16 bits each, those of the viewer's triangles and edges of 32.
        used = 6 * len(self.points) * (1 + len(self.views))
        used += 12 * len(self.triangles) + 8 * len(self.edges)
        each = 2 * len(self.points) * len(self.views)
        count = max(_ALWAYS, (_ALL_ROOM - used) // max(each, 1))
        # The only way to complete a frozen object.
        object.__setattr__(self, "fields", tuple(shown[:count]))
        object.__setattr__(self, "left_out", tuple(one.title for one in shown[count:]))

    @property
    def size(self) -> float:
        """Longest side of the body [m]."""
        return float(np.ptp(self.points, axis=0).max()) or 1.0

    @property
    def last(self) -> int:
        """Index of the view that is shown first: the last state, the first mode."""
        return 0 if self.modes else len(self.views) - 1

    @property
    def scale(self) -> float:
        """Factor on the displacements at which they are seen."""
        most = max(float(np.abs(view.u).max(initial=0.0)) for view in self.views)
        if most == 0 or (most >= _NOT_SMALL * self.size and not self.modes):
            return 1.0
        wanted = _VISIBLE * self.size / most
        if wanted <= 1 and not self.modes:
            return 1.0
        power = 10.0 ** np.floor(np.log10(wanted))
        return float(max(k * power for k in (1, 2, 5) if k * power <= wanted))


def _finite(view: View, name: str) -> bool:
    """Whether a view has a field, with a number at some node."""
    return name in view.values and bool(np.isfinite(view.values[name]).any())


def _offered(views: Sequence[View]) -> list[str]:
    """Names of the fields of all views, the first ones first; none that is the same everywhere."""
    names = dict.fromkeys([*FIRST, *(name for view in views for name in view.values)])
    sizes = [n for n in names if n in FIELDS and not _NO_SIZES.fullmatch(n)]
    known = [n for n in sizes if all(_finite(view, n) for view in views)]
    return [n for n in known if n in FIRST or _varies([view.values[n] for view in views])]


def _varies(every: Sequence[FloatArray]) -> bool:
    low, high = _range(every)
    return high - low > _EQUAL * max(abs(low), abs(high))


def _range(every: Sequence[FloatArray]) -> tuple[float, float]:
    """Smallest and largest finite value."""
    finite = [v[np.isfinite(v)] for v in every]
    return min(float(v.min()) for v in finite), max(float(v.max()) for v in finite)


def _titles(names: Sequence[str]) -> dict[str, str]:
    """Names for people, none of them twice."""
    labels = {name: label_of(name) for name in names}
    alike = [label for label in labels.values() if list(labels.values()).count(label) > 1]
    return {n: f"{label} ({n})" if label in alike else label for n, label in labels.items()}


def _shown(name: str, title: str, views: Sequence[View], *, modes: bool) -> Shown:
    unit = FIELDS[name].unit
    low, high = _range([view.values[name] for view in views])
    if name in SMALL_MATTERS:
        low, high = 0.0, _LARGEST_SAFETY
    elif unit:  # a strain or stretch need not begin at 0
        low, high = min(low, 0.0), max(high, 0.0)
    largest = max(abs(low), abs(high))
    factor, shown = (largest or 1.0, "") if modes else scaled_unit(largest, unit)
    if modes:  # a mode has no size of its own
        title = f"{title} (scaled to 1)"
    if FIELDS[name].shape == "tensor":
        title = f"{title} (norm)"
    return Shown(name, title, low, high, factor, shown)


# --- from grids ---


def surface_of(grid: pyvista.UnstructuredGrid) -> tuple[IntArray, IntArray, IntArray, int]:
    """The surface of a grid as triangles between its nodes.

    Quadratic cells give four triangles a face, so that they are drawn curved.

    Returns:
        Nodes of the grid that are used, triangles and edges between these, and the number of
        triangles before they were made fewer.
    """
    with elsewhere():
        import pyvista as pv

    grid = grid.copy(deep=False)
    grid.clear_data()
    grid.point_data["node"] = np.arange(grid.n_points)
    triangles = _boundary_triangles(grid)
    faces = np.insert(triangles, 0, 3, axis=1)
    surface = pv.PolyData(np.asarray(grid.points), faces.ravel())
    surface.point_data["node"] = np.arange(grid.n_points)
    surface = surface.clean(tolerance=0.0, point_merging=False)
    before = surface.n_cells
    if before > MOST_TRIANGLES:
        surface = surface.decimate_pro(1 - MOST_TRIANGLES / before, preserve_topology=True)
    lines = surface.extract_feature_edges(
        _SHARP, boundary_edges=True, non_manifold_edges=False, manifold_edges=False
    )
    nodes = np.asarray(surface.point_data["node"], dtype=np.int64)
    where = np.full(grid.n_points, -1, dtype=np.int64)
    where[nodes] = np.arange(len(nodes))
    ends = np.asarray(lines.lines, dtype=np.int64).reshape(-1, 3)[:, 1:]
    edges = where[np.asarray(lines.point_data["node"], dtype=np.int64)[ends]] if len(ends) else ends
    found = np.asarray(surface.regular_faces, dtype=np.int64)
    return nodes, found, edges, before


_FACES = {
    5: [[0, 1, 2]],
    10: [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
    22: [[0, 1, 2, 3, 4, 5]],
    24: [[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [0, 3, 2, 7, 9, 6]],
}
"""VTK's number of a cell to its faces: three corners, then the nodes between them."""
_QUARTERS = [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]


def _boundary_triangles(grid: pyvista.UnstructuredGrid) -> IntArray:
    """Faces that belong to one cell, as triangles between nodes of the grid."""
    (kind,) = {int(number) for number in np.unique(grid.celltypes)}
    cells = np.asarray(grid.cells_dict[kind], dtype=np.int64)
    faces = np.concatenate([cells[:, face] for face in _FACES[kind]])
    if kind in (10, 24):
        # Cells may run either way round: the faces are turned so that they look outwards.
        edges = np.asarray(grid.points)[cells[:, 1:4]] - np.asarray(grid.points)[cells[:, :1]]
        turned = np.tile(np.linalg.det(edges) < 0, len(_FACES[kind]))
        order = [0, 2, 1] if kind == 10 else [0, 2, 1, 5, 4, 3]
        faces[turned] = faces[turned][:, order]
        corners = np.sort(faces[:, :3], axis=1)
        _, first, count = np.unique(corners, axis=0, return_index=True, return_counts=True)
        faces = faces[np.sort(first[count == 1])]
    if faces.shape[1] == 3:
        return np.asarray(faces)
    return np.concatenate([faces[:, quarter] for quarter in _QUARTERS])


def node_values(
    grid: pyvista.UnstructuredGrid, allowable: float | None = None
) -> dict[str, FloatArray]:
    """Field's name to its values at the nodes; of vectors and tensors their length or norm.

    Values of cells are averaged at the nodes.  The von Mises stress follows from the Cauchy stress
    where a run has not written it, and the safety factor from the von Mises stress.

    Args:
        allowable: Stress [Pa] of all materials, if they have one and the same.
    """
    rows: dict[str, FloatArray] = {}
    cells = [name for name in FIELDS if name in grid.cell_data]
    averaged = grid.cell_data_to_point_data() if cells else grid
    for name in (*grid.point_data.keys(), *cells):
        if name in FIELDS:
            data = averaged.point_data if name in cells else grid.point_data
            rows[name] = np.asarray(data[name], dtype=np.float64)
    found = {
        name: np.linalg.norm(values, axis=1) if values.ndim == 2 else values
        for name, values in rows.items()
    }
    for name in ("cauchy_stress", "cauchy_stress_cell"):
        if name in rows and not any(one.startswith("von_mises") for one in found):
            found["von_mises"] = von_mises(rows[name])[:, 0]
    if allowable and "safety_factor" not in found and "von_mises" in found:
        found["safety_factor"] = allowable / np.maximum(found["von_mises"], allowable / SAFEST)
    return found


def chosen_frames(count: int, nodes: int) -> list[int]:
    """Indices of the frames that have room, spread evenly, with the last one.

    Args:
        count: Of all frames.
    """
    most = max(1, min(MOST_FRAMES, _ROOM // max(10 * nodes, 1)))
    if count <= most:
        return list(range(count))
    if most == 1:
        return [count - 1]
    return sorted({round(k) for k in np.linspace(0, count - 1, most)})


# --- for the viewer ---


def packed(scene: Scene, colours: AnyArray, palette: Mapping[str, str]) -> dict[str, object]:
    """JSON data of the viewer: numbers of 16 bit between the ends of their ranges.

    Args:
        colours: Shape (256, 4), uint8.
        palette: Name of each support and load to its colour.
    """
    low, span = scene.points.min(axis=0), np.ptp(scene.points, axis=0)
    room = np.where(span > 0, span, 1.0)
    lengths = np.linalg.norm(scene.views[scene.last].u, axis=1)
    return {
        "count": len(scene.points),
        "size": scene.size,
        "low": low.tolist(),
        "span": span.tolist(),
        "middle": (low + span / 2).tolist(),
        "plane": scene.plane,
        "modes": scene.modes,
        "scale": scene.scale,
        "longest": float(lengths.max(initial=0.0)) / scene.size,
        "points": _text(np.rint((scene.points - low) / room * 65535).astype("<u2")),
        "triangles": _text(scene.triangles.astype("<u4")),
        "edges": _text(scene.edges.astype("<u4")),
        "colours": _text(colours),
        "fields": [
            {
                **{key: getattr(shown, key) for key in ("name", "title", "factor", "unit")},
                "low": shown.low,
                "high": shown.high,
                "least": shown.name in SMALL_MATTERS,
            }
            for shown in scene.fields
        ],
        "frames": [_frame(view, scene.fields) for view in scene.views],
        "glyphs": [_glyph(marks, palette[marks.name]) for marks in scene.marks],
    }


def _frame(view: View, fields: Sequence[Shown]) -> dict[str, object]:
    largest = float(np.abs(view.u).max(initial=0.0)) or 1.0
    return {
        "label": view.label,
        "largest": largest,
        "u": _text(np.rint(view.u / largest * 32767).astype("<i2")),
        "values": {shown.name: _text(_shares(view.values[shown.name], shown)) for shown in fields},
    }


def _shares(values: FloatArray, shown: Shown) -> AnyArray:
    room = (shown.high - shown.low) or 1.0
    shares = _LAST * np.clip((values - shown.low) / room, 0.0, 1.0)
    return np.asarray(np.where(np.isnan(shares), _UNKNOWN, np.rint(shares)).astype("<u2"))


def _glyph(marks: Marks, colour: str) -> dict[str, object]:
    return {
        "load": marks.load,
        "colour": colour,
        "at": marks.nodes.tolist(),
        "along": np.round(marks.along, 5).ravel().tolist(),
        "tail": list(marks.tails),
        "grow": 2.2 if (marks.nodes < 0).any() else 1,
    }


def _text(array: AnyArray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
