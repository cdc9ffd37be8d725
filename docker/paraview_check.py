"""Compare what ParaView's readers find in a file of results with what its .xdmf holds.

python3 paraview_check.py RESULTS EXPECTED.json     each reader, in a process of its own
pvbatch paraview_check.py RESULTS EXPECTED.json READER

RESULTS is an .xdmf, .pvd or .vtkhdf file.

EXPECTED.json is what paraview_expected.py prints.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

# The readers of each kind of file, and what each calls it.
READERS = {
    ".xdmf": {"XDMFReader": "FileNames", "Xdmf3ReaderS": "FileName", "Xdmf3ReaderT": "FileName"},
    ".pvd": {"PVDReader": "FileName"},
    ".vtkhdf": {"VTKHDFReader": "FileName"},
}
# Marks of points that another piece has, too.
GHOSTS, DUPLICATE = "vtkGhostType", 1
SECONDS = 300
# Sums differ in the last digits by the order of the points.
CLOSE = {"rtol": 1e-9, "atol": 1e-12}
# The exit code of a reader that has read something else.
DIFFERENT = 3


def main() -> int:
    """Check with one reader if it is named, else start a process for each."""
    results, expected = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    if len(sys.argv) > 3:
        return check(sys.argv[3], results, json.loads(expected.read_text()))
    readers = READERS[results.suffix]
    failed = [reader for reader in readers if not passes(reader, results, expected)]
    return 1 if failed else 0


def passes(reader: str, results: Path, expected: Path) -> bool:
    """Run one reader, which may crash, and report."""
    display = ["xvfb-run", "-a"] if shutil.which("xvfb-run") else []
    command = [*display, "pvbatch", __file__, str(results), str(expected), reader]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired:
        print(f"{reader}: FAILED, no end after {SECONDS} s")
        return False
    verdict = [line for line in done.stdout.splitlines() if line.startswith(f"{reader}: ")]
    if done.returncode == 0 and verdict:
        print(*verdict, sep="\n")
        return True
    how = "" if done.returncode == DIFFERENT else f" (exit code {done.returncode})"
    print(f"{reader}: FAILED{how}", *verdict, done.stderr.strip(), sep="\n    ")
    return False


def check(name: str, results: Path, expected: dict[str, Any]) -> int:
    """Read the file with one reader, inside pvbatch."""
    from paraview import servermanager, simple

    reader = getattr(simple, name)(**{READERS[results.suffix][name]: [str(results)]})
    reader.UpdatePipelineInformation()
    times = np.atleast_1d(np.asarray(reader.TimestepValues, dtype=float))
    if len(times) != len(expected["times"]) or not np.allclose(times, expected["times"], **CLOSE):
        print(f"{name}: times {times.tolist()}, not {expected['times']}")
        return DIFFERENT
    faults = []
    for time, fields in zip(times, expected["steps"], strict=True):
        reader.UpdatePipeline(time)
        found = list(leaves(servermanager.Fetch(reader)))
        faults += [f"at t = {time}: {fault}" for fault in differences(found, expected, fields)]
    if faults:
        print(*(f"{name}: {fault}" for fault in faults), sep="\n")
        return DIFFERENT
    count, names = expected["points"], ", ".join(expected["steps"][0])
    print(f"{name}: ok, {len(times)} times, {count} points, {names}")
    return 0


def leaves(data: Any) -> Iterator[Any]:
    """The data sets of a reader's output, which may be nested blocks."""
    if not data.IsA("vtkCompositeDataSet"):
        yield data
        return
    each = data.NewIterator()
    while not each.IsDoneWithTraversal():
        yield each.GetCurrentDataObject()
        each.GoToNextItem()


def differences(
    found: list[Any], expected: dict[str, Any], fields: dict[str, Any]
) -> Iterator[str]:
    """What is wrong with one step."""
    points = sum(int(np.sum(~duplicates(data))) for data in found)
    if points != expected["points"]:
        yield f"{points} points, not {expected['points']}"
    cells = sum(data.GetNumberOfCells() for data in found)
    if cells != expected["cells"]:
        yield f"{cells} cells, not {expected['cells']}"
    for name, field in fields.items():
        values = rows(found, field["centre"], name)
        if values is None:
            yield f"no {field['centre']} field {name}"
        elif values.shape[1] != field["components"]:
            yield f"{name} has {values.shape[1]} components, not {field['components']}"
        else:
            norm = float(np.linalg.norm(values, axis=1).max())
            if not np.isclose(norm, field["max_norm"], **CLOSE):
                yield f"{name} is at most {norm}, not {field['max_norm']}"
            scale = max(1.0, field["max_norm"] * len(values))
            total = values.sum(axis=0) / scale
            if not np.allclose(total, np.asarray(field["sum"]) / scale, **CLOSE):
                yield f"{name} sums to {(total * scale).tolist()}, not {field['sum']}"


def duplicates(data: Any) -> Any:
    """Which points of a block another one has, too."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    marks = data.GetPointData().GetArray(GHOSTS)
    if marks is None:
        return np.zeros(data.GetNumberOfPoints(), dtype=bool)
    return (vtk_to_numpy(marks) & DUPLICATE) > 0


def rows(found: list[Any], centre: str, name: str) -> Any:
    """A field's values over all blocks, each point once, or None where a block lacks it."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    parts = []
    for data in found:
        held = data.GetPointData() if centre == "point" else data.GetCellData()
        values = held.GetArray(name)
        if values is None:
            return None
        table = vtk_to_numpy(values).astype(float).reshape(values.GetNumberOfTuples(), -1)
        parts.append(table[~duplicates(data)] if centre == "point" else table)
    return np.concatenate(parts) if parts else None


if __name__ == "__main__":
    sys.exit(main())
