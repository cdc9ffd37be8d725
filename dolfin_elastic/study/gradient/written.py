"""What a gradient leaves: tables, a picture of what matters most, and fields for ParaView."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from dolfin_elastic.core.parallel import largest, on_root
from dolfin_elastic.core.si_text import quantity
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.mesh.geometry.curved import cell_volumes
from dolfin_elastic.results.files import json_data, make_folder, replace_text
from dolfin_elastic.results.writers.xdmf import write_with_fields
from dolfin_elastic.study.gradient.gradient import Found
from dolfin_elastic.study.gradient.table import GradientTable
from dolfin_elastic.study.tabled import csv_text

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
        named = {" by ".join(names): field for names, field in fields.items()}
        write_with_fields(found.problem, found.state, folder / FIELDS, named)
    return written


def largest_values(found: Found) -> list[str]:
    """The largest value of each field in words. Collective."""
    body, units = found.problem.body, {_plain(one.name): one.unit for one in found.gradients}
    lines = []
    for name, field in _fields(found).items():
        sizes = np.linalg.norm(field.values, axis=1)
        most = quantity(largest(body.comm, float(sizes.max(initial=0.0))), units[name[0]])
        over = f"m^{body.dim}" if field.centre == "cell" else "m"
        lines.append(f"{' by '.join(name)}: at most {most} per {over}")
    return lines


def _plain(name: str) -> str:
    return name.replace(":", " ")


def _fields(found: Found) -> dict[tuple[str, str], MeshField]:
    """Gradients by fields as fields of the body, by what of what. Not collective.

    Values of cells are those of all, dQ/d ln m, over the volume of the cell, so that they do not
    depend on the mesh.
    """
    body, result = found.problem.body, dict[tuple[str, str], MeshField]()
    volumes = cell_volumes(body.mesh)[: len(body.owned_cells())]
    for one in found.gradients:
        plain = _plain(one.name)
        for key, values in one.cells.items():
            result[plain, key] = MeshField("cell", (values / volumes)[:, None])
        if one.nodes is not None:
            result[plain, "shape"] = MeshField("point", np.ascontiguousarray(one.nodes))
    return result
