"""Compare what FreeCAD finds in an .frd file with what must be there.

python3 foreign_freecad.py -- FILE EXPECTED.npz

FreeCAD's objects of results are those that its window shows.  In its units, mm and MPa, places,
displacements, their lengths and stresses must agree to 1e-6 of the largest one; all elements must
be turned as FreeCAD has them, the nodes in the middle of their edges must be there, and the names,
in which times to 0.01 s or numbers of modes stand, must be right.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.append("/usr/lib/freecad-python3/lib")
import FreeCAD

TOLERANCE = 1e-6
SIDES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
"""Corners beside the further nodes of a tetrahedron in FreeCAD."""


def main(file: Path, expected: str) -> None:
    """Opens a file and compares all states in it."""
    sys.path.append("/usr/share/freecad/Mod/Fem")
    from feminout import importCcxFrdResults

    want = np.load(expected)
    importCcxFrdResults.open(str(file))
    found = [one for one in FreeCAD.ActiveDocument.Objects if hasattr(one, "DisplacementVectors")]
    names = [one.Label for one in found]
    pairs = zip(names, want["names"].tolist(), strict=False)
    faults = [f"{name}, not {right}" for name, right in pairs if not name.startswith(right)]
    faults += [] if len(found) == len(want["names"]) else [f"{len(found)} states: {names}"]
    mesh = found[0].Mesh.FemMesh
    rows = np.array(found[0].NodeNumbers) - 1
    places = np.array([tuple(mesh.Nodes[n + 1]) for n in rows.tolist()])
    errors = {"places": relative(places, 1e3 * want["rest"][rows])}
    cells = np.array([mesh.getElementNodes(n) for n in mesh.Volumes])
    x = places[np.argsort(rows)][cells - 1]
    if (np.linalg.det(x[:, 1:4] - x[:, :1]) >= 0).any():
        faults.append("elements are turned")
    for side, node in zip(SIDES, range(4, cells.shape[1]), strict=False):
        middle = relative(x[:, node], x[:, side].mean(axis=1))
        errors["middles"] = max(errors.get("middles", 0.0), middle)
    for k, one in enumerate(found):
        u = 1e3 * want["displacement"][k][rows]
        of = {
            "displacement": (np.array([tuple(v) for v in one.DisplacementVectors]), u),
            "length": (one.DisplacementLengths, np.linalg.norm(u, axis=1)),
        }
        if "von_mises" in want:
            stress = 1e-6 * want["cauchy_stress"][k][rows]
            of["von Mises"] = (one.vonMises, 1e-6 * want["von_mises"][k][rows, 0])
            parts = [getattr(one, f"NodeStress{a}") for a in ("XX", "YY", "ZZ", "XY", "YZ", "XZ")]
            of["stress"] = (parts, stress[:, [0, 4, 8, 1, 5, 2]].T)
        for name, pair in of.items():
            errors[name] = max(errors.get(name, 0.0), relative(*pair))
    version = ".".join(FreeCAD.Version()[:3])
    print(
        f"FreeCAD {version}, {file.name}: {len(rows)} nodes, {len(cells)} elements, {len(found)} "
        f"states; off by: {', '.join(f'{name} {error:.1e}' for name, error in errors.items())}",
        *faults,
        sep="\n    ",
    )
    if faults or not max(errors.values()) < TOLERANCE:
        sys.exit(1)


def relative(found: object, want: object) -> float:
    """Largest difference over the largest value."""
    values, right = np.asarray(found, dtype=float), np.asarray(want, dtype=float)
    return float(np.abs(values - right).max() / max(np.abs(right).max(), 1e-300))


if __name__ == "__main__":
    main(Path(sys.argv[2]), sys.argv[3])
