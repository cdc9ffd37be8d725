"""What is new touches a file of its own and one row: examples of CONTRIBUTING.md, put into a copy.

The copy is then a package like ours: `check`, `look`, `run`, `report` and `schema` show what was
added, though nothing of them was edited.  A ring as an obstacle is added in `core/test_shapes.py`.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from helpers.processes import of_copy

LAWS, LOADS = "model/materials/registry.py", "model/loads/__init__.py"
FILES = {
    "class Foam": "model/materials/laws/foam.py",
    "class Spin": "model/loads/spin.py",
    "class AffineMotion": "model/supports/affine_motion.py",
    "class DriftKick": "solvers/dynamics/explicit/drift_kick.py",
    "class Energies": "results/writers/energies.py",
    "DEVIATION = ": "results/derived/deviation.py",
}
"""Example to the file in which it stands."""
ROWS = {
    LAWS: [('    "gent": "Gent",\n', '    "foam": "Foam",\n')],
    LOADS: [
        ("import Pressure as Pressure\n", "from dolfin_elastic.model.loads.spin import Spin\n"),
        ("        Growth,\n    )\n}\n", 'LOADS["spin"] = Spin\n'),
    ],
    "model/supports/springs.py": [
        (
            '    "dashpot": Dashpot,\n}\n',
            "from dolfin_elastic.model.supports.affine_motion import AffineMotion\n"
            'SUPPORTS["affine"] = AffineMotion\n',
        )
    ],
    "results/outputs.py": [
        (
            "from dolfin_elastic.results.writers.history import HistoryWriter\n",
            "from dolfin_elastic.results.writers.energies import Energies\n",
        ),
        ('    "msh": Msh,\n', '    "energies": Energies,\n'),
    ],
    "results/derived/reductions.py": [
        (
            "from dolfin_elastic.core.types import FloatArray\n",
            "from dolfin_elastic.results.derived.deviation import DEVIATION\n",
        ),
        (
            '    "percentile:95": Reduction(_percentiles, limits=(0, 100)),\n',
            '    "deviation": DEVIATION,\n',
        ),
    ],
    "solvers/dynamics/schemes.py": [
        (
            '    "central-differences": ExplicitRow(CentralDifferences),\n}\n',
            "from dolfin_elastic.solvers.dynamics.explicit.drift_kick import DriftKick\n"
            'SCHEMES["drift-kick"] = ExplicitRow(DriftKick)\n',
        )
    ],
}
"""File of a table to the lines behind which a row, and the import that it needs, are put."""
CASE = """
[mesh]
box = {size = [1, 0.1, 0.1], cells = [8, 1, 1]}
degree = 1
[materials.wheel]
law = "foam"
mu = "1 MPa"
density = "1000 kg/m^3"
[[support]]
on = "left"
[[load]]
kind = "spin"
value = [0, 0, 2]
"""
STRETCHED = """
[mesh]
box = {size = [1, 1, 1], cells = [1, 1, 1]}
degree = 1
[materials.block]
law = "linear-elastic"
E = "1 MPa"
nu = 0.25
[[support]]
on = ["left", "right"]
kind = "affine"
gradient = [[0.2, 0, 0], [0, 0, 0], [0, 0, 0]]
"""
MEASURED = (
    STRETCHED
    + """
