"""Universal Scene Description: a surface whose points and colours change over time.

Source: Pixar, Universal Scene Description, UsdGeomMesh and UsdGeomPrimvarsAPI, 26.11.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np

from dolfin_elastic.core.errors import InputError, OutputError
from dolfin_elastic.core.startup.elsewhere import elsewhere
from dolfin_elastic.results.exports.moving import (
    FRAMES_A_SECOND,
    Moving,
    as_single,
    linear_light,
)
from dolfin_elastic.results.files import writing

PACKAGE = "usd-core==26.11"


def need_usd(file: Path) -> ModuleType:
    """The module pxr.

    Raises:
        InputError: It is not there.
    """
    try:
        with elsewhere():
            import pxr
    except ImportError as error:
        raise InputError(
            f"{file.suffix} needs the Python package usd-core ({error})",
            where=str(file),
            expected=f"pip install {PACKAGE}, or another format: .glb, .ply, .obj",
        ) from None
    return pxr


def write_usd(moving: Moving, file: Path) -> list[Path]:
    """Writes a surface with its states, in binary (.usdc) or as text (.usda). Not collective.

    Returns:
        The file.

    Raises:
        InputError: The package is not there.
        OutputError: It cannot be written.
    """
    need_usd(file)
    with elsewhere():
        from pxr import Sdf, Tf, Usd, UsdGeom, Vt
    draft = file.with_name(f".{file.stem}.part{file.suffix}")
    with writing(file):
        draft.unlink(missing_ok=True)
    try:
        stage = Usd.Stage.CreateNew(str(draft.resolve()))
        UsdGeom.SetStageUpAxis(stage, "Y" if moving.up == "y" else "Z")
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(FRAMES_A_SECOND)
        stage.SetFramesPerSecond(FRAMES_A_SECOND)
        times = [FRAMES_A_SECOND * t for t in moving.times]
        stage.SetStartTimeCode(times[0])
        stage.SetEndTimeCode(times[-1])
        mesh = UsdGeom.Mesh.Define(stage, "/body")
        stage.SetDefaultPrim(mesh.GetPrim())
        triangles = moving.body.triangles.astype(np.int32)
        counts = Vt.IntArray.FromNumpy(np.full(len(triangles), 3, dtype=np.int32))
        mesh.CreateFaceVertexCountsAttr(counts)
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(triangles.ravel()))
        mesh.CreateSubdivisionSchemeAttr("none")
        mesh.CreateDoubleSidedAttr(moving.run.dim == 2)
        colour = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
            "displayColor", Sdf.ValueTypeNames.Color3fArray, UsdGeom.Tokens.vertex
        )
        points, extent = mesh.CreatePointsAttr(), mesh.CreateExtentAttr()
        for at, state in zip(times, moving.states(), strict=True):
            places = as_single(state.places)
            light = as_single(linear_light(state.colours))
            box = np.stack([places.min(axis=0), places.max(axis=0)])
            # Programs that ask for no time see the first state.
            for when in (Usd.TimeCode.Default(), at) if at == times[0] else (at,):
                points.Set(Vt.Vec3fArray.FromNumpy(places), when)
                colour.Set(Vt.Vec3fArray.FromNumpy(light), when)
                extent.Set(Vt.Vec3fArray.FromNumpy(box), when)
        stage.GetRootLayer().Save()
        with writing(file):
            draft.replace(file)
    except Tf.ErrorException as error:
        raise OutputError(f"cannot write {file}: {error}") from None
    finally:
        draft.unlink(missing_ok=True)
    return [file]
