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
from dolfin_elastic.results.writers.xdmf import XdmfWriter
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
    names, written = _field_names(found), [TABLE, SUMMARY]
    written += [PLOT] * table.drawable + [FIELDS] * bool(names)

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
