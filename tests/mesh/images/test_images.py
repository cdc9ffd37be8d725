"""Images of voxels: the same body from every format, and what damaged files of strangers say."""

from __future__ import annotations

import gzip
import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.images import (
    OBLIQUE,
    write_dicom,
    write_metaimage,
    write_nifti,
    write_vti,
)

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.images import image as image_module
from dolfin_elastic.mesh.images.read import read_image

VALUES = np.random.default_rng(1).integers(-1000, 2000, (5, 4, 6)).astype(np.int16)
Write = Callable[[Path], Path]


def nothing(folder: Path) -> Path:
    (folder / "empty").mkdir()
    return folder / "empty"


WRITTEN: dict[str, Write] = {
    "nii": lambda f: write_nifti(f / "a.nii", VALUES, OBLIQUE),
    "nii.gz": lambda f: write_nifti(f / "a.nii.gz", VALUES, OBLIQUE, scale=(1.0, 0.0)),
    "nii, big end first": lambda f: write_nifti(f / "a.nii", VALUES, OBLIQUE, order=">"),
    "mha": lambda f: write_metaimage(f / "a.mha", VALUES, OBLIQUE),
    "mha, packed": lambda f: write_metaimage(f / "a.mha", VALUES, OBLIQUE, packed=True),
    "mhd": lambda f: write_metaimage(f / "a.mhd", VALUES, OBLIQUE, file="a.raw"),
    "vti": lambda f: write_vti(f / "a.vti", VALUES, OBLIQUE),
    "vti, cells": lambda f: write_vti(f / "a.vti", VALUES, OBLIQUE, cells=True),
    "dicom": lambda f: write_dicom(f / "scan", VALUES + 1024, OBLIQUE, scale=(1.0, -1024.0)),
}
BOX = np.diag([0.5, 0.5, 1.25, 1.0])
"""Affine whose axes are at right angles: DICOM has no others, but between slices."""


@pytest.mark.parametrize("kind", WRITTEN)
def test_formats_agree(kind: str, tmp_path: Path) -> None:
    """Values are equal, places to round-off of what the format stores (NIfTI: 4 bytes)."""
    if kind == "dicom":
        pytest.importorskip("pydicom")
    image = read_image(WRITTEN[kind](tmp_path))
    assert image.values.dtype == np.int16
    np.testing.assert_array_equal(image.values, VALUES)
    np.testing.assert_allclose(image.affine, OBLIQUE, atol=3e-6)
    assert (image.unit is None) == kind.startswith("vti")
    assert image.unit is None or image.unit.metres == 1e-3


def test_whole_numbers_remain(tmp_path: Path) -> None:
    """Slope and intercept: whole ones keep labels whole; others give 4-byte numbers."""
    whole = read_image(write_nifti(tmp_path / "a.nii", VALUES, BOX, scale=(2.0, -24.0)))
    assert whole.values.dtype == np.int16
    np.testing.assert_array_equal(whole.values, 2 * VALUES - 24)
    real = read_image(write_nifti(tmp_path / "b.nii", VALUES, BOX, scale=(0.1, 0.0)))
    assert real.values.dtype == np.float32
    np.testing.assert_allclose(real.values, 0.1 * VALUES, rtol=2e-7)


def test_quaternion(tmp_path: Path) -> None:
    """Half a turn about z, and a mirrored third axis: x and y change sign, z by qfac."""
    numbers = (0.0, 0.0, 1.0, 1.0, 2.0, 3.0, -1.0, 0.5, 0.75, 2.0)
    image = read_image(write_nifti(tmp_path / "a.nii", VALUES, BOX, quaternion=numbers))
    expected = np.diag([-0.5, -0.75, -2.0, 1.0])
    expected[:3, 3] = 1.0, 2.0, 3.0
    np.testing.assert_allclose(image.affine, expected, atol=1e-7)


def test_against_nibabel(tmp_path: Path) -> None:
    """An independent reader finds the same."""
    nibabel = pytest.importorskip("nibabel")
    for name, turned in {"a": (), "q": (0.1, 0.2, 0.3, 4, 5, 6, -1, 1, 2, 3)}.items():
        path = tmp_path / f"{name}.nii.gz"
        write_nifti(path, VALUES, OBLIQUE, scale=(0.5, 3.0), quaternion=turned)
        other, own = nibabel.load(path), read_image(path)
        np.testing.assert_allclose(own.affine, other.affine, atol=1e-6)
        np.testing.assert_allclose(own.values, other.get_fdata(), rtol=1e-6)


