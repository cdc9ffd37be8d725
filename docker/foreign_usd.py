"""Compare what USD finds in an exported stage with what must be there.

python3 foreign_usd.py -- FILE EXPECTED.npz

All validators of usd-core must be content.  Places must agree to half the last digit of numbers of
four bytes, colours to 1e-6, times to 1e-12 s; without a time the first state is seen.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom, UsdValidation

PLACES, COLOURS, TIMES = 2.0**-24, 1e-6, 1e-12


def main(file: Path, expected: str) -> None:
    """Opens a file and compares all states in it."""
    want = np.load(expected)
    stage = Usd.Stage.Open(str(file))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = UsdValidation.ValidationContext(validators).Validate(stage)
    faults = [f"{one.GetName()}: {one.GetMessage()}" for one in found]
    mesh = UsdGeom.Mesh(stage.GetDefaultPrim())
    colour = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("displayColor")
    counts, indices = mesh.GetFaceVertexCountsAttr().Get(), mesh.GetFaceVertexIndicesAttr().Get()
    right, why = UsdGeom.Mesh.ValidateTopology(indices, counts, len(want["nodes"]))
    faults += [] if right else [why]
    samples = mesh.GetPointsAttr().GetTimeSamples()
    rate = stage.GetTimeCodesPerSecond()
    times = want["times"] - want["times"][0]
    errors = np.array([np.abs(np.array(samples) / rate - times).max(), 0.0, 0.0])
    ends = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    faults += [] if ends == (samples[0], samples[-1]) else [f"start and end are {ends}"]
    srgb = want["colours"]
    light = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    places = (want["rest"] + want["displacement"])[:, want["nodes"]]
    metres = UsdGeom.GetStageMetersPerUnit(stage)
    for at, state in [(Usd.TimeCode.Default(), 0), *((t, k) for k, t in enumerate(samples))]:
        seen, shown = mesh.GetPointsAttr().Get(at), colour.Get(at)
        box = UsdGeom.BBoxCache(at, ["default"]).ComputeWorldBound(mesh.GetPrim()).GetRange()
        if seen is None or shown is None or box.IsEmpty():
            faults.append(f"nothing is there at {at}")
            continue
        edges = [places[state].min(axis=0), places[state].max(axis=0)]
        off = (
            np.abs(np.array(seen) * metres - places[state]),
            np.abs(np.array(shown) - light[state]),
        )
        boxed = np.abs(np.array([box.GetMin(), box.GetMax()]) * metres - edges)
        errors = np.maximum(errors, [0.0, max(off[0].max(), boxed.max()), off[1].max()])
    version = ".".join(map(str, Usd.GetVersion()[1:]))
    print(
        f"USD {version}, {file.name}: {len(want['nodes'])} points, {len(samples)} states: times "
        f"off by {errors[0]:.1e} s, places by {errors[1]:.1e} m, colours by {errors[2]:.1e}; "
        f"up {UsdGeom.GetStageUpAxis(stage)}; {len(validators)} validators",
        *faults,
        sep="\n    ",
    )
    size = np.abs(places).max()
    if faults or (errors > [TIMES, PLACES * max(size, 1.0), COLOURS]).any():
        sys.exit(1)


if __name__ == "__main__":
    main(Path(sys.argv[2]), sys.argv[3])
