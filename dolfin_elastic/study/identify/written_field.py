"""What the search for a field leaves: the case with it, the field, a picture, a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.si_text import literal, scaled_unit
from dolfin_elastic.core.startup.elsewhere import plain_matplotlib
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.results.files import drafted, make_folder, replace_text
from dolfin_elastic.results.writers.xdmf import write_with_fields
from dolfin_elastic.study.identify.cells import FieldFound
from dolfin_elastic.study.identify.measured import MeasuredField
from dolfin_elastic.study.identify.written import case_text, field_panel, point_rows, points_panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def write_field(found: FieldFound, folder: Path) -> list[str]:
    """Writes all files. Collective.

    Args:
        folder: Where they go; made if missing.

    Returns:
        Their names.

    Raises:
        OutputError: Something cannot be written.
    """
    comm, name = found.problem.body.comm, found.case.name
    constant = found.key.rpartition(".")[2]
    field, series = f"{constant}_found", f"{name}_field.xdmf"
    on_root(comm, lambda: make_folder(folder))
    values = MeshField("cell", np.nan_to_num(found.values)[:, None])
    write_with_fields(found.problem, found.state, folder / series, {field: values})

    def texts() -> list[str]:
        value = {"file": series, "field": field}
        text = case_text(found.case, {found.key: value}, folder)
        replace_text(folder / f"{name}.toml", text)
        replace_text(folder / f"{name}_points.csv", point_rows(found.sets, {constant: found.seen}))
        _draw(found, folder / f"{name}.png")
        return [f"{name}.toml", series, f"{name}_points.csv", f"{name}.png"]

    return on_root(comm, texts)


@plain_matplotlib()
def _draw(found: FieldFound, path: Path) -> None:
    """The field at the points of each set, and how far these are off. Not collective."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    count = len(found.sets)
    figure = Figure(figsize=(10, 4.2 * count), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(count, 2, squeeze=False)
    for (left, right), one, values in zip(axes, found.sets, found.seen, strict=True):
        assert isinstance(one.measured, MeasuredField)
        _constant_panel(figure, left, found, one.measured.points, values)
        field_panel(figure, right, one)
    figure.suptitle(literal(found.case.name))
    with drafted(path) as draft:
        figure.savefig(draft, dpi=130, format=path.suffix[1:])


def _constant_panel(
    figure: Figure, axis: Axes, found: FieldFound, points: FloatArray, values: FloatArray
) -> None:
    size, unit = scaled_unit(float(np.nanmax(values)), found.unit)
    points_panel(figure, axis, points, values / size, f"[{unit}]")
    axis.set_title(literal(found.key))
