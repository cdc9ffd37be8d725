"""Results of other programs: read, and beside those of a deck, through the command."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from helpers.decks import box, inp_text

from dolfin_elastic.case.decks.references import read_reference
from dolfin_elastic.cli import app
from dolfin_elastic.core.errors import MeshError

FRD = """    1C
    2C                             2                                     1
 -1         1 0.00000E+00 0.00000E+00 0.00000E+00
 -1         2 1.00000E+00-2.00000E+00 0.50000E+00
 -3
    1PSTEP                         1           1           1
  100CL  101 1.000000000           2                     0    1           1
 -4  DISP        4    1
 -5  D1          1    2    1    0
 -1         1 0.00000E+00 0.00000E+00 0.00000E+00
 -1         2 1.00000E-03-2.00000E-03 3.00000E-03
 -3
 -4  STRESS      6    1
 -1         1 9.00000E+00 0.00000E+00 0.00000E+00 0.00000E+00 0.00000E+00 0.00000E+00
 -3
 9999
"""
DAT = """
                        S T E P       1

     E I G E N V A L U E   O U T P U T

 MODE NO    EIGENVALUE                       FREQUENCY
                                     REAL PART            IMAGINARY PART
                           (RAD/TIME)      (CYCLES/TIME     (RAD/TIME)

      1   0.4456771E+04   0.6675905E+02   0.1062503E+02   0.0000000E+00
      2   0.4012393E+05   0.2003096E+03   0.3188026E+02   0.0000000E+00

     P A R T I C I P A T I O N   F A C T O R S

MODE NO.   X-COMPONENT     Y-COMPONENT     Z-COMPONENT

      1   0.1000000E+01   0.2000000E+01   0.3000000E+01

 displacements (vx,vy,vz) for set NALL and time  0.1000000E+01

         1  0.000000E+00  0.000000E+00  0.000000E+00
         2  5.339207E-04 -1.844545E-04  0.000000E+00

 forces (fx,fy,fz) for set NALL and time  0.1000000E+01

         1 -1.000000E+00  0.000000E+00  0.000000E+00

     B U C K L I N G   F A C T O R   O U T P U T

 MODE NO       BUCKLING
                FACTOR

      1   0.4100000E+03
"""


def test_frd(tmp_path: Path) -> None:
    """Columns touch where numbers are negative; other fields are passed over."""
    (tmp_path / "a.frd").write_text(FRD)
    reference = read_reference(tmp_path / "a.frd")
    assert reference.points[2] == [1.0, -2.0, 0.5]
    (table,) = reference.displacements
    assert table.nodes == [1, 2]
    assert table.vectors[1] == [1e-3, -2e-3, 3e-3]


def test_dat(tmp_path: Path) -> None:
    """Tables of nodes, frequencies without the factors below them, buckling factors."""
    (tmp_path / "a.dat").write_text(DAT)
    reference = read_reference(tmp_path / "a.dat")
    assert reference.modes == [[10.62503, 31.88026], [410.0]]
    assert reference.displacements[0].vectors[1] == [5.339207e-04, -1.844545e-04, 0.0]
    assert reference.forces[0].nodes == [1]


def test_csv(tmp_path: Path) -> None:
    """Columns by their headings, in any order."""
    (tmp_path / "a.csv").write_text("uz,node,ux,uy\n3,7,1,2\n")
    (table,) = read_reference(tmp_path / "a.csv").displacements
    assert (table.nodes, table.vectors) == ([7], [[1.0, 2.0, 3.0]])
    (tmp_path / "b.csv").write_text("node,uy\n7,2\n")
    (table,) = read_reference(tmp_path / "b.csv").displacements
    np.testing.assert_array_equal(table.vectors, [[np.nan, 2.0, np.nan]])


WRONG = {
    "a.frd": (FRD.replace("3.00000E-03", "3.00000X-03"), r"a\.frd:11: this line is damaged"),
    "b.dat": ("nothing\n", "it has no displacements, forces or modes"),
    "c.csv": ("node,ux\n1\n", r"c\.csv:2: this line is damaged"),
    "d.odb": ("", "results of this suffix are not read"),
    "f.csv": (f"node,ux\n1,{'1' * 200000}\n", r"f\.csv: this is no table"),
    "g.dat": (
        "displacements (vx,vy,vz) for set A and time 1.\n \xb2 1. 2. 3.\n",
        "it has no displ",
    ),
    "e.csv": ("node,ux\n1,nan\n", r"e\.csv:2: this line is damaged"),
}


@pytest.mark.parametrize("name", WRONG)
def test_damaged_results(tmp_path: Path, name: str) -> None:
    """One message with the line."""
    text, message = WRONG[name]
    (tmp_path / name).write_text(text, encoding="latin-1")
    with pytest.raises(MeshError, match=message):
        read_reference(tmp_path / name)


def deck() -> str:
    points, cells = box((10, 10, 10), (1, 1, 1))
    held = "".join(
        f"{i + 1}, {k + 1}\n" for k in range(3) for i in np.flatnonzero(points[:, k] == 0)
    )
    moved = "".join(f"{i + 1}, 3,, .01\n" for i in np.flatnonzero(points[:, 2] == 10))
    return inp_text(
        points,
        cells,
        "*MATERIAL, NAME=steel\n*ELASTIC\n210000., .3\n*SOLID SECTION, ELSET=ALL, MATERIAL=steel\n"
        f"*BOUNDARY\n{held}*STEP\n*STATIC\n*BOUNDARY\n{moved}*END STEP\n",
    )


def command(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["dolfin-elastic", *words])
    return app.guarded()


def test_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A cube that is stretched by 0.1 %, computed from its deck, beside the closed form."""
    monkeypatch.chdir(tmp_path)
    Path("cube.inp").write_text(deck())
    points, _ = box((10, 10, 10), (1, 1, 1))
    u = points * [-0.3e-3, -0.3e-3, 1e-3]
    rows = "".join(f"{i},{','.join(map(repr, map(float, v)))}\n" for i, v in enumerate(u, 1))
    Path("cube.csv").write_text("node,ux,uy,uz\n" + rows)
    assert command(monkeypatch, "import", "cube.inp") == 2
    assert not Path("cube.toml").exists()
    assert "--units mm-t-s (210 GPa)" in capsys.readouterr().err
    words = ["import", "cube.inp", "--units", "mm-t-s", "-q", "--compare", "cube.csv"]
    assert command(monkeypatch, *words) == 0
    said = capsys.readouterr().out
    found = re.search(r"largest displacement\s+\S+\s+\S+\s+(\S+)  8 nodes of 8", said)
    assert found, said
    # Exact in linear elements: what remains is rounding, over moduli of 1e11.
    assert float(found[1]) < 1e-9
    # One component alone: the others counted as zeros, which is off by 1.
    alone = "".join(f"{i},{float(v[0])!r}\n" for i, v in enumerate(u, 1))
    Path("ux.csv").write_text("node,ux\n" + alone)
    words = ["import", "cube.inp", "--units", "mm-t-s", "-q", "-o", "b.toml", "--compare", "ux.csv"]
    assert command(monkeypatch, *words) == 0
    said = capsys.readouterr().out
    found = re.search(r"largest displacement\s+\S+\s+\S+\s+(\S+)  8 nodes of 8, ux alone", said)
    assert found, said
    assert float(found[1]) < 1e-9
    assert command(monkeypatch, "import", "cube.inp", "--units", "mm-t-s") == 2
    assert "exists already" in capsys.readouterr().err


def test_what_changes_the_answer_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is written without --anyway, and then the file says what it lacks."""
    monkeypatch.chdir(tmp_path)
    Path("cube.inp").write_text(deck().replace("*SOLID", "*CREEP\n1., 2., 0.\n*SOLID"))
    words = ["import", "cube.inp", "--units", "mm-t-s"]
    assert command(monkeypatch, *words) == 2
    assert "creep is not there" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.toml"))
    assert command(monkeypatch, *words, "--anyway") == 0
    head = Path("cube.toml").read_text().partition("[mesh]")[0]
    assert "NOT CARRIED OVER, and the answer is another one:" in head
    assert "*CREEP" in head
