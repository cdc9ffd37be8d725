"""C files of the package under address and undefined-behaviour sanitisers, on small random input.

Arrays are exactly as long as the prototypes say, and patterns of matrices are full, so that loops
reach the last entry of each: one entry beyond is found.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest
from helpers.c_calls import Values, arguments, compile_with_sanitisers, run
from helpers.native_sizes import SIZES
from mpi4py import MPI

from dolfin_elastic.core.jit.vectorise import LANES
from dolfin_elastic.core.native.functions import prototypes, read

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="C alone")

KERNEL = """
#define LANES {lanes}
#include "lanes.h"
#define ARGUMENTS 7
#if LANES > 1
OF_ONE(fabs)
#define fabs_lanes(x) each_fabs(SPREAD(x))
#endif
static void touch(lanes* A, int64_t entries, const lanes* w, int64_t packed, const lanes* c,
                  const lanes* y)
{{
  lanes sum = c[0] + y[3 * NG - 1] + w[0] + w[packed - 1];
  for (int64_t i = 0; i < entries; i++)
    A[i] += sum;
}}
#undef TABULATE
#define TABULATE(A, w, c, y) ((void)kernel, touch(A, {entries}, w, BS * NW, c, y))
"""
"""Reads and writes what a kernel may."""

Call = tuple[str, Values]
RNG = np.random.default_rng(3)


def shuffled(rows: int, count: int) -> np.ndarray:
    """All of `count` numbers in each row."""
    return np.stack([RNG.permutation(count) for _ in range(rows)])


def full(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Where rows begin, and their columns: all."""
    return np.arange(rows + 1) * columns, np.tile(np.arange(columns), rows)


