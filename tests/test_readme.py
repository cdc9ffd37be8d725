"""README and docs/ say nothing that does not run, and the guide leaves out no key."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from mpi4py import MPI
from pydantic import BaseModel

from dolfin_elastic import Dynamics, Gravity, LinearElastic, Problem, Statics, box_body
from dolfin_elastic.case import mesh_table, tables
from dolfin_elastic.case.case import Case
from dolfin_elastic.case.run import open_outputs
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.formula_functions import FUNCTIONS
from dolfin_elastic.core.shapes.shapes import CylinderObstacle, Plane, SphereObstacle
from dolfin_elastic.core.shapes.turn import Turn
from dolfin_elastic.mesh import Cylinder, EdgeSelector, PointSelector, Selector, Sphere
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.loads import LOADS
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.periodic import Periodic
from dolfin_elastic.model.point_mass import PointMass
from dolfin_elastic.model.supports.displacement import Support
from dolfin_elastic.model.supports.rigid_surface import Rigid
from dolfin_elastic.model.supports.springs import SUPPORTS
from dolfin_elastic.model.tie import Tie
from dolfin_elastic.results.derived.reductions import REDUCTIONS
from dolfin_elastic.results.fields import FIELDS
from dolfin_elastic.results.outputs import History, Picture
from dolfin_elastic.solvers.dynamics.schemes import SCHEMES
from dolfin_elastic.solvers.dynamics.settings import DynamicsSettings
from dolfin_elastic.solvers.eigen.settings import BucklingSettings, ModalSettings
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.statics.settings import StaticsSettings

PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    if not {"_build", "generated", "messages"} & {*path.relative_to(ROOT).parts}
}
GUIDE = "".join(text for name, text in PAGES.items() if name.startswith("docs/guide/"))
"""What people have written about the keys; the pages in docs/reference/ are made from the code."""
MODELS: list[type[BaseModel]] = [
    Case,
    mesh_table.MeshTable,
    mesh_table.Part,
    mesh_table.Box,
    mesh_table.Rectangle,
    Turn,
    Selector,
    Sphere,
    Cylinder,
    Support,
    Rigid,
    Contact,
    Plane,
    SphereObstacle,
    CylinderObstacle,
    *MATERIALS.values(),
    *LOADS.values(),
    PointMass,
    Periodic,
    StaticsSettings,
    DynamicsSettings,
    ModalSettings,
    BucklingSettings,
    LinearSettings,
    tables.Output,
    Picture,
]


def blocks(language: str, text: str = GUIDE) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_every_key(model: type[BaseModel]) -> None:
    """A new key needs a line in the guide."""
    missing = [
        name for name in model.model_fields if not re.search(rf"[`\[{{ ]{name}(?![a-z])", GUIDE)
    ]
    assert missing == []


@pytest.mark.parametrize(
    "names",
    [MATERIALS, LOADS, FIELDS, FUNCTIONS, REDUCTIONS],
    ids=["materials", "loads", "fields", "functions", "reductions"],
)
def test_every_name(names: dict[str, object]) -> None:
    """So does a new law, load, field, function or reduction."""
    assert [name for name in names if not re.search(rf"\b{re.escape(name)}\b", GUIDE)] == []


def test_selectors() -> None:
    """The examples of names by geometry are read as they stand."""
    texts = blocks("toml-part")
    assert texts
    read = tables.selectors(Selector)
    for text in texts:
        parts = tomllib.loads(text)
        assert all(read(value) for table in parts.values() for value in table.values())


def test_faces_and_smaller_elements() -> None:
    """So are those of names of CAD faces, and of sizes in places."""
    (text,) = blocks("toml-faces")
    surfaces = {n: Selector(**keys) for n, keys in tomllib.loads(text)["surfaces"].items()}
    assert all(selector.by_face for selector in surfaces.values())
    (text,) = blocks("toml-refine")
    mesh = mesh_table.MeshTable(**tomllib.loads(text)["mesh"])
    assert isinstance(mesh.refine, list) and len(mesh.refine) == 2


@pytest.mark.parametrize("kind", ["toml-surface", "toml-image"])
def test_surfaces_and_images(kind: str) -> None:
    """And those of meshes that are made of surfaces and images."""
    (text,) = blocks(kind)
    assert mesh_table.MeshTable(**tomllib.loads(text)["mesh"]).size is not None


def test_separate_parts() -> None:
    """The example of parts is solved, and its legs bear the load of the plate."""
    (text,) = blocks("toml-parts")
    case = Case.from_dict(tomllib.loads(text))
    *_, state = case.make_solver(case.make_problem(case.read_body())).steps()
    (foot,) = (r for name, r in state.reactions.items() if not name.startswith("tie"))
    np.testing.assert_allclose(foot, [0, 0, 12.0], atol=1e-9)


def test_selectors_of_edges_and_points() -> None:
    """So are those of edges and points."""
    (text,) = blocks("toml-edges")
    parts = tomllib.loads(text)
    for key, kind in (("edges", EdgeSelector), ("points", PointSelector)):
        assert all(tables.selectors(kind)(value) for value in parts[key].values())


def test_material_that_varies() -> None:
    """So is that of a material."""
    (text,) = blocks("toml-material")
    law = tables.Material.read(tomllib.loads(text)["materials"]["bone"]).law
    assert set(law.spatial_constants()) == {"E", "nu", "density"}


def test_periodic_cell() -> None:
    """And that of a cell."""
    (text,) = blocks("toml-periodic")
    assert Periodic(**tomllib.loads(text)["periodic"]).free == ((1, 1), (2, 2))


def test_tie() -> None:
    """And that of a tie."""
    (text,) = blocks("toml-tie")
    (row,) = tomllib.loads(text)["tie"]
    assert Tie(**row).label == "tie_foot"


@pytest.mark.usefixtures("serial_only")
def test_examples_run(tmp_path: Path) -> None:
    """The case and the Python programs."""
    (tmp_path / "block.toml").write_text(blocks("toml", PAGES["docs/guide/case-file.md"])[0])
    python = blocks("python", PAGES["docs/guide/python.md"])
    assert len(python) == 7
    each = "import sys\nfor code in sys.argv[1:]:\n    exec(code, {}); print(chr(12), end='')"
    done = subprocess.run(
        [sys.executable, "-c", each, *python],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr
    said = done.stdout.split("\f")
    assert "the left end carries" in said[1]
    assert float(said[2].split()[-2]) == pytest.approx(2.45e-3, abs=5e-6)
    # A beam that bends by 4 % of its length and less: 1/E, but for the square of that.
    products = [float(E) * float(u) for E, u in map(str.split, said[3].splitlines()[-2:])]
    assert products[0] == pytest.approx(products[1], rel=2e-3)
    for folder in ("block_results", "beam_results"):
        assert (tmp_path / folder / "results.xdmf").exists()


@pytest.mark.parametrize("page", PAGES)
def test_cases(page: str) -> None:
    """Blocks that begin with ```toml are TOML; those with a mesh are whole cases that can be read.

    The mesh itself is read by the tests that run them.
    """
    for text in blocks("toml", PAGES[page]):
        found = tomllib.loads(text)
        if "mesh" in found:
            assert Case.from_dict(found).to_dict()
        for table in found.get("materials", {}).values():
            assert tables.Material.read(table).law


def test_the_case_of_the_readme_is_that_of_the_guide() -> None:
    """It stands in both, and runs."""
    assert blocks("toml", PAGES["README.md"]) == blocks("toml", PAGES["docs/guide/case-file.md"])


def test_several_analyses() -> None:
    """Beside the case of the guide, in the order in which they run."""
    (text,), (first, *_) = blocks("toml-analyses"), blocks("toml", PAGES["README.md"])
    case = Case.from_dict(tomllib.loads(first) | tomllib.loads(text))
    assert [one.analysis for one in case.analyses()] == ["statics", "modal", "buckling"]


def test_the_readme_is_short() -> None:
    """What is longer belongs into the guide."""
    assert len(PAGES["README.md"].splitlines()) <= 250


@pytest.mark.parametrize("page", PAGES)
def test_links(page: str) -> None:
    """Files that a page refers to exist, and so do the headings in them.

    The pages of messages are made with the site, from their meanings.
    """
    folder = (ROOT / page).parent
    meanings = (ROOT / "docs/reference/meanings").glob("*.toml")
    made = {name for file in meanings for name in tomllib.loads(file.read_text(encoding="utf-8"))}
    missing = []
    for link in re.findall(
        r"\]\(([^):\s]+)\)", re.sub(r"```.*?```", "", PAGES[page], flags=re.DOTALL)
    ):
        file, _, heading = link.partition("#")
        target = (folder / file).resolve() if file else ROOT / page
        if target.parent == ROOT / "docs/reference/messages" and target.stem in made:
            continue
        if not target.exists() or (heading and heading not in headings(target)):
            missing.append(link)
    files = re.findall(r"`((?:docker|demos)/[\w./]+)`", PAGES[page])
    assert missing + [file for file in files if not (ROOT / file).exists()] == []


def headings(page: Path) -> list[str]:
    """Anchors of a page's headings, as GitHub and MyST make them."""
    lines = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return [re.sub(r"[^\w\- ]", "", line.lower()).replace(" ", "-") for line in lines]


def imported(name: str, code: str, folder: Path) -> ModuleType:
    """Code as the module it would be; pydantic looks names up in modules."""
    if MPI.COMM_WORLD.rank == 0:
        (folder / f"{name}.py").write_text(code)
    MPI.COMM_WORLD.barrier()
    spec = spec_from_file_location(name, folder / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def contributed(folder: Path) -> Iterator[dict[str, Any]]:
    """What the examples of CONTRIBUTING.md define; tables that they add to are put back."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    schemes, supports = dict(SCHEMES), dict(SUPPORTS)
    code = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert len(code) == 6
    names: dict[str, Any] = {}
    for number, part in enumerate(code):
        names |= vars(imported(f"contributed_{number}", part, folder))
    yield names
    for table, before in ((SCHEMES, schemes), (SUPPORTS, supports)):
        table.clear()
        table.update(before)  # type: ignore[arg-type]


def test_examples_for_contributors(
    contributed: dict[str, Any], folder: Path, comm: MPI.Comm
) -> None:
    """A law, a load and an output as CONTRIBUTING.md adds them."""
    names = contributed
    rod = box_body(size=[1, 0.1, 0.1], cells=[8, 1, 1], comm=comm)
    problem = Problem(
        rod,
        names["Foam"](mu="1 MPa", density=1000),
        supports=[Support(on="left")],
        loads=[names["Spin"](value=[0, 0, 2])],
        degree=1,
    )
    files = [names["Energies"](), History(file="table.csv")]
    with open_outputs(files, problem, folder) as writers:
        for state in Statics(problem, steps=1).steps():
            for writer in writers:
                writer.write(state)
        saved = [writer.restart_state() for writer in writers]
    # The pull at the axis is rho A w^2 L^2 / 2.
    assert state.reactions["left"][0] == pytest.approx(-1000 * 0.01 * 4 / 2, rel=1e-6)
    energies, history = (folder / name for name in ("energies.txt", "table.csv"))
    assert len(energies.read_text().splitlines()) == 2
    assert len(history.read_text().splitlines()) == 3
    comm.barrier()
    # After a restart one begins anew, and the other one continues.
    with open_outputs(files, problem, folder, saved) as writers:
        for writer in writers:
            writer.write(state)
    assert len(energies.read_text().splitlines()) == 1
    assert len(history.read_text().splitlines()) == 4


def test_constraint_of_a_contributor(contributed: dict[str, Any], comm: MPI.Comm) -> None:
    """A block whose surfaces all move by u = H X does so inside, too; its stress is homogeneous."""
    block, H = box_body(size=[1, 2, 1], cells=[2, 3, 2], comm=comm), np.diag([0.2, 0.1, 0.0])
    H[0, 1] = 0.3
    support = {"kind": "affine", "on": sorted(block.surfaces), "gradient": H.tolist()}
    law = LinearElastic(E="1 MPa", nu=0.25)
    case = Case.from_dict(
        {
            "mesh": {"box": {"size": [1, 2, 1], "cells": [2, 3, 2]}, "degree": 1},
            "materials": {"block": {"law": "linear-elastic", "E": "1 MPa", "nu": 0.25}},
            "support": [support],
        }
    )
    assert isinstance(case.support[0], contributed["AffineMotion"])
    problem = Problem(block, law, supports=case.support, degree=1)
    *_, state = Statics(problem, steps=2).steps()
    X = problem.V.tabulate_dof_coordinates()
    assert np.allclose(state.u.x.array.reshape(-1, 3), X @ H.T, atol=1e-12)
    strain = (H + H.T) / 2
    mu = lmbda = 0.4e6
    energy = mu * np.sum(strain**2) + lmbda / 2 * np.trace(strain) ** 2
    assert state.energies["strain"] == pytest.approx(2 * energy, rel=1e-12)


@pytest.mark.usefixtures("contributed")
def test_scheme_of_a_contributor(comm: MPI.Comm) -> None:
    """It moves on before it looks at forces: a body falls by n(n - 1)/2 g dt^2.

    Of a linear body it conserves what it says, to round-off; the energy of states swings.
    """
    box, dt = box_body(size=[1, 1, 1], cells=[1, 1, 1], comm=comm), 1e-3
    law = LinearElastic(E="1 MPa", nu=0.3, density=1000)
    falling = Problem(box, law, loads=[Gravity(value=[0, 0, -10])], degree=1)
    for state in Dynamics(falling, scheme="drift-kick", end=10 * dt, dt=dt, every=1).steps():
        n = state.step
        assert state.max_displacement == pytest.approx(10 * dt**2 * n * (n - 1) / 2, abs=1e-12)
        assert np.allclose(state.v.x.array.reshape(-1, 3), [0, 0, -10 * n * dt], atol=1e-11)
    motion = Dynamics(
        Problem(box, law, degree=1),
        scheme="drift-kick",
        end=0.05,
        dt=dt,
        initial_velocity=["x", 0, 0],
    )
    found = []
    for state in motion.steps():
        excess = comm.allreduce(motion._motion.scheme.conserved_excess(dt))
        found.append((state.energies["total"], state.energies["total"] + excess))
    swings = np.ptp(found, axis=0) / found[0][0]
    assert swings[1] < 1e-10 < 1e-3 < swings[0]
    with pytest.raises(InputError, match="did you mean 'drift-kick'"):
        Dynamics(falling, scheme="drift-kik", end=1.0)
