"""Folders of DICOM files, a slice each, such as scanners and archives export them.

Slices are put in order by their positions along the normal of their planes, which also give their
distance: SliceThickness is the height of the beam, and file names have no meaning.
Source: DICOM PS3.3, C.7.6.2 (image plane) and C.11.1 (modality lookup).
"""

from __future__ import annotations

import os
import stat
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.images.image import LPS, Image, check_shape, scaled

if TYPE_CHECKING:
    from pydicom.dataset import FileDataset

_MOST_FILES = 20000
_OF_A_FRAME = 1e-3
"""Deviation of directions, and of positions in units of their distance, between slices."""
_NEEDED = ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing", "Rows", "Columns")
_PREAMBLE = 128
_MARK = b"DICM"
_PLAIN = ("1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2")
"""Transfer syntaxes without compression."""
_DEFLATED = "1.2.840.10008.1.2.1.99"
_FIRST = 1 << 16
"""Bytes of an element that are read with the header: longer ones, such as pixels, wait."""


@dataclass(frozen=True)
class _Slice:
    path: Path
    header: FileDataset
    position: FloatArray
    axes: FloatArray  # rows: along a row of pixels, along a column


def read_dicom(folder: Path, series: str = "") -> Image:
    """Reads the slices of one series. Local.

    Args:
        series: A part of the description or identifier, or the number, of the series.

    Raises:
        MeshError: There are none, or several series; a slice is missing or cannot be decoded.
    """
    pydicom = _library()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # values of which nothing is read
        headers = [one for path in _files(folder) if (one := _header(pydicom, path)) is not None]
        if not headers:
            raise MeshError("the folder has no DICOM images", expected="files of one series")
        slices = [_slice(path, one) for path, one in _chosen(headers, series)]
        return _Stack(slices).image()


def _library() -> ModuleType:
    try:
        import pydicom
    except ImportError:
        raise MeshError(
            "for DICOM the Python package pydicom is missing",
            expected="apt-get install python3-pydicom, or pip install pydicom; or an image saved "
            "as .nii.gz",
        ) from None
    return pydicom


def _files(folder: Path) -> list[Path]:
    """Regular files in the folder, not below it."""
    with os.scandir(folder) as entries:
        names = [e.name for e in entries if stat.S_ISREG(e.stat(follow_symlinks=False).st_mode)]
    if len(names) > _MOST_FILES:
        raise MeshError(f"the folder has {len(names)} files", expected=f"at most {_MOST_FILES}")
    return [folder / name for name in sorted(names)]


def _header(pydicom: ModuleType, path: Path) -> tuple[Path, FileDataset] | None:
    """A file with what stands in front of its pixels; None if it is no image."""
    with path.open("rb") as file:
        if file.read(_PREAMBLE + len(_MARK))[_PREAMBLE:] != _MARK:
            return None
    try:
        meta = pydicom.filereader.read_file_meta_info(path)
        if str(meta.get("TransferSyntaxUID", "")) == _DEFLATED:
            raise ValueError("its whole content is compressed (deflated)")
        header = pydicom.dcmread(path, defer_size=_FIRST, stop_before_pixels=True)
        return (path, header) if "Rows" in header and "Columns" in header else None
    except Exception as error:  # whatever a damaged file raises in the library
        raise MeshError(f"it cannot be read: {str(error)[:200]}", where=path.name) from None


def _chosen(
    headers: Sequence[tuple[Path, FileDataset]], wanted: str
) -> list[tuple[Path, FileDataset]]:
    """The files of one series."""
    groups: dict[str, list[tuple[Path, FileDataset]]] = {}
    for path, header in headers:
        groups.setdefault(str(header.get("SeriesInstanceUID", "")), []).append((path, header))
    named = {uid: (_named(uid, files[0][1]), files) for uid, files in groups.items()}
    found = [files for uid, (_, files) in named.items() if _is_named(wanted, uid, files[0][1])]
    found = found or [files for _, files in named.values() if _matches(wanted, files[0][1])]
    if len(found) == 1:
        return found[0]
    names = [
        f"{name}, {len(files)} {'slice' if len(files) == 1 else 'slices'}"
        for name, files in named.values()
    ]
    raise MeshError(
        f"'{wanted}' means {len(found)} of the {len(names)} series"
        if wanted
        else f"the folder has {len(names)} series",
        where="series",
        expected=f"one of: {'; '.join(sorted(names)[:20])}",
    )


def _named(uid: str, header: FileDataset) -> str:
    parts = [str(header.get(key, "") or "") for key in ("SeriesNumber", "SeriesDescription")]
    text = " ".join(part for part in parts if part) or uid
    return "".join(c for c in text if c.isprintable())[:80]


def _is_named(wanted: str, uid: str, header: FileDataset) -> bool:
    """Whether a series has this identifier, number or whole name."""
    number = str(header.get("SeriesNumber", ""))
    return wanted != "" and wanted.lower() in (uid, number, _named(uid, header).lower())


def _matches(wanted: str, header: FileDataset) -> bool:
    """Whether a series has this in its description."""
    return wanted.lower() in str(header.get("SeriesDescription", "") or "").lower()


