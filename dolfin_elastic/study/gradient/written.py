"""What a gradient leaves: tables, a picture of what matters most, and fields for ParaView."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.si_text import quantity
from dolfin_elastic.core.startup.elsewhere import plain_matplotlib
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.mesh.geometry.curved import cell_volumes
from dolfin_elastic.results.files import drafted, json_data, make_folder, replace_text
from dolfin_elastic.results.finished.curves import literal
from dolfin_elastic.results.writers.xdmf import XdmfWriter
from dolfin_elastic.study.gradient.gradient import Found
from dolfin_elastic.study.gradient.table import GradientTable, relative
from dolfin_elastic.study.tabled import csv_text

if TYPE_CHECKING:
    from dolfin_elastic.case.case import Case

TABLE, SUMMARY, PLOT, FIELDS = FILES = (
    "gradient.csv",
    "gradient.json",
    "gradient.png",
    "gradient.xdmf",
)
_MOST = 12
"""Bars of one number."""
_INK = "#1f5f8b"


def default_folder(case: Case) -> Path:
    """Folder of the results of `gradient`."""
    folder = case.whole.results_folder()
    return folder.with_name(f"{folder.name.removesuffix('_results')}_gradient")


def write_gradient(found: Found, folder: Path) -> list[str]:
    """Writes all files. Collective.

    Args:
        folder: Where they go; made if missing.

    Returns:
        Their names.

    Raises:
        OutputError: Something cannot be written.
    """
    table, comm = GradientTable(found.gradients), found.problem.body.comm
    names, written = _field_names(found), [TABLE, SUMMARY]
    written += [PLOT] * _shown(table) + [FIELDS] * bool(names)

    def texts() -> None:
        make_folder(folder)
        for name in {*FILES} - {*written}:  # of an earlier gradient
            (folder / name).unlink(missing_ok=True)
        replace_text(folder / TABLE, csv_text(table.columns()))
        text = json.dumps(json_data(table.columns()), indent=2, allow_nan=False)
        replace_text(folder / SUMMARY, text + "\n")
        if _shown(table):
            draw(table, folder / PLOT)

    on_root(comm, texts)
    if names:
        writer = XdmfWriter(found.problem, folder / FIELDS, fields=("displacement", *names))
        writer.write(found.state)
        writer.close()
    return written


def _field_names(found: Found) -> list[str]:
    """Makes the gradients by fields fields of the body; their names. Collective.

    Values of cells are those of all, dQ/d ln m, over the volume of the cell, so that they do not
    depend on the mesh.
    """
    body, names = found.problem.body, list[str]()
    volumes = cell_volumes(body.mesh)[: len(body.owned_cells())]
    for one in found.gradients:
        plain = one.name.replace(":", " ")
        for key, values in one.cells.items():
            names.append(f"{plain} by {key}")
            body.fields[names[-1]] = MeshField("cell", (values / volumes)[:, None])
        if one.nodes is not None:
            names.append(f"{plain} by shape")
            body.fields[names[-1]] = MeshField("point", np.ascontiguousarray(one.nodes))
    return names


def _shown(table: GradientTable) -> bool:
    return any(math.isfinite(relative(one, d)) for one in table.gradients for d in one.by)


@plain_matplotlib()
def draw(table: GradientTable, path: Path) -> None:
    """Bars: by how much a number changes where a parameter is 1 % larger. Not collective.

    Raises:
        OutputError: It cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = [
        (one, sorted(rows, key=lambda row: abs(row[1]))[-_MOST:])
        for one in table.gradients
        if (rows := [(d.key, r) for d in one.by if math.isfinite(r := relative(one, d))])
    ]
    heights = [0.5 + 0.32 * len(rows) for _, rows in panels]
    figure = Figure(figsize=(7, 0.6 + sum(heights) + 0.5 * len(panels)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
    for axis, (one, rows) in zip(axes, panels, strict=True):
        axis.barh([literal(key) for key, _ in rows], [r for _, r in rows], color=_INK, height=0.6)
        axis.axvline(0.0, color="0.3", linewidth=0.8)
        axis.set_title(literal(f"{one.name} = {quantity(one.value, one.unit)}"), fontsize=10)
        axis.margins(x=0.2)
        for side in ("top", "right", "left"):
            axis.spines[side].set_visible(False)
        for place, (_, r) in enumerate(rows):
            axis.annotate(
                f"{r:+.2g} %" if r else "0",
                (r, place),
                xytext=(4 if r >= 0 else -4, 0),
                textcoords="offset points",
                va="center",
                ha="left" if r >= 0 else "right",
                fontsize=8,
            )
    axes[-1].set_xlabel("change [%] where the parameter is 1 % larger")
    with drafted(path) as draft:
        figure.savefig(draft, format="png", dpi=130)
