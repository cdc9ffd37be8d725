"""What a run notes of its model."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.annulus import annulus
from mpi4py import MPI

from dolfin_elastic import Case
from dolfin_elastic.case.model_record import model_record


def test_volume_of_curved_cells() -> None:
    """A quarter of an annulus, radii 1 and 2, of two cells round the arc.

    Arcs are parabolas, which leaves 8e-4; chords would leave a tenth.
    """
    case = Case(
        mesh={"rectangle": {"size": [1, 1], "cells": [1, 1]}},
        materials={"steel": {"law": "neo-hookean", "E": 1.0, "nu": 0.3}},
    )
    found = model_record(case, annulus(MPI.COMM_WORLD, 2), (), (), {})
    mesh = found["mesh"]
    assert isinstance(mesh, dict)
    assert mesh["volume"] == pytest.approx(0.75 * np.pi, rel=1e-3)
