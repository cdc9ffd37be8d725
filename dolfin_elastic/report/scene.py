"""The scene of a page: fields that it offers, and `packed`, the data of the viewer."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.si_text import quantity, scaled_unit
from dolfin_elastic.core.startup.elsewhere import elsewhere
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.results.derived.spectral import von_mises
from dolfin_elastic.results.fields import FIELDS, field_in_file
from dolfin_elastic.results.scene.colour_bar import colour_map
from dolfin_elastic.results.scene.scene import SAFEST as SAFE
from dolfin_elastic.results.scene.scene import (
    SMALL_MATTERS,
    Frame,
    Glyphs,
    Reliable,
    Scene,
    label_of,
    nearest,
)
from dolfin_elastic.results.scene.surface import outer_faces
from dolfin_elastic.results.verdict import SAFEST

if TYPE_CHECKING:
    import pyvista

MOST_TRIANGLES = 120_000
"""Of the viewer; larger surfaces are drawn with fewer."""
_ROOM = 2_500_000
"""Bytes for the displacements and values of all frames."""
MOST_FRAMES = 24
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
        most: Largest value, above `high` where it is singular.
        limit: Marked value, such as the allowable stress; 0: there is none.
        factor: What to divide by for `unit`.
        unit: For people.
    """

    name: str
    title: str
    low: float
    high: float
    most: float
    limit: float
    factor: float
    unit: str