def _slice(path: Path, header: FileDataset) -> _Slice:
    frames = int(header.get("NumberOfFrames", 1) or 1)
    for key in _NEEDED:
        if frames > 1 or header.get(key) in (None, ""):
            raise MeshError(
                f"{frames} frames in one file" if frames > 1 else f"it states no {key}",
                where=path.name,
                expected="slices of a scan, a file each (an enhanced file can be saved as .nii.gz)",
            )
    try:
        position = np.array([float(x) for x in header.ImagePositionPatient])
        axes = np.array([float(x) for x in header.ImageOrientationPatient]).reshape(2, 3)
    except (TypeError, ValueError) as error:
        raise MeshError(f"its place is no number: {error}", where=path.name) from None
    if len(position) != 3 or not np.isfinite([*position, *axes.ravel()]).all():
        raise MeshError("its place is not of three numbers", where=path.name)
    return _Slice(path, header, position, axes)


class _Stack:
    """Parallel slices at equal distances."""

    def __init__(self, slices: list[_Slice]) -> None:
        first = slices[0]
        self._normal = np.cross(*first.axes)
        for one in slices:
            same = [one.header.get(key) == first.header.get(key) for key in _NEEDED[2:]]
            if abs(one.axes - first.axes).max() > _OF_A_FRAME or not all(same):
                raise MeshError(
                    f"its slice has another size, spacing or direction than {first.path.name}",
                    where=one.path.name,
                    expected="slices of one scan; scout images in a folder of their own",
                )
        self._slices = sorted(slices, key=lambda one: float(one.position @ self._normal))
        self._step = self._distance()

    def _distance(self) -> FloatArray:
        """From one slice to the next [mm], shape (3,)."""
        places = np.array([one.position for one in self._slices])
        if len(places) == 1:
            thickness = float(self._slices[0].header.get("SliceThickness", 1.0) or 1.0)
            return np.asarray(self._normal * thickness)
        along = places @ self._normal
        gaps = np.diff(along)
        step = float(np.median(gaps))
        bad = np.flatnonzero(abs(gaps - step) > 0.05 * max(step, 1e-9))
        if not step > 0 or len(bad):
            at = int(bad[0]) if len(bad) else 0
            raise MeshError(
                f"from {self._slices[at].path.name} to the next slice are {gaps[at]:.4g} mm, "
                f"between the others {step:.4g} mm",
                where=self._slices[at + 1].path.name,
                expected="all slices of the scan, each once, at equal distances",
            )
        mean = np.asarray((places[-1] - places[0]) / (len(places) - 1))
        off = abs(places - places[0] - np.outer(np.arange(len(places)), mean)).max()
        if off > 0.05 * step:
            raise MeshError(
                f"slices lie {off:.4g} mm beside the straight line through the first and the last",
                expected="a scan whose slices are not displaced",
            )
        return mean  # of a tilted gantry not along the normal: the voxels are oblique

    def image(self) -> Image:
        """The voxels, in NIfTI's frame."""
        first = self._slices[0].header
        rows, columns = int(first.Rows), int(first.Columns)
        shape = columns, rows, len(self._slices)
        most = sum(one.path.stat().st_size for one in self._slices) * 200.0
        check_shape(shape, np.dtype(np.int32), most)
        parts: list[AnyArray] = [self._values(one, (rows, columns)) for one in self._slices]
        values = np.stack([part.T for part in parts], axis=2)
        spacing = [float(x) for x in first.PixelSpacing]  # between rows, between columns
        affine = np.eye(4)
        affine[:3, 0] = self._slices[0].axes[0] * spacing[1]
        affine[:3, 1] = self._slices[0].axes[1] * spacing[0]
        affine[:3, 2] = self._step
        affine[:3, 3] = self._slices[0].position
        return Image(np.ascontiguousarray(values), LPS @ affine, LengthUnit.of(1e-3))

    def _values(self, one: _Slice, shape: tuple[int, int]) -> AnyArray:
        """The values of a slice, shape (rows, columns)."""
        pydicom = _library()
        try:
            pixels = np.asarray(pydicom.dcmread(one.path).pixel_array)
        except Exception as error:  # whatever the library or one of its decoders raises
            syntax = one.header.file_meta.get("TransferSyntaxUID")
            name = getattr(syntax, "name", "unknown")
            raise MeshError(
                f"its pixels ({name}) cannot be decoded: {' '.join(str(error).split())[:160]}",
                where=one.path.name,
                expected="the whole file, as it was written"
                if syntax in _PLAIN
                else "a series without compression: gdcmconv --raw, or dcmdjpeg of dcmtk",
            ) from None
        if pixels.shape != shape:
            raise MeshError(
                f"its pixels are of the shape {pixels.shape}",
                where=one.path.name,
                expected=f"{shape}: one slice, without colours",
            )
        slope, intercept = (
            float(one.header.get(f"Rescale{key}", other) or other)
            for key, other in (("Slope", 1.0), ("Intercept", 0.0))
        )
        return scaled(pixels, slope, intercept)
