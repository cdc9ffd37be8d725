"""What `check` and `run` say of CAD files: their unit, how they were meshed, and nothing else."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import pytest
from helpers.cad import stack, write
from mpi4py import MPI

from dolfin_elastic import Case, run
from dolfin_elastic.case.check.report import Report, report


def case(folder: Path, **mesh: Any) -> Case:
    """A block of 12 x 4 x 3 mm under another one, 4 mm long, which is pressed on."""
    tables = {
        "mesh": {"file": "stack.step", "size": 2, **mesh},
        "surfaces": {"foot": {"plane": "z", "at": 0}, "lid": {"plane": "z", "at": 5}},
        "materials": {"steel": {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3}},
        "support": [{"on": "foot"}],
        "load": [{"kind": "force", "on": "lid", "value": [0, 0, "-2 N"]}],
        "output": {"probes": {"tip": [4, 2, 5]}},
    }
    return Case.from_dict(tables, folder)


def reported(folder: Path, **mesh: Any) -> Report:
    """The report on the two blocks."""
    write(folder / "stack.step", stack)
    return report(case(folder, **mesh))


def test_a_cad_file_has_no_note(folder: Path) -> None:
    """Each had one, "meshed by Gmsh, size as in the file", which hid those that matter."""
    found = reported(folder)
    assert found.notes == ()
    assert found.unit == "mm" and found.extent == pytest.approx((0.012, 0.004, 0.005), rel=1e-6)
    assert found.information == (
        "bodies that touch are joined: 'body1' and 'body2' (16 mm^2)",
        "meshed by Gmsh, size 2 mm",
        "lengths in mm, as the file says",
    )
    assert case(folder).read_body().num_cells == found.cells


def test_a_unit_that_the_file_does_not_have_is_noted(folder: Path) -> None:
    found = reported(folder, unit="cm")
    (note,) = found.notes
    assert "its lengths are in mm, mesh.unit that they are in cm, which counts" in note
    assert found.extent == pytest.approx((0.12, 0.04, 0.05), rel=1e-6)


@pytest.mark.long
def test_bare_numbers_are_in_the_unit_of_the_file(folder: Path) -> None:
    """Size, selectors, probes: 2, 0 and (4, 2, 5) are millimetres without `unit`."""
    write(folder / "stack.step", stack)
    *_, state = run(case(folder, size="2 mm", degree=1), output=folder / "out")
    assert state.numbers["tip_z"] < 0


def test_notes_of_the_mesh_are_warnings_of_a_run(folder: Path, caplog: Any) -> None:
    write(folder / "stack.step", stack)
    with caplog.at_level(logging.INFO, logger="dolfin_elastic"):
        next(run(case(folder, unit="cm"), output=folder / "out"))
    if MPI.COMM_WORLD.rank:
        return  # rank 0 logs for all
    levels = {r.levelno: r.getMessage() for r in caplog.records if "mesh:" in r.getMessage()}
    assert "which counts: is that meant?" in levels[logging.WARNING]
    assert "meshed by Gmsh" in levels[logging.INFO]