def test_flat_images(tmp_path: Path) -> None:
    assert read_image(write_nifti(tmp_path / "a.nii", VALUES[:, :, 0], BOX)).values.shape == (
        5,
        4,
        1,
    )


def test_units(tmp_path: Path) -> None:
    """Unknown ones are asked for, with the size that tells what they are."""
    image = read_image(write_nifti(tmp_path / "a.nii", VALUES, BOX, unit=0))
    with pytest.raises(MeshError, match="does not say the unit.*the image is 2.5 x 2 x 7.5"):
        image.metres()
    np.testing.assert_allclose(image.metres(LengthUnit.of(1e-3))[:3, :3], 1e-3 * BOX[:3, :3])
    np.testing.assert_allclose(
        image.corners[[0, -1]], [[-0.25, -0.25, -0.625], [2.25, 1.75, 6.875]]
    )


def test_series(tmp_path: Path) -> None:
    """Two in one folder are named; a part of a name chooses."""
    pytest.importorskip("pydicom")
    write_dicom(tmp_path, VALUES, BOX, series="1.2.3", description="soft")
    write_dicom(tmp_path, VALUES + 7, BOX, series="1.2.4", description="bone")
    with pytest.raises(MeshError, match=r"2 series.*7 bone, 6 slices; 7 soft, 6 slices"):
        read_image(tmp_path)
    np.testing.assert_array_equal(read_image(tmp_path, series="bone").values, VALUES + 7)
    write_dicom(tmp_path, VALUES + 1, BOX, series="1.2.5", description="soft 2")
    np.testing.assert_array_equal(read_image(tmp_path, series="7 soft").values, VALUES)
    with pytest.raises(MeshError, match="'soft' means 2 of the 3 series"):
        read_image(tmp_path, series="soft")
    with pytest.raises(MeshError, match="'air' means 0 of the 3 series"):
        read_image(tmp_path, series="air")


def test_dicom_faults(tmp_path: Path) -> None:
    pytest.importorskip("pydicom")
    with pytest.raises(MeshError, match="to the next slice are 2.5 mm, between the others 1.25 mm"):
        read_image(write_dicom(tmp_path / "missing", VALUES, BOX, leave_out=2))
    jpeg = "1.2.840.10008.1.2.4.70"
    packed = write_dicom(tmp_path / "jpeg", VALUES, BOX)
    for path in packed.iterdir():  # only the name of the compression, of which nothing decodes
        path.write_bytes(path.read_bytes().replace(b"1.2.840.10008.1.2.1\0", jpeg.encode()[:20]))
    with pytest.raises(MeshError):
        read_image(packed)
    with pytest.raises(MeshError, match="no DICOM images"):
        read_image(nothing(tmp_path))
    short = write_dicom(tmp_path / "short", VALUES, BOX)
    first = min(short.iterdir())
    first.write_bytes(first.read_bytes()[:-10])
    with pytest.raises(MeshError, match="Little Endian.*; the whole file, as it was written"):
        read_image(short)


def test_several_frames_in_one_file(tmp_path: Path) -> None:
    """Of a dose, which states a place: its array was said to have another shape."""
    pydicom = pytest.importorskip("pydicom")
    folder = write_dicom(tmp_path, VALUES[:, :, :1], BOX)
    (path,) = folder.iterdir()
    one = pydicom.dcmread(path)
    one.NumberOfFrames, one.PixelData = 2, one.PixelData * 2
    one.save_as(path)
    with pytest.raises(MeshError, match="2 frames in one file"):
        read_image(folder)


def test_without_pydicom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pydicom", None)
    with pytest.raises(MeshError, match="apt-get install python3-pydicom"):
        read_image(nothing(tmp_path))


def _changed(at: int, new: bytes, name: str = "a.nii") -> Write:
    def write(folder: Path) -> Path:
        path = write_nifti(folder / name, VALUES, BOX)
        data = bytearray(path.read_bytes())
        data[at : at + len(new)] = new
        path.write_bytes(data)
        return path

    return write


def _text(old: str, new: str, file: str = "") -> Write:
    def write(folder: Path) -> Path:
        path = write_metaimage(folder / ("a.mhd" if file else "a.mha"), VALUES, BOX, file=file)
        path.write_bytes(path.read_bytes().replace(old.encode(), new.encode()))
        return path

    return write


def bomb(folder: Path) -> Path:
    """64 MB of zeros in 64 kB, of which the header wants 240 bytes: the rest is not unpacked."""
    path = write_nifti(folder / "a.nii", VALUES, BOX)
    path.with_suffix(".nii.gz").write_bytes(gzip.compress(path.read_bytes() + bytes(1 << 26), 1))
    return path.with_suffix(".nii.gz")


