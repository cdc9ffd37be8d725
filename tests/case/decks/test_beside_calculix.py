"""Decks computed here and by CalculiX, whose numbers stand below."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from helpers.decks import box, inp_text, numbers, quadratic

from dolfin_elastic import run
from dolfin_elastic.case.case import read_case
from dolfin_elastic.case.decks.compare import compare
from dolfin_elastic.case.decks.reading import nodes_of, read_deck
from dolfin_elastic.case.decks.references import Reference, Table
from dolfin_elastic.case.decks.units import SYSTEMS
from dolfin_elastic.case.decks.writer import case_texts
from dolfin_elastic.core.types import AnyArray

ELASTIC = "*ELASTIC\n210000., 0.3\n"
OTHERS = "*DENSITY\n7.85e-9\n*EXPANSION\n1.2e-5\n"
CLAMPED = "*BOUNDARY\nroot, 1, 3\n"
PRINT = "*NODE PRINT, NSET=tip\nU\n"
LINEAR = f"*STEP\n*STATIC\n{{}}{PRINT}*END STEP\n"


def body() -> tuple[AnyArray, AnyArray]:
    """Points and tetrahedra of a bar of 8 x 2 x 1 mm."""
    points, cells = box((8.0, 2.0, 1.0), (4, 2, 1))
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    odd = np.linalg.det(edges) < 0.0  # CalculiX needs the last corner above the others
    cells[odd] = cells[odd][:, [0, 2, 1, 3]]
    return points, cells


def bar(degree: int, more: str, law: str = ELASTIC) -> str:
    """Its deck, with the nodes at both ends and the surface of the last one."""
    points, cells = body()
    end = [
        (i + 1, side + 1)
        for i, cell in enumerate(cells)
        for side, face in enumerate(((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)))
        if (points[cell[list(face)], 0] == 8.0).all()
    ]
    if degree == 2:
        points, cells = quadratic(points, cells)
    corners = np.flatnonzero((points[:, 0] == 8.0) & np.isin(points[:, 1], (0.0, 2.0)))
    faces = "".join(f"{i}, S{side}\n" for i, side in end)
    sets = (
        f"*NSET, NSET=root\n{numbers(np.flatnonzero(points[:, 0] == 0.0))}\n"
        f"*NSET, NSET=all\n{numbers(np.arange(len(points)))}\n"
        f"*NSET, NSET=face\n{numbers(np.flatnonzero(points[:, 0] == 8.0))}\n"
        f"*NSET, NSET=tip\n{numbers(corners[np.isin(points[corners, 2], (0.0, 1.0))])}\n"
        f"*SURFACE, NAME=end, TYPE=ELEMENT\n{faces}"
    )
    material = f"*MATERIAL, NAME=m\n{law}{OTHERS}*SOLID SECTION, ELSET=ALL, MATERIAL=m\n"
    return inp_text(points, cells, sets + material + more)


COUPLED = "*COUPLING, CONSTRAINT NAME=c, REF NODE=9999, SURFACE=end\n*{}\n"


def coupled(kind: str) -> str:
    """Its deck with a force and a moment at a node beyond the end."""
    text = bar(
        2,
        COUPLED.format(kind)
        + CLAMPED
        + LINEAR.format("*CLOAD\n9999, 2, 1.e-3\n9999, 3, -1.e-3\n9999, 4, 2.e-3\n"),
    )
    return text.replace("*ELEMENT", "9999, 12., 1., 1.5\n*ELEMENT", 1)


def rigid_body() -> str:
    """The same force and moment at nodes of a rigid body."""
    text = coupled("KINEMATIC").replace("9999, 4,", "9998, 1,")
    old = "*COUPLING, CONSTRAINT NAME=c, REF NODE=9999, SURFACE=end\n*KINEMATIC\n"
    text = text.replace(old, "*RIGID BODY, NSET=face, REF NODE=9999, ROT NODE=9998\n")
    return text.replace("*ELEMENT", "9998, 12., 1., 1.5\n*ELEMENT", 1)


RUBBER = "*HYPERELASTIC, NEO HOOKE\n0.5, 0.4\n"
DECKS = {
    "cantilever": bar(
        2,
        CLAMPED + LINEAR.format("*CLOAD\ntip, 3, -1.\n") + "*STEP\n*FREQUENCY\n6\n*END STEP\n",
    ),
    "column": bar(2, CLAMPED + "*STEP\n*BUCKLE\n2\n*CLOAD\ntip, 1, -100.\n*END STEP\n"),
    "linear bar": bar(
        1,
        CLAMPED + LINEAR.format("*DLOAD\nALL, GRAV, 9810., 0., 0.6, -0.8\n*DSLOAD\nend, P, -5.\n"),
    ),
    "warm bar": bar(
        2,
        "*INITIAL CONDITIONS, TYPE=TEMPERATURE\nall, 20.\n"
        + CLAMPED
        + LINEAR.format("*TEMPERATURE\nall, 120.\n"),
    ),
    "rotor": bar(
        2, CLAMPED + LINEAR.format("*DLOAD\nALL, CENTRIF, 1.e6, 0., 0., 0., 0., 0., 1.\n")
    ),
    "rigid end": coupled("KINEMATIC\n1, 3"),
    "rigid body": rigid_body(),
    "averaged end": coupled("DISTRIBUTING\n1, 6"),
    "rubber": bar(
        2,
        CLAMPED + f"*STEP, NLGEOM\n*STATIC\n0.25, 1.\n*CLOAD\ntip, 3, 0.002\n{PRINT}*END STEP\n",
        RUBBER,
    ),
    "bent bar": bar(
        2, CLAMPED + f"*STEP, NLGEOM\n*STATIC\n0.25, 1.\n*CLOAD\ntip, 3, 40.\n{PRINT}*END STEP\n"
    ),
}


@dataclass(frozen=True)
class Theirs:
    """What CalculiX 2.20 has computed.

    Attributes:
        tip: Displacements of the nodes of the set "tip", by their numbers.
        modes: Frequencies or buckling factors.
        digits: Largest difference, over the largest number.
    """

    tip: dict[int, list[float]]
    modes: tuple[float, ...] = ()
    digits: float = 5e-7


# Seven digits are printed, so that linear bodies agree to half of the last one. Other differences:
# the mass of C3D10 and forces of rotation have four points of integration there, which do not
# integrate them exactly (`test_frequencies_by_their_mass` shows this of the mass), and so has the
# energy of rubber. An average there has forces at nodes, here a traction, which differs near by.
THEIRS = {
    "cantilever": Theirs(
        {
            5: [-0.001751195, 3.261569e-05, -0.01854945],
            15: [-0.001769721, 1.067107e-05, -0.0185549],
            20: [0.001760568, 1.617931e-05, -0.01855585],
            30: [0.001765985, 2.297098e-05, -0.01855545],
        },
        (13435.48, 25564.07, 80797.14, 81577.7, 130851.7, 163442.6),
    ),
    "column": Theirs(
        {},
        (3.495296, 13.10413),
    ),
    "linear bar": Theirs(
        {
            5: [0.0001906391, 3.130984e-05, 4.01624e-05],
            15: [0.0001837017, 1.702655e-05, 3.976588e-05],
            20: [0.0001854994, 3.151069e-05, 3.302204e-05],
            30: [0.0001785704, 1.721943e-05, 3.262097e-05],
        },
    ),
    "warm bar": Theirs(
        {
            5: [0.01004138, -0.00116732, -0.0005402097],
            15: [0.009983891, 0.001232725, -0.000549524],
            20: [0.00995639, -0.001162689, 0.0006597957],
            30: [0.009898869, 0.001237427, 0.0006504704],
        },
    ),
    "rotor": Theirs(
        {
            5: [1.542895e-05, 5.808733e-05, -1.979459e-07],
            15: [-3.050504e-06, 5.812224e-05, -3.712263e-07],
            20: [1.546624e-05, 5.81759e-05, -1.937278e-07],
            30: [-3.012114e-06, 5.821474e-05, -3.739956e-07],
        },
        digits=1e-4,
    ),
    "rigid end": Theirs(
        {
            5: [-4.317371e-07, 2.217324e-06, -8.329086e-06],
            15: [-1.324019e-06, 2.217324e-06, -7.962264e-06],
            20: [1.323531e-06, 2.033913e-06, -8.329086e-06],
            30: [4.312491e-07, 2.033913e-06, -7.962264e-06],
        },
    ),
    "rigid body": Theirs(
        {
            5: [-4.317371e-07, 2.217324e-06, -8.329086e-06],
            15: [-1.324019e-06, 2.217324e-06, -7.962264e-06],
            20: [1.323531e-06, 2.033913e-06, -8.329086e-06],
            30: [4.312491e-07, 2.033913e-06, -7.962264e-06],
        },
    ),
    "averaged end": Theirs(
        {
            5: [-4.362009e-07, 2.203621e-06, -8.340102e-06],
            15: [-1.32681e-06, 2.244101e-06, -7.964758e-06],
            20: [1.342101e-06, 2.053855e-06, -8.353017e-06],
            30: [4.283879e-07, 2.01457e-06, -7.957251e-06],
        },
        digits=1e-3,
    ),
    "rubber": Theirs(
        {
            5: [-0.1976907, -0.004724983, 2.36851],
            15: [-0.1931716, -0.004540129, 2.365304],
            20: [-0.638844, -0.001283993, 2.266495],
            30: [-0.6384081, -0.001647748, 2.260753],
        },
        digits=1e-5,
    ),
    "bent bar": Theirs(
        {
            5: [0.02837717, -0.0009900059, 0.7406359],
            15: [0.02901986, -0.0002559337, 0.740929],
            20: [-0.1107111, -0.0003636418, 0.7311102],
            30: [-0.1110256, -0.0007276862, 0.7310563],
        },
    ),
}
HERE = (13435.1767, 25563.5394, 80769.0878, 81513.0932, 130781.6648, 163439.3395)
"""Frequencies of the cantilever with a mass that is exact."""


@pytest.mark.long
@pytest.mark.parametrize("name", DECKS)
def test_numbers_of_calculix(tmp_path: Path, name: str) -> None:
    """From the deck to displacements, frequencies and factors, all through `import`."""
    path, theirs = tmp_path / "deck.inp", THEIRS[name]
    path.write_text(DECKS[name])
    deck = read_deck(path)
    assert not deck.left_out
    (text,) = case_texts(deck, "deck", "mm-t-s").values()
    (tmp_path / "deck.toml").write_text(text)
    case = read_case(tmp_path / "deck.toml")
    list(run(case))
    folders = [one.results_folder() for one in case.analyses()]
    table = Table(list(theirs.tip), list(theirs.tip.values()))
    modes = [*(HERE if name == "cantilever" else theirs.modes)]
    reference = Reference(
        displacements=[table] if theirs.tip else [], modes=[modes] if modes else []
    )
    rows = compare(folders, reference, deck, nodes_of(path), SYSTEMS["mm-t-s"])
    assert len(rows) == bool(theirs.tip) + len(theirs.modes)
    assert [row for row in rows if row.difference > theirs.digits] == []


# --- frequencies with the mass as CalculiX integrates it ---

PAIRS = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
FOUR = np.full((4, 4), 0.13819660112501053) + np.eye(4) * (1.0 - 4 * 0.13819660112501053)
"""Barycentric coordinates of the four points, whose weights are equal."""


def conical(count: int) -> tuple[AnyArray, AnyArray]:
    """Barycentric points, shape (n, 4), and weights of sum 1, exact to degree 2 count - 3."""
    x, w = np.polynomial.legendre.leggauss(count)
    a, b, c = (one.ravel() for one in np.meshgrid(*[(x + 1) / 2] * 3, indexing="ij"))
    weights = np.einsum("i,j,k->ijk", w, w, w).ravel() * (1 - a) ** 2 * (1 - b)
    rows = [a, (1 - a) * b, (1 - a) * (1 - b) * c]
    return np.stack([*rows, 1 - sum(rows)], axis=1), weights / weights.sum()


def mass_and_stiffness(bary: AnyArray, weights: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Of the clamped bar of C3D10, by textbook formulas. Shapes (n, n)."""
    corners, four = body()
    points, cells = quadratic(corners, four)
    edges = points[cells[:, 1:4]] - points[cells[:, :1]]
    volumes = np.linalg.det(edges) / 6
    slopes = np.linalg.inv(edges).transpose(0, 2, 1)  # of L1, L2 and L3
    slopes = np.concatenate([-slopes.sum(axis=1, keepdims=True), slopes], axis=1)
    L, size = bary, 3 * len(points)
    N = np.concatenate([L * (2 * L - 1), *[4 * L[:, [i]] * L[:, [j]] for i, j in PAIRS]], axis=1)
    at = np.zeros((len(L), 10, 4))
    at[:, range(4), range(4)] = 4 * L - 1
    for k, (i, j) in enumerate(PAIRS, start=4):
        at[:, k, i], at[:, k, j] = 4 * L[:, j], 4 * L[:, i]
    G = np.einsum("qak,ckx->cqax", at, slopes)
    E, nu = 210000.0, 0.3
    mu, lmbda = E / 2 / (1 + nu), E * nu / (1 + nu) / (1 - 2 * nu)
    one, w = np.eye(3), np.einsum("q,c->cq", weights, volumes)
    inner = np.einsum("cq,cqax,cqbx->cab", w, G, G)
    K = lmbda * np.einsum("cq,cqax,cqby->caxby", w, G, G)
    K += mu * np.einsum("cq,cqay,cqbx->caxby", w, G, G) + mu * np.einsum(
        "cab,xy->caxby", inner, one
    )
    M = 7.85e-9 * np.einsum("cq,qa,qb,xy->caxby", w, N, N, one)
    rows = (3 * cells[:, :, None] + np.arange(3)).reshape(len(cells), -1)
    free = np.flatnonzero(np.repeat(points[:, 0] > 0.0, 3))
    result = []
    for local in (M, K):
        whole = np.zeros((size, size))
        np.add.at(whole, (rows[:, :, None], rows[:, None, :]), local.reshape(len(cells), 30, 30))
        result.append(whole[np.ix_(free, free)])
    return result[0], result[1]


def test_frequencies_by_their_mass() -> None:
    """Six digits of CalculiX with its four points, and ours with a mass that is exact."""
    from scipy.linalg import eigh

    exact, K = mass_and_stiffness(*conical(4))
    reduced, _ = mass_and_stiffness(FOUR, np.full(4, 0.25))
    here, there = (
        np.sqrt(eigh(K, M, eigvals_only=True, subset_by_index=[0, 5])) / 2 / np.pi
        for M in (exact, reduced)
    )
    np.testing.assert_allclose(there, THEIRS["cantilever"].modes, rtol=1e-6)
    np.testing.assert_allclose(here, HERE, rtol=1e-8)