[output]
formats = ["energies", "xdmf"]
probes.side = {on = "front", values = ["deviation"]}
"""
)
FALLING = """
[mesh]
box = {size = [1, 1, 1], cells = [1, 1, 1]}
degree = 1
[materials.block]
law = "linear-elastic"
E = "1 MPa"
nu = 0.3
density = 1000
[[load]]
kind = "gravity"
value = [0, 0, -10]
[dynamics]
scheme = "drift-kick"
end = "10 ms"
dt = "1 ms"
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of the package to which the examples have been added."""
    folder = tmp_path_factory.mktemp("seams")
    package = folder / "dolfin_elastic"
    shutil.copytree(ROOT / "dolfin_elastic", package, ignore=shutil.ignore_patterns("__pycache__"))
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for block in re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        file = next((file for name, file in FILES.items() if name in block), None)
        if file is not None:  # its row stands in the file of the table
            lines = [line for line in block.splitlines() if not TABLE.search(line)]
            (package / file).write_text("\n".join(lines))
    for file, rows in ROWS.items():
        table = (package / file).read_text()
        for before, row in rows:
            assert table.count(before) == 1
            table = table.replace(before, before + row)
        (package / file).write_text(table)
    return folder


TABLE = re.compile(r"\b(?:SCHEMES|SUPPORTS)\b")


def tried(
    folder: Path, case: str, sentence: str = "", *further: str
) -> tuple[str, np.ndarray, str, list[str]]:
    """What `check` says, the history of the run, the text of the page of a case, and more.

    Args:
        sentence: Is in these, and in what `look` lists.
        further: Commands whose output comes last; all end with code 0.
    """
    (folder / "case.toml").write_text(case)
    shutil.rmtree(folder / "case_results", ignore_errors=True)
    commands = ("check case.toml", "look case.toml", "run case.toml -q", "report case_results")
    said = of_copy(folder, *commands, *further)
    assert all(one.startswith("0\n") for one in said), said
    history = np.genfromtxt(folder / "case_results/history.csv", delimiter=",", names=True)
    page = (folder / "case_results/report.html").read_text()
    checked, looked, _, _, *more = said
    assert all(sentence in text for text in (checked, looked, page))
    return checked, history, page, more


@pytest.mark.long
def test_a_law_and_a_load(copy: Path) -> None:
    """The pull at the axis of a rod that spins is rho A w^2 L^2/2."""
    said = "spin about the origin with (0, 0, 2) 1/s"
    checked, history, page, more = tried(copy, CASE, said, "schema", "materials")
    assert "foam" in checked
    assert re.search(r"\bspin\b", checked)
    assert history["reaction_left_x"][-1] == pytest.approx(-1000 * 0.01 * 4 / 2, rel=1e-6)
    assert "foam" in page and "400 kPa" not in page and "1 MPa" in page
    assert re.search(r"\bspin\b", page)
    schema, materials = more
    assert '"foam"' in schema and '"spin"' in schema
    assert "foam" in materials


@pytest.mark.long
def test_a_constraint(copy: Path) -> None:
    """A block between ends that stay as wide as they are: psi = (mu + lambda/2) e^2."""
    moved = "moved with the gradient ((0.2, 0, 0), (0, 0, 0), (0, 0, 0))"
    checked, history, _, _ = tried(copy, STRETCHED, moved)
    assert "affine" in checked
    assert history["strain_energy"][-1] == pytest.approx(0.5 * 1.2e6 * 0.04, rel=1e-9)


@pytest.mark.long
def test_an_output_and_a_quantity(copy: Path) -> None:
    """A line of energies a step, and how unevenly u_x = 0.2 x is spread: 0.2/sqrt(12)."""
    goal = "converge case.toml --until 'deviation displacement_x on front' 1%"
    _, history, page, (converged,) = tried(copy, MEASURED, "", goal)
    found = float(history["side_displacement_deviation_x"][-1])
    assert found == pytest.approx(0.2 / np.sqrt(12), rel=1e-9)
    lines = (copy / "case_results/energies.txt").read_text().splitlines()
    assert len(lines) == len(np.atleast_1d(history))
    assert f"'strain': {history['strain_energy'][-1]:.6g}"[:12] in lines[-1]
    assert "energies" in page
    assert re.search(r"Side displacement deviation</td><td>x <data[^>]*>57\.74 mm<", page)
    assert "reached" in converged
    wrong = {"energies": "energy", "deviation": "deviations"}
    for right, word in wrong.items():
        (copy / f"{right}.toml").write_text(MEASURED.replace(f'"{right}"', f'"{word}"'))
    checks = of_copy(copy, *(f"check {right}.toml" for right in wrong))
    for right, said in zip(wrong, checks, strict=True):
        assert f"did you mean '{right}'" in said


@pytest.mark.long
def test_a_scheme(copy: Path) -> None:
    """It moves on before it looks at forces: a body falls by n(n - 1)/2 g dt^2."""
    checked, history, page, _ = tried(copy, FALLING)
    assert "dynamics by drift-kick" in checked and "by the scheme drift-kick" in page
    n = round(history["t"][-1] / 1e-3)
    assert history["max_displacement"][-1] == pytest.approx(1e-5 * n * (n - 1) / 2, abs=1e-12)
