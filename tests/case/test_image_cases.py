"""What `look` and `check` tell of cases with images and strengths."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.images import write_dicom, write_nifti
from mpi4py import MPI

from dolfin_elastic import Case
from dolfin_elastic.case.check.materials import material_constants
from dolfin_elastic.case.check.rest import read_body
from dolfin_elastic.case.look.image import look_at_image
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.si_text import natural


def case(**more: Any) -> Case:
    tables: dict[str, Any] = {
        "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}},
        "materials": {"bone": {"law": "linear-elastic", "E": 1e9, "nu": 0.3}},
        "support": [{"on": "left"}],
    }
    return Case.from_dict({**tables, **more})


def test_values_of_an_image(tmp_path: Path) -> None:
    """Voxels of 1 x 2 x 3 mm: 3 of 24 are 7; a grey image has no list."""
    values = np.zeros((2, 3, 4), dtype=np.int16)
    values[0, 0, :3] = 7
    affine = np.diag([1.0, 2.0, 3.0, 1.0])
    found = look_at_image(write_nifti(tmp_path / "a.nii.gz", values, affine))
    rows = [(row.value, row.voxels, row.volume) for row in found.values]
    assert rows == [(0.0, 21, pytest.approx(126.0)), (7.0, 3, pytest.approx(18.0))]
    assert (found.shape, found.unit) == ((2, 3, 4), "mm")
    assert found.spacing == pytest.approx((1.0, 2.0, 3.0))
    grey = np.arange(512, dtype=np.int16).reshape(8, 8, 8)
    assert look_at_image(write_nifti(tmp_path / "b.nii", grey, affine)).values == ()


def test_values_of_a_folder_of_slices(tmp_path: Path) -> None:
    """Of the series that is chosen; a slice alone names the folder."""
    pytest.importorskip("pydicom")
    for series, name, value in (("1.2.3", "soft", 4), ("1.2.4", "bone", 9)):
        values = np.full((2, 3, 4), value, dtype=np.int16)
        write_dicom(tmp_path / "scan", values, np.eye(4), series=series, description=name)
    with pytest.raises(InputError, match="scan: series: the folder has 2 series"):
        look_at_image(tmp_path / "scan")
    found = look_at_image(tmp_path / "scan", series="bone")
    assert [(row.value, row.voxels) for row in found.values] == [(9.0, 24)]
    assert found.source == "scan"
    with pytest.raises(InputError, match="this is one slice; the folder with all files"):
        look_at_image(min((tmp_path / "scan").iterdir()))


def test_a_missing_image_is_one_error() -> None:
    """Its field, which is missing for that, was another error, of the material."""
    bone = {"law": "linear-elastic", "E": {"field": "E", "unit": "MPa"}, "nu": 0.3}
    wrong = case(materials={"bone": bone}, fields={"E": {"image": "none.nii.gz"}})
    with pytest.raises(InputError, match="there is no image") as error:
        read_body(wrong, MPI.COMM_SELF)
    assert len(error.value.each) == 1


def test_strengths_have_units() -> None:
    """They were numbers in Pa without a word of it; strains have none."""
    law = {"law": "linear-elastic", "E": "70 GPa", "nu": 0.2}
    glass = {**law, "allowable": {"tension": "30 MPa", "compression": 3e8}}
    bone = {
        **law,
        "allowable": {
            "criterion": "largest-strain",
            "axis": "z",
            "along": {"tension": 0.0073},
            "shear": 0.01,
        },
    }
    (line,) = material_constants(case(materials={"a": glass}))
    assert "tension 30 MPa, compression 300 MPa" in line
    (line,) = material_constants(case(materials={"a": bone}))
    assert "tension 0.0073" in line
    assert "Pa" not in line.partition("allowable")[2]


def test_names_are_sorted_by_their_numbers() -> None:
    names = ["patch 10", "patch 2", "10", "patch 1", "2", "m²", "1"]  # ² is a digit, and no number
    assert sorted(names, key=natural) == ["1", "2", "10", "m²", "patch 1", "patch 2", "patch 10"]
