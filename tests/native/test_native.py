"""C files of the package: no warning, and no array that is shorter than its prototype says."""

from __future__ import annotations

import subprocess
from pathlib import Path

import ffcx
import numpy as np
import pytest
from helpers.native_sizes import SIZES
from mpi4py import MPI

from dolfin_elastic import NeoHookean, Problem, box_body
from dolfin_elastic.core.jit import cell_integrals, compile_c, options
from dolfin_elastic.core.jit.vectorise import LANES, kernel_of_one_cell
from dolfin_elastic.core.native import functions
from dolfin_elastic.core.native.functions import length_of
from dolfin_elastic.solvers.assembly.assembler import in_cells

COMM = MPI.COMM_WORLD
FOLDER = Path(functions.__file__).parent

ONE = kernel_of_one_cell(7)
SEVERAL = f"""
#define LANES {LANES}
#include "lanes.h"
OF_ONE(fabs)
#define fabs_lanes(x) each_fabs(SPREAD(x))
static void tabulate(lanes* A, const lanes* w, const lanes* c, const lanes* y)
{{
  A[0] = w[0] * c[0] * y[0];
}}
#define TABULATE(...) ((void)kernel, tabulate(__VA_ARGS__))
"""


def test_every_file_has_sizes():
    assert sorted(SIZES) == sorted(file.name for file in FOLDER.glob("*.c"))


@pytest.mark.skipif(COMM.size > 1, reason="compiles only")
@pytest.mark.sample(14)
@pytest.mark.parametrize(
    ("file", "sizes", "kernel"),
    [
        pytest.param(file, sizes, kernel, id=f"{file}-{name}-{number}")
        for file in SIZES
        for name, kernel in (("one", ONE), ("several", SEVERAL))
        if kernel is ONE or file in ("cells.c", "roots.c", "steps.c", "tangent.c")
        for number, sizes in enumerate(SIZES[file])
    ],
)
def test_no_warnings(file, sizes, kernel):
    flags = ["-O2", "-march=native", "-Wno-psabi", "-Wall", "-Wextra", "-Werror"]
    macros = "".join(f"#define {name} {size}\n" for name, size in sizes.items())
    text = macros + functions.read(file, {"kernel.h": kernel})
    command = ["gcc", *flags, "-c", "-x", "c", "-o", "/dev/null", "-"]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("file", SIZES)
def test_each_array_names_its_length(file):
    """And each of what it names is an earlier parameter or a macro."""
    for parameters in functions.prototypes(functions.read(file, {"kernel.h": ONE})).values():
        names = [one.name for one in parameters]
        assert len(set(names)) == len(names)


def test_lengths():
    arguments = (4, np.array([0, 2, 7]), 3)
    length = length_of("ROW * (start[k + 1 - k] + n / 2)", ["n", "start", "k"], {"ROW": 8})
    with pytest.raises(IndexError):
        length_of("start[k + 1]", ["n", "start", "k"], {})(arguments)
    assert length(arguments) == 8 * (2 + 2)
    for bad in ("other", "f(n)", "n if n else 1", "n ** 2", "1.5"):
        with pytest.raises(ValueError, match="no length"):
            length_of(bad, ["n"], {})


def test_pointers_without_a_length_are_refused():
    with pytest.raises(ValueError, match=r"const double\* x is neither"):
        functions.prototypes("int64_t f(int64_t n, const double* x)\n{\n")


def test_short_arrays_are_refused():
    """Of each array one entry less than what its prototype says, by the argument before it."""
    functions = compile_c(COMM, "symmetric.c", {"DIM": 2}, options(COMM))
    start, columns = np.array([0, 2, 3]), np.array([0, 1, 1], dtype=np.int32)
    high, low = (np.ones(13, dtype=np.float32) for _ in range(2))
    arrays = {"start": start, "columns": columns, "high": high, "low": low}
    arrays |= {"x": np.ones(4), "y": np.empty(4)}

    def product(**changed):
        a = {**arrays, **changed}
        matrix = (a["start"], a["columns"], a["high"], a["low"])
        return functions.call("product", 2, *matrix, 2, a["x"], a["y"])

    assert product() == 0
    np.testing.assert_array_equal(arrays["y"], [8.0, 8.0, 8.0, 8.0])
    for name, array in arrays.items():
        with pytest.raises(ValueError, match=f"{name}: an array of {len(array) - 1} entries"):
            product(**{name: array[:-1].copy()})
    with pytest.raises(TypeError, match="x: an array of float32 is none of float64"):
        product(x=np.ones(4, dtype=np.float32))
    with pytest.raises(TypeError, match="x: the entries"):
        product(x=np.ones(8)[::2])


@pytest.mark.parametrize("degree", [1, 2])
def test_lanes_are_made_of_the_code_of_this_ffcx(degree, monkeypatch):
    """Else many cells are computed one by one: slower by half or more, and nothing says so."""
    monkeypatch.setattr(cell_integrals, "MANY_CELLS", 0)
    body = box_body(size=(1.0, 1.0, 1.0), cells=(1, 1, 2))
    problem = Problem(body, NeoHookean(E=1.0, nu=0.3), degree=degree)
    weak_form = problem.weak_form
    for form in (weak_form.residual, weak_form.strain_energy):
        cells, _ = in_cells(problem, form)
        widths = [one.loops.call("width") for one in cells._integrals]
        assert widths == [LANES], f"FFCx {ffcx.__version__} writes what `vectorise` does not know"
