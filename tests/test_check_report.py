"""What a check says before anything is compiled: sizes, masses, loads, free bodies, hints."""

from __future__ import annotations

import io
import json
import math
from contextlib import redirect_stdout
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import Problem, Statics, Support, compiler
from dolfin_elastic.case import Case
from dolfin_elastic.check import PartSize, Report, check, report
from dolfin_elastic.check.hints import cell_notes, part_notes, size_hints
from dolfin_elastic.check.loads import load_sums
from dolfin_elastic.check.memory import per_unknown
from dolfin_elastic.check.sums import Integrals
from dolfin_elastic.check_screen import show_check
from dolfin_elastic.errors import InputError
from dolfin_elastic.meshes import box_body, rectangle_body
from dolfin_elastic.meshes.body import Body
from dolfin_elastic.meshes.build import build_body
from dolfin_elastic.meshes.raw import RawMesh
from dolfin_elastic.solvers.assembler import Assembler
from dolfin_elastic.solvers.linear import LinearSettings, choose

COMM = MPI.COMM_WORLD
E = 1e6
RUBBER = {"law": "neo-hookean", "E": E, "nu": 0.3, "density": 1000}
ROUND_OFF = 1e-12
"""Sums of polynomials that the rules integrate exactly."""


def case(**tables: Any) -> Case:
    """A block of 2 x 1 x 3 m held at its bottom, with changes."""
    defaults: dict[str, Any] = {
        "mesh": {"box": {"size": [2, 1, 3], "cells": [2, 1, 3]}},
        "materials": {"rubber": RUBBER},
        "support": [{"on": "bottom"}],
    }
    return Case(**{**defaults, **tables})


def named(parts: tuple[PartSize, ...]) -> dict[str, PartSize]:
    return {part.name: part for part in parts}