def linked(folder: Path) -> Path:
    path = write_metaimage(folder / "a.mhd", VALUES, BOX, file="a.raw")
    (folder / "a.raw").rename(folder / "b.raw")
    (folder / "a.raw").symlink_to(folder / "b.raw")
    return path


def pipe(folder: Path) -> Path:
    os.mkfifo(folder / "a.nii")
    return folder / "a.nii"


def cut(kind: str) -> Write:
    def write(folder: Path) -> Path:
        path = WRITTEN[kind](folder)
        path.write_bytes(path.read_bytes()[:-30])
        return path

    return write


def test_plane_images_may_state_three_spacings(folder: Path) -> None:
    """As some programs write them."""
    header = "NDims = 2\nDimSize = 3 2\nElementType = MET_UCHAR\nElementSpacing = 0.5 2 1\n"
    (folder / "a.mha").write_bytes(f"{header}ElementDataFile = LOCAL\n".encode() + bytes(range(6)))
    found = read_image(folder / "a.mha")
    np.testing.assert_allclose(found.spacing, [0.5, 2.0, 1.0])
    assert found.values[2, 1, 0] == 5


NAN = np.where(VALUES.max() == VALUES, np.nan, VALUES).astype(np.float32)
HUGE = np.array([3, 32767, 32767, 32767], "<i2").tobytes()
FAULTS: dict[str, tuple[Write, str]] = {
    "missing": (lambda f: f / "b.nii", "there is no image"),
    "other": (lambda f: f / "b.png", "there is no image"),
    "pipe": (pipe, "a pipe"),
    "no header": (_changed(0, b"\1"), "no NIfTI image"),
    "Analyze": (_changed(344, b"\0\0\0\0"), "Analyze"),
    "pair": (_changed(344, b"ni1\0"), ".img"),
    "colours": (_changed(70, b"\x80\0"), "colours"),
    "huge": (_changed(40, HUGE), "ends before its image of 32767 x 32767 x 32767"),
    "negative": (_changed(42, b"\xff\xff"), "an image of -1 x 4 x 6"),
    "no dimension": (_changed(40, b"\0\0"), "0 dimensions"),
    "volumes": (_changed(40, np.array([4, 5, 4, 3, 2], "<i2").tobytes()), "2 volumes"),
    "offset": (_changed(108, np.array([np.nan], "<f4").tobytes()), "byte nan"),
    "flat": (_changed(280, bytes(16)), "no volume"),
    "cut": (cut("nii"), "ends before"),
    "cut gz": (cut("nii.gz"), "cannot be read|ends after"),
    "cut mha": (cut("mha"), "ends before"),
    "cut packed mha": (cut("mha, packed"), "ends after"),
    "cut vti": (cut("vti"), "a.vti"),
    "nan": (lambda f: write_nifti(f / "a.nii", NAN, BOX), "2 of its voxels have no number"),
    "link": (linked, "this is a link"),
    "elsewhere": (_text("= a.raw", "= ../a.raw", "a.raw"), "in the folder of the .mhd"),
    "absolute": (_text("= a.raw", "= /etc/passwd", "a.raw"), "in the folder of the .mhd"),
    "list": (_text("= a.raw", "= LIST", "a.raw"), "files of their own"),
    "text": (_text("BinaryData = True", "BinaryData = False"), "text"),
    "sizes": (_text("DimSize = 5 4 6", "DimSize = 5 4 1e300"), "DimSize = 5 4 1e300"),
    "many": (_text("DimSize = 5 4 6", "DimSize = 5 4 99999999"), "ends before"),
    "kind": (_text("MET_SHORT", "MET_STRING"), "MET_STRING"),
    "no end": (_text("ElementDataFile", "X"), "the header does not end"),
    "one slice": (lambda f: write_nifti(f / "a.dcm", VALUES, BOX), "the folder with all files"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults(fault: str, tmp_path: Path) -> None:
    """One message with the name of the file."""
    write, message = FAULTS[fault]
    path = write(tmp_path)
    with pytest.raises(MeshError, match=message) as caught:
        read_image(path)
    assert caught.value.where.startswith(path.name) and not caught.value.others


def test_bomb(tmp_path: Path) -> None:
    np.testing.assert_array_equal(read_image(bomb(tmp_path)).values, VALUES)


def test_too_large_for_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(image_module, "free_memory", lambda: 700.0)
    with pytest.raises(MeshError, match="needs about 960 bytes of memory, 700 bytes are free"):
        read_image(write_nifti(tmp_path / "a.nii", VALUES, BOX))
