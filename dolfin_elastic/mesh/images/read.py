"""`read_image`: an image of any kind, by its suffix; a folder is one of DICOM."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from dolfin_elastic.core.errors import InputError, MeshError, nearest_file, not_shown, why_no_file
from dolfin_elastic.mesh.images.image import Image

SUFFIXES = (".nii", ".nii.gz", ".mha", ".mhd", ".vti")
_KINDS = f"{', '.join(SUFFIXES)}, or a folder of DICOM files"


def is_image(path: str | Path) -> bool:
    """Whether a name has the suffix of an image."""
    return str(path).lower().endswith(SUFFIXES)


def is_slice(path: str | Path) -> bool:
    """Whether a name has the suffix of one slice of a DICOM series."""
    return str(path).lower().endswith((".dcm", ".ima"))


def read_image(path: str | os.PathLike[str], *, series: str = "") -> Image:
    """Reads an image of voxels, in NIfTI's frame, see `Image`. Local: one rank reads.

    Args:
        path: .nii or .nii.gz; .mha or .mhd; .vti; a folder of DICOM files.
        series: Of a folder with several series, a part of the name, or the number, of the one.

    Raises:
        MeshError: It cannot be read; with the file's name.
    """
    path = Path(path)
    try:
        return _read(path, series)
    except InputError as error:
        if error.where.startswith(path.name):
            raise
        raise error.moved(lambda key: ": ".join(filter(None, [path.name, key]))) from None


def _read(path: Path, series: str) -> Image:
    name = path.name.lower()
    if path.is_dir():
        from dolfin_elastic.mesh.images.dicom import read_dicom

        return read_dicom(path, series)
    if fault := why_no_file(path, sys.maxsize):
        raise MeshError(fault)
    if not path.exists():
        raise MeshError(f"there is no image '{path}'", expected=_alike(path))
    if series:
        raise MeshError(
            "a file has one series", where="series", expected="leave it out, or name a folder"
        )
    if name.endswith((".nii", ".nii.gz")):
        from dolfin_elastic.mesh.images.nifti import read_nifti

        return read_nifti(path)
    if name.endswith((".mha", ".mhd")):
        from dolfin_elastic.mesh.images.metaimage import read_metaimage

        return read_metaimage(path)
    if name.endswith(".vti"):
        from dolfin_elastic.mesh.images.vti import read_vti

        return read_vti(path)
    if is_slice(path):
        raise MeshError("this is one slice", expected="the folder with all files of the series")
    raise MeshError(f"a {path.suffix or 'nameless'} file is no image that is read", expected=_KINDS)


def _alike(path: Path) -> str:
    if hint := not_shown(path):
        return hint
    folder = path.parent if path.parent.is_dir() else Path()
    known = [one.name for one in folder.iterdir() if is_image(one)]
    return nearest_file(path.name, known) if known else _KINDS
