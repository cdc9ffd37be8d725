"""What a gradient leaves: tables, a picture of what matters most, and fields for ParaView."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.mesh.geometry.curved import cell_volumes
from dolfin_elastic.results.files import json_data, make_folder, replace_text
from dolfin_elastic.results.writers.xdmf import write_with_fields
from dolfin_elastic.study.gradient.gradient import Found
from dolfin_elastic.study.gradient.table import GradientTable
from dolfin_elastic.study.tabled import csv_text

if TYPE_CHECKING:
    pass

TABLE, SUMMARY, PLOT, FIELDS = FILES = (
    "gradient.csv",
    "gradient.json",
    "gradient.png",
    "gradient.xdmf",
)


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
    fields, written = _fields(found), [TABLE, SUMMARY]
    written += [PLOT] * table.drawable + [FIELDS] * bool(fields)

    def texts() -> None:
        make_folder(folder)
        for name in {*FILES} - {*written}:  # of an earlier gradient
            (folder / name).unlink(missing_ok=True)
        replace_text(folder / TABLE, csv_text(table.columns()))
        text = json.dumps(json_data(table.columns()), indent=2, allow_nan=False)
        replace_text(folder / SUMMARY, text + "\n")
        if table.drawable:
            table.plot(folder / PLOT)

    on_root(comm, texts)
    if fields:
        write_with_fields(found.problem, found.state, folder / FIELDS, fields)
    return written


def _fields(found: Found) -> dict[str, MeshField]:
    """Gradients by fields as fields of the body, by their names. Not collective.

    Values of cells are those of all, dQ/d ln m, over the volume of the cell, so that they do not
    depend on the mesh.
    """
    body, result = found.problem.body, dict[str, MeshField]()
    volumes = cell_volumes(body.mesh)[: len(body.owned_cells())]
    for one in found.gradients:
        plain = one.name.replace(":", " ")
        for key, values in one.cells.items():
            result[f"{plain} by {key}"] = MeshField("cell", (values / volumes)[:, None])
        if one.nodes is not None:
            result[f"{plain} by shape"] = MeshField("point", np.ascontiguousarray(one.nodes))
    return result