def half(owned: int, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns of a matrix by the half of its blocks, see halves.h."""
    rows = [np.arange(i, nodes) for i in range(owned)]
    return np.cumsum([0, *map(len, rows)]), np.concatenate(rows)


def places_of_half(one: np.ndarray, two: np.ndarray, owned: int, nodes: int) -> np.ndarray:
    """Where the blocks of two nodes stand in the half."""
    start, _ = half(owned, nodes)
    row = np.minimum(one, two)
    return start[np.minimum(row, owned)] + np.abs(one - two)


def of_cells(sizes: dict[str, int], lanes: int) -> Iterator[Call]:
    for count in (1, LANES + 3):
        values = {"kernel": 1, "count": count, "every": count, "points": sizes["NG"]}
        values |= {"cells": RNG.permutation(count), "corners": shuffled(count, sizes["NG"])}
        values |= {"dofs": shuffled(count, sizes["NW"]), "entries": sizes["BS"] * sizes["NW"]}
        values |= {"packed": sizes["BS"] * sizes["NW"], "first": 0, "others": 0}
        values |= {"known": 2, "size": 11}
        for name in ("add_vector", "add_scalar", "evaluate"):
            yield name, values


def of_tangents(sizes: dict[str, int], lanes: int) -> Iterator[Call]:
    dim, nodes, pressures = sizes["DIM"], sizes["ND"], sizes["NP"]
    entries, owned = dim * nodes + pressures, nodes - 1
    start, columns = full(entries, entries)
    half_start, half_columns = half(owned, nodes)
    for count in (1, LANES + 3):
        chosen = shuffled(count, nodes)
        first = chosen * dim
        if pressures:
            first = np.hstack([first, dim * nodes + shuffled(count, pressures)])
        values = {"count": count, "every": count, "points": sizes["NG"], "known": 2}
        values |= {"cells": RNG.permutation(count), "corners": shuffled(count, sizes["NG"])}
        values |= {"dofs": shuffled(count, sizes["NW"]), "entries": entries, "rows": entries}
        values |= {"nodes": first // sizes["STRIDE"], "start": start, "columns": columns}
        values |= {"places": np.repeat(first[:, None], first.shape[1], axis=1)}
        values |= {"fixed": RNG.integers(0, 2, entries)}
        values |= {"packed": sizes["BS"] * sizes["NW"], "first": 0, "others": 0}
        upper = np.triu_indices(nodes)
        one, two = chosen[:, upper[0]], chosen[:, upper[1]]
        far_start, far_columns = full(1, nodes)
        halved = {"owned": owned, "start": half_start, "columns": half_columns, "ghosts": 1}
        halved |= {"places": np.where(np.minimum(one, two) < owned, np.abs(one - two), 0)}
        halved |= {"far_start": far_start, "far_columns": far_columns}
        yield "find_places", values
        for kernel in (1,) if lanes > 1 else (0, 1):
            given = {"kernel": kernel, "given": 0 if kernel else count}
            yield "add_tangent", values | given
            yield "add_product", values | given
            if sizes["SYMMETRIC"] and not pressures:
                yield "add_half", values | given | halved
        if not pressures:
            yield "find_upper_places", values | halved


def of_roots(sizes: dict[str, int], lanes: int) -> Iterator[Call]:
    z, place = sizes["N"] * sizes["NN"], sizes["BS"] * sizes["NW"]
    for count in (1, LANES + 3):
        values = {"kernel": 1, "count": count, "every": count, "points": sizes["NG"]}
        values |= {"cells": RNG.permutation(count), "corners": shuffled(count, sizes["NG"])}
        values |= {"dofs": shuffled(count, sizes["NW"]), "entries": place}
        values |= {"packed": place + z, "first": 0, "others": 0, "known": 2, "place": place}
        values |= {"variable": np.zeros(sizes["N"]), "rows": count * sizes["NN"]}
        values |= {"list": np.arange(count * sizes["NN"]), "enough": [1e-9]}
        yield "solve", values


def of_steps(sizes: dict[str, int], lanes: int) -> Iterator[Call]:
    dim = sizes["DIM"]
    for count in (1, LANES + 3):
        values = {"kernel": 1, "count": count, "every": count, "points": dim + 1}
        values |= {"cells": RNG.permutation(count), "corners": shuffled(count, dim + 1)}
        values |= {"dofs": shuffled(count, dim + 1), "entries": dim * (dim + 1)}
        values |= {"packed": dim * (dim + 1), "first": 0, "others": 0, "known": 2, "size": 18}
        yield "add_steps", values | {"variables": 0, "accept": 1}
    for accept in (0, 1, 2):
        yield "collect", {"nodes": 5, "accept": accept}


def of_extremes(sizes: dict[str, int], lanes: int) -> Iterator[Call]:
    values = {"count": 3, "points": sizes["NG"], "entries": sizes["DIM"] * sizes["ND"]}
    values |= {"corners": shuffled(3, sizes["NG"]), "nodes": shuffled(3, sizes["ND"])}
    for linear in (0, 1):
        yield "extremes", values | {"linear": linear}


def of_halves(nodes: int, owned: int) -> dict[str, object]:
    """A matrix by the half of its blocks, and by all of them."""
    start, columns = half(owned, nodes)
    every, full_columns = full(owned, nodes)
    row, column = np.divmod(np.arange(owned * nodes), nodes)
    ours = column < owned  # also below the diagonal
    source = np.where(ours, places_of_half(row, column, owned, nodes), 0)
    source = np.where(ours, source, start[row] + column - row)
    values = {"start": start, "columns": columns, "stored": start[-1], "full": every}
    return values | {"full_columns": full_columns, "source": source, "nodes": nodes, "n": owned}


def of_symmetric(sizes: dict[str, int], lanes: int) -> Iterator[Call]:
    owned, dim = 4, sizes["DIM"]
    values = of_halves(6, owned)
    products = ("product", "product_eight", "rounded_product")
    yield from ((name, values) for name in (*products, "take_diagonal"))
    for count in (3, 8):
        for name in ("side_by_side", "one_below_the_other"):
            yield name, values | {"count": count, "n": 13}
    yield "put_diagonal", values | {"count": dim * owned, "entries": RNG.permutation(dim * owned)}
    places = [0, -1, values["stored"] - 1]
    yield "add_blocks", values | {"count": 3, "places": places}
    yield "rows_in_full", values | {"first": 1, "count": owned - 1}
    yield "count_in_full", values
    yield "columns_in_full", values
    yield from of_mass(dim)


def of_mass(dim: int) -> Iterator[Call]:
    """Of four owned nodes and two ghosts, whose rows have all columns."""
    owned, nodes = 4, 6
    start, columns = half(nodes, nodes)
    half_start, half_columns = half(owned, nodes)
    far, far_columns = full(nodes - owned, nodes)
    begins, numbers = full(dim * nodes, dim * nodes)
    values = {"n": nodes, "start": start, "columns": columns, "fixed": np.arange(dim * nodes) % 2}
    halved = {"owned": owned, "half": half_start, "half_columns": half_columns}
    halved |= {"ghosts": nodes - owned, "far": far, "far_columns": far_columns}
    rows = {"rows": dim * nodes, "begins": begins, "numbers": numbers}
    rows |= {"entries": RNG.permutation(dim * nodes)}
    yield "add_mass_product", values
    yield "add_mass_product_eight", values
    yield "add_mass_to_half", values | halved
    yield "add_mass_to_rows", values | rows


def of_multigrid(sizes: dict[str, int], lanes: int) -> Iterator[Call]:
    dim, modes = sizes["DIM"], sizes["MODES"]
    rows, nodes, groups = 4, 6, 3
    start, columns = full(rows, nodes)
    p_start, p_columns = full(nodes, groups)
    c_start, c_columns = full(groups, groups)
    values = {"n": rows, "nodes": nodes, "groups": groups, "start": start, "columns": columns}
    values |= {"p_start": p_start, "p_columns": p_columns, "c_start": c_start}
    values |= {"c_columns": c_columns, "owned": rows, "member": np.arange(nodes) % groups}
    values |= {"aggregates": groups, "own": groups, "most": groups, "count": rows}
    values |= {"mark": np.full(nodes, -1), "place": np.full(nodes, -1), "size": groups}
    values |= {"side": np.zeros(nodes), "numbers": np.arange(nodes)}
    signs = np.where(RNG.integers(0, 2, rows * nodes) > 0, 1.0, -1.0)
    values |= {"strong": signs * RNG.uniform(0.1, 1.0, rows * nodes)}
    from_one = values | {"first": 1, "n": rows - 1}
    halves = values | of_halves(nodes, rows)
    yield "aggregate", values
    yield "count_smoothed", values
    yield "transpose", values | {"size": nodes}
    P = {"a_start": start, "a_columns": columns, "rows": nodes, "b_start": p_start}
    P |= {"b_columns": p_columns, "n": groups, "most": groups * groups}
    yield "most_of_product", values | P
    for halved in (0, 1):
        yield "product_pattern", values | P | {"halved": halved}
    yield "count_in_full", halves
    yield "side_by_side", values | {"count": 3, "n": 13}
    yield "one_below_the_other", values | {"count": 3, "n": 13}
    yield "columns_in_full", halves
    for R in (dim, modes):
        size = {"R": R, "C": R}
        own, far = rows * R, 2 * R
        entries = {"own": own, "far": far, "size": nodes, "node": np.arange(own) // R}
        entries |= {"far_node": rows + np.arange(far) // R, "component": np.arange(own) % R}
        entries |= {"far_component": np.arange(far) % R}
        for name, width in (("", own), ("far_", far)):
            at, of = full(rows * R, width)
            entries |= {f"{name}start": at, f"{name}columns": of}
        yield "count_blocks", values | size | entries
        yield "fill_blocks", values | size | entries | {"block_start": start}
        for name in ("take_diagonal", "connections"):
            yield name, from_one | size
        for name in ("invert_blocks", "times_diagonal", "product"):
            yield name, values | size
        for name in ("smooth_first", "smooth"):
            yield name, values | size
            yield f"{name}_eight", values | size
        yield "rows_of_half", halves | size | {"first": 1, "count": rows - 1}
        yield "product_of_half", halves | size
        for name in ("smooth_of_half", "smooth_of_half_eight"):
            yield name, halves | size
    for R, C in ((dim, dim), (dim, modes), (modes, modes)):
        size = {"R": R, "C": C}
        for name in ("hold_fixed", "fill_smoothed", "galerkin"):
            yield name, from_one | size
        for name in ("orthonormalise", "in_single_precision", "into_single_precision"):
            yield name, values | size
        for name in ("restrict_residual", "prolong"):
            yield name, values | size
            yield f"{name}_eight", values | size
        halved = values | halves | size
        for name in ("restrict_residual_of_half", "restrict_residual_of_half_eight"):
            yield name, halved


def of_patches(sizes: dict[str, int], lanes: int) -> Iterator[Call]:
    dim, nodes, corners, count, pairs = sizes["DIM"], sizes["ND"], sizes["NG"], 3, 6
    values = {"count": count, "cells": RNG.permutation(count), "every": count, "width": 7}
    values |= {"geometry": shuffled(count, corners), "nodes": corners, "vertices": dim + 1}
    values |= {"corners": shuffled(count, dim + 1), "edges": np.arange(2 * nodes) % (dim + 1)}
    for name in ("add_spread", "add_products", "add_gains", "add_moments", "take_nodal"):
        yield name, values
    products = np.tile(np.eye(sizes["NM"]), (count, 1, 1))
    products[1], products[2] = 0.0, 1.0  # no monomial, and one
    yield "invert_products", values | {"products": products, "limit": [1e12]}
    yield "add_nodal", values | {"nodes": shuffled(count, nodes), "rows": nodes}
    values |= {"points": 4, "pairs": pairs, "width": 6 + 2 * pairs + 1}
    for weighted, layout in product((0, 1), ((5, 1, 1), (1, 0, 0))):
        found = dict(zip(("stride", "first", "step"), layout, strict=True))
        yield "add_errors", values | found | {"weighted": weighted}


def of_thickness(sizes: dict[str, int], lanes: int) -> Iterator[Call]:
    corners, count = sizes["DIM"] + 1, 3
    values = {"count": count, "width": corners, "points": corners, "rows": corners, "degree": 3}
    values |= {"geometry": shuffled(count, corners), "vertices": shuffled(count, corners)}
    for name in ("take_volumes", "add_cells", "step", "rounded_step", "next_polynomial"):
        yield name, values
    yield "at_cells", values


def of_triangles(sizes: dict[str, int], lanes: int) -> Iterator[Call]:
    """Boxes that all points and rays meet, so that each leaf is looked at."""
    leaves, count = 2, 5
    triangles = sizes["LEAF"] * leaves - 1
    values = {"count": count, "triangles": triangles, "leaves": leaves, "curved": triangles}
    values |= {"boxes": np.tile([-1.0, -1.0, -1.0, 3.0, 3.0, 3.0], 2 * leaves - 1)}
    values |= {"order": np.minimum(np.arange(triangles + 1), triangles - 1)}
    for name in ("find_nearest", "find_backs"):
        yield name, values


CALLS = {
    "cells.c": of_cells,
    "extremes.c": of_extremes,
    "multigrid.c": of_multigrid,
    "patches.c": of_patches,
    "roots.c": of_roots,
    "steps.c": of_steps,
    "symmetric.c": of_symmetric,
    "tangent.c": of_tangents,
    "thickness.c": of_thickness,
    "triangles.c": of_triangles,
}
OF_SEVERAL = ("cells.c", "roots.c", "steps.c", "tangent.c")
"""Files that include cells.h."""


def macros(sizes: dict[str, int]) -> dict[str, int]:
    """Of lengths, as the files define them by their sizes."""
    found = dict(sizes)
    if dim := sizes.get("DIM"):
        found |= {"SQUARE": dim * dim, "NC": dim + 1, "ROW": 8 if dim == 3 else 4}
    if "NP" in sizes:
        couplings = 0 if sizes["NP"] == 0 else 2 - sizes["SYMMETRIC"]
        pairs = dim * (dim + 1) // 2 if sizes["SYMMETRIC"] else dim * dim
        found |= {"NODES": sizes["ND"] + sizes["NP"], "UPPER": sizes["ND"] * (sizes["ND"] + 1) // 2}
        found["MODULI"] = (pairs + couplings) * dim * dim + (sizes["NP"] > 0)
    return found


def text_of(file: str, sizes: dict[str, int], lanes: int) -> str:
    """A file with its sizes; what `macros` says of it is compared with its own."""
    entries = {"tangent.c": "NQ * MODULI", "roots.c": "NQ * N * (1 + N)", "steps.c": "size"}.get(
        file, "1"
    )
    header = KERNEL.format(lanes=lanes, entries=entries)
    found = "".join(f"#define {name} {size}\n" for name, size in sizes.items())
    found += read(file, {"kernel.h": header})
    for name, value in macros(sizes).items():
        found += f'#ifdef {name}\n_Static_assert({name} == {value}, "{name}");\n#endif\n'
    return found


def calls(file: str, text: str, sizes: dict[str, int], lanes: int) -> list:
    """Every function of a file, at least once."""
    known = macros(sizes)
    found = [(n, arguments(text, n, known, v)) for n, v in CALLS[file](sizes, lanes)]
    missing = set(prototypes(text)) - {name for name, _ in found} - {"width"}
    if sizes.get("NP"):
        missing -= {"add_half", "find_upper_places"}  # of displacements alone
    if not sizes.get("SYMMETRIC", 1):
        missing -= {"add_half"}
    assert not missing
    return found


CASES = [
    pytest.param(file, sizes, lanes, id=f"{file}-{lanes}-{number}")
    for file in SIZES
    for lanes in ((1, LANES) if file in OF_SEVERAL else (1,))
    for number, sizes in enumerate(SIZES[file])
]


@pytest.mark.sample(10)
@pytest.mark.parametrize(("file", "sizes", "lanes"), CASES)
def test_no_error_of_memory(file, sizes, lanes, tmp_path):
    text = text_of(file, sizes, lanes)
    library = compile_with_sanitisers(text, tmp_path)
    assert run(library, calls(file, text, sizes, lanes)) == ""


LINEAR = {"DIM": 3, "ND": 4, "NDP": 4, "NG": 4, "NQ": 1, "SYMMETRIC": 1}
LINEAR |= {"NP": 0, "STRIDE": 3, "NW": 4, "BS": 3}

FAULTS = [
    ("cells.c", "a < NW; a++)\n        for", "a <= NW; a++)\n        for", "buffer-overflow"),
    ("cells.c", "m < NG", "m <= NG", "buffer-overflow"),
    ("cells.c", "*out +=", "out[1] +=", "buffer-overflow"),
    ("extremes.c", "least[c] =", "least[c + 1] =", "buffer-overflow"),
    ("extremes.c", "nodes[c * ND + a]", "nodes[c * ND + a + 1]", "buffer-overflow"),
    ("symmetric.c", "y[DIM * j + c] += m", "y[DIM * j + c + 1] += m", "buffer-overflow"),
    ("symmetric.c", "y[DIM * i + c] += sum", "y[DIM * i + c + 1] += sum", "buffer-overflow"),
    ("multigrid.c", "next[columns[k]]++]", "next[columns[k]]++ + 1]", "buffer-overflow"),
    ("patches.c", "sum[width] +=", "sum[width + 1] +=", "buffer-overflow"),
    ("patches.c", "shape[q * ND + k]", "shape[q * ND + k + 1]", "buffer-overflow"),
    ("symmetric.c", "diagonal[i * DIM + r]", "diagonal[i * DIM + r + 1]", "buffer-overflow"),
    ("symmetric.c", "j = columns[k];", "j = columns[k + 1];", "buffer-overflow"),
    ("symmetric.c", "entries[m] / DIM", "entries[m] / (DIM - DIM)", "division by zero"),
    ("tangent.c", "product[node[a] + i] +=", "product[node[a] + i + 1] +=", "buffer-overflow"),
    ("tangent.c", "m->weights[q]", "m->weights[q + 1]", "buffer-overflow"),
    ("tangent.c", "fixed[nodes[a] + i]", "fixed[nodes[a] + i + 1]", "buffer-overflow"),
    ("thickness.c", "volumes[c] = fabs(det)", "volumes[c + 1] = fabs(det)", "buffer-overflow"),
    ("thickness.c", "inverse[n]", "inverse[n + 1]", "buffer-overflow"),
    ("triangles.c", "{corners + 9 * order[k],", "{corners + 9 * order[k + 1],", "buffer-overflow"),
    ("triangles.c", "lengths[i] = INF", "lengths[i + 1] = INF", "buffer-overflow"),
]
"""One entry beyond, read and written, and one undefined result."""


@pytest.mark.sample(5)
@pytest.mark.parametrize(
    ("file", "text", "fault", "found", "lanes"),
    [
        pytest.param(*fault, lanes, id=f"{fault[0]}-{lanes}-{number}")
        for number, fault in enumerate(FAULTS)
        for lanes in ((1, LANES) if fault[0] in OF_SEVERAL else (1,))
    ],
)
def test_one_entry_beyond_is_found(file, text, fault, found, lanes, tmp_path):
    """In a copy of the text."""
    sizes = LINEAR if file in ("tangent.c", "extremes.c") else SIZES[file][-1]
    whole = text_of(file, sizes, lanes)
    assert text in whole
    library = compile_with_sanitisers(whole.replace(text, fault, 1), tmp_path)
    assert found in run(library, calls(file, whole, sizes, lanes))