@dataclass(frozen=True)
class Viewed:
    """A scene as a page shows it.

    Attributes:
        scene: The body, its states or modes, and supports and loads.
        modes: The frames are modes, whose size means nothing.
        of: Triangles of the surface before it was thinned out.
        allowable: Stress of all materials [Pa]; 0: there is none.
        reliable: Field to what to judge by in the last frame, where its largest value is singular.
        ways: Of each obstacle its displacement and that of the body's nearest point in each frame
            [m], shape (frames, 2, 3): it stays as far away, however magnified the body moves.
        fields: What can be shown, in the order in which it is offered.
        left_out: Titles of fields for which the page has no room.
    """

    scene: Scene
    modes: bool = False
    of: int = 0
    allowable: float = 0.0
    reliable: Mapping[str, Reliable] = field(default_factory=dict)
    ways: tuple[FloatArray, ...] = ()
    fields: tuple[Shown, ...] = field(init=False)
    left_out: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        scene, frames = self.scene, self.scene.frames
        names = _offered(frames)
        titles = _titles(names)
        shown = [_shown(name, titles[name], self) for name in names]
        # Numbers of 16 bits each, those of the viewer's triangles and edges of 32.
        used = 6 * len(scene.points) * (1 + len(frames))
        used += 12 * len(scene.triangles) + 8 * len(scene.edges)
        used += sum(12 * (len(one.points) + len(one.triangles)) for one in scene.obstacles)
        each = 2 * len(scene.points) * len(frames)
        count = max(_ALWAYS, (_ALL_ROOM - used) // max(each, 1))
        # The only way to complete a frozen object.
        object.__setattr__(self, "fields", tuple(shown[:count]))
        object.__setattr__(self, "left_out", tuple(one.title for one in shown[count:]))

    @property
    def size(self) -> float:
        """Longest side of the body [m]."""
        return float(np.ptp(self.scene.points, axis=0).max()) or 1.0

    @property
    def last(self) -> int:
        """Index of the frame that is shown first: the last state, the first mode."""
        return 0 if self.modes else len(self.scene.frames) - 1

    @property
    def frame(self) -> Frame:
        """The frame that is shown first."""
        return self.scene.frames[self.last]

    @property
    def scale(self) -> float:
        """Factor on the displacements at which they are seen."""
        most = max(float(np.abs(one.u).max(initial=0.0)) for one in self.scene.frames)
        if most == 0 or (most >= _NOT_SMALL * self.size and not self.modes):
            return 1.0
        wanted = _VISIBLE * self.size / most
        if wanted <= 1 and not self.modes:
            return 1.0
        power = 10.0 ** np.floor(np.log10(wanted))
        return float(max(k * power for k in (1, 2, 5) if k * power <= wanted))


def _offered(frames: Sequence[Frame]) -> list[str]:
    """Names of the fields of all frames, the first ones first; none that is the same everywhere."""
    names = dict.fromkeys([*FIRST, *(name for one in frames for name in one.values)])
    sizes = [n for n in names if not _NO_SIZES.fullmatch(n)]
    known = [n for n in sizes if all(np.isfinite(f.values.get(n, np.nan)).any() for f in frames)]
    return [n for n in known if n in FIRST or _varies([one.values[n] for one in frames])]


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


def _shown(name: str, title: str, viewed: Viewed) -> Shown:
    row, modes, limit = field_in_file(name), viewed.modes, 0.0
    unit = row.unit
    low, high = _range([one.values[name] for one in viewed.scene.frames])
    most = high
    if name in SMALL_MATTERS:
        low, high, most, limit = 0.0, SAFE, SAFE, 1.0
    elif unit:  # a strain or stretch need not begin at 0
        low, most = min(low, 0.0), max(high, 0.0)
        known = viewed.reliable.get(name)
        high = most if known is None else float(np.fmin(most, known.value))
        limit = viewed.allowable if name.startswith("von_mises") and not modes else 0.0
    largest = max(abs(low), abs(high))
    factor, shown = (largest or 1.0, "") if modes else scaled_unit(largest, unit)
    if modes:  # a mode has no size of its own
        title = f"{title} (scaled to 1)"
    if row.shape == "tensor":
        title = f"{title} (norm)"
    return Shown(name, title, low, high, most, limit, factor, shown)


# --- from grids ---


def surface_of(grid: pyvista.UnstructuredGrid) -> tuple[IntArray, IntArray, int]:
    """The surface of a grid as triangles between its nodes.

    Quadratic cells give four triangles a face, so that they are drawn curved.

    Returns:
        Nodes of the grid that are used, triangles between these, and the number of triangles
        before they were made fewer.
    """
    (cells,) = grid.cells_dict.values()
    faces, _ = outer_faces(cells.astype(np.int64), np.asarray(grid.points))
    triangles: IntArray = faces[:, _PARTS[faces.shape[1]]].reshape(-1, 3)
    if (before := len(triangles)) > MOST_TRIANGLES:
        with elsewhere():
            import pyvista as pv

        surface = pv.PolyData(np.asarray(grid.points), np.insert(triangles, 0, 3, axis=1).ravel())
        surface.point_data["node"] = np.arange(grid.n_points)
        surface = surface.clean(tolerance=0.0, point_merging=False)
        surface = surface.decimate_pro(1 - MOST_TRIANGLES / before, preserve_topology=True)
        numbers = np.asarray(surface.point_data["node"], dtype=np.int64)
        triangles = numbers[np.asarray(surface.regular_faces, dtype=np.int64)]
    nodes, result = np.unique(triangles, return_inverse=True)
    return nodes, result.reshape(-1, 3), before


_PARTS = {3: [[0, 1, 2]], 6: [[0, 5, 4], [5, 1, 3], [4, 3, 2], [5, 3, 4]]}
"""Number of nodes of a face to the triangles between them."""


def node_values(grid: pyvista.UnstructuredGrid, allowable: float = 0.0) -> dict[str, FloatArray]:
    """Field's name to its values at the nodes; of vectors and tensors their length or norm.

    Values of cells are averaged at the nodes.  The von Mises stress follows from the Cauchy stress
    where a run has not written it, and the safety factor from the von Mises stress.

    Args:
        allowable: Stress [Pa] of all materials, 0 if they have not one and the same.
    """
    rows: dict[str, FloatArray] = {}
    cells = [name for name in (*FIELDS, *grid.cell_data.keys()) if name in grid.cell_data]
    averaged = grid.cell_data_to_point_data() if cells else grid
    for name in (*grid.point_data.keys(), *cells):
        data = averaged.point_data if name in cells else grid.point_data
        rows[name] = np.asarray(data[name], dtype=np.float64)
    result = {
        name: np.linalg.norm(values, axis=1) if values.ndim == 2 else values
        for name, values in rows.items()
    }
    for name in ("cauchy_stress", "cauchy_stress_cell"):
        if name in rows and not any(one.startswith("von_mises") for one in result):
            result["von_mises"] = von_mises(rows[name])[:, 0]
    if allowable and "safety_factor" not in result and "von_mises" in result:
        result["safety_factor"] = allowable / np.maximum(result["von_mises"], allowable / SAFEST)
    return result


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


def packed(viewed: Viewed, palette: Mapping[str, str]) -> dict[str, object]:
    """JSON data of the viewer: numbers of 16 bit between the ends of their ranges.

    Args:
        palette: Key of each support and load to its colour.
    """
    scene = viewed.scene
    low, span = scene.points.min(axis=0), np.ptp(scene.points, axis=0)
    room = np.where(span > 0, span, 1.0)
    lengths = np.linalg.norm(viewed.frame.u, axis=1)
    return {
        "count": len(scene.points),
        "size": viewed.size,
        "low": low.tolist(),
        "span": span.tolist(),
        "middle": (low + span / 2).tolist(),
        "plane": scene.plane,
        "modes": viewed.modes,
        "scale": viewed.scale,
        "longest": float(lengths.max(initial=0.0)) / viewed.size,
        "points": _text(np.rint((scene.points - low) / room * 65535).astype("<u2")),
        "triangles": _text(scene.triangles.astype("<u4")),
        "edges": _text(scene.edges.astype("<u4")),
        "colours": _text(np.rint(255 * colour_map()(np.arange(256))).astype(np.uint8)),
        "fields": [
            {**asdict(one), "least": one.name in SMALL_MATTERS, "judge": _judged(viewed, one)}
            for one in viewed.fields
        ],
        "frames": [_frame(frame, viewed.fields) for frame in scene.frames],
        "glyphs": [_glyph(glyphs, scene, palette[glyphs.key]) for glyphs in scene.glyphs],
        "obstacles": [
            {
                "points": _text(one.points.astype("<f4")),
                "triangles": _text(one.triangles.astype("<u4")),
                "colour": one.colour,
                "ways": way.tolist(),
            }
            for one, way in zip(scene.obstacles, viewed.ways, strict=True)
        ],
    }


def _judged(viewed: Viewed, shown: Shown) -> dict[str, object] | None:
    """Where to judge by in the last frame, -1 nowhere on its surface, and what stands there."""
    known = viewed.reliable.get(shown.name)
    if known is None:
        return None
    near = nearest(viewed.scene, known.place) if np.isfinite(known.value) else -1
    text = f"{quantity(known.value, field_in_file(shown.name).unit)} {known.error}".strip()
    return {"at": near, "text": text if near >= 0 else ""}


def _frame(frame: Frame, fields: Sequence[Shown]) -> dict[str, object]:
    largest = float(np.abs(frame.u).max(initial=0.0)) or 1.0
    return {
        "label": frame.label,
        "largest": largest,
        "u": _text(np.rint(frame.u / largest * 32767).astype("<i2")),
        "values": {one.name: _text(_shares(frame.values[one.name], one)) for one in fields},
    }


def _shares(values: FloatArray, shown: Shown) -> AnyArray:
    room = (shown.most - shown.low) or 1.0
    shares = _LAST * np.clip((values - shown.low) / room, 0.0, 1.0)
    return np.asarray(np.where(np.isnan(shares), _UNKNOWN, np.rint(shares)).astype("<u2"))


def _glyph(glyphs: Glyphs, scene: Scene, colour: str) -> dict[str, object]:
    """Glyphs at the nearest nodes, which move; those inside in the middle of the body, -1."""
    from scipy.spatial import cKDTree

    at = np.full(len(glyphs.places), -1)
    if not glyphs.inside:
        at = cKDTree(scene.points).query(glyphs.places)[1]
    return {
        "load": glyphs.load,
        "colour": colour,
        "at": at.tolist(),
        "along": np.round(glyphs.along, 5).ravel().tolist(),
        "tail": glyphs.tails.tolist(),
        "grow": 2.2 if glyphs.inside else 1,
    }


def _text(array: AnyArray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
