"""Images of voxels as files, written by the definitions of their formats alone."""

from __future__ import annotations

import gzip
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

OBLIQUE = np.array(
    [[0.0, -0.6, 0.4, 7.0], [0.48, 0.0, 0.3, -3.0], [0.0, 0.2, 0.9, 12.0], [0.0, 0.0, 0.0, 1.0]]
)
"""Of an image whose axes are exchanged, mirrored and oblique [mm]."""
_NIFTI = {"u1": 2, "i2": 4, "i4": 8, "f4": 16, "f8": 64, "i1": 256, "u2": 512, "i8": 1024}
_META = {"u1": "MET_UCHAR", "i2": "MET_SHORT", "i4": "MET_INT", "f4": "MET_FLOAT"}
_VTK = {"u1": "UInt8", "i2": "Int16", "i4": "Int32", "f4": "Float32", "f8": "Float64"}
LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


def code_of(values: np.ndarray) -> str:
    """Kind and bytes of numbers, as "i2"."""
    return values.dtype.kind + str(values.dtype.itemsize)


def write_nifti(
    path: Path,
    values: np.ndarray,
    affine: np.ndarray,
    *,
    unit: int = 2,
    order: str = "<",
    scale: tuple[float, float] = (0.0, 0.0),
    quaternion: Sequence[float] = (),
    dim: Sequence[int] = (),
) -> Path:
    """Writes NIfTI-1.

    Args:
        unit: 0: none, 1: m, 2: mm, 3: micrometres.
        quaternion: b, c, d, offsets, qfac and the three spacings in place of the rows.
        dim: In place of that of the values.
    """
    sizes = [len(values.shape), *values.shape, 1, 1, 1, 1, 1, 1, 1][:8]
    head = bytearray(352)

    def put(at: int, form: str, *numbers: float) -> None:
        struct.pack_into(order + form, head, at, *numbers)

    put(0, "i", 348)
    put(40, "8h", *(dim or sizes))
    put(70, "2h", _NIFTI[code_of(values)], 8 * values.dtype.itemsize)
    put(76, "8f", 1.0, *np.linalg.norm(affine[:3, :3], axis=0), 1, 1, 1, 1)
    put(108, "3f", 352.0, *scale)
    put(123, "B", unit)
    if quaternion:
        put(76, "4f", *quaternion[6:])
        put(252, "2h", 1, 0)
        put(256, "6f", *quaternion[:6])
    else:
        put(252, "2h", 0, 1)
        put(280, "12f", *affine[:3].ravel())
    head[344:348] = b"n+1\0"
    data = bytes(head) + values.astype(values.dtype.newbyteorder(order)).tobytes(order="F")
    path.write_bytes(gzip.compress(data, 1) if path.name.endswith(".gz") else data)
    return path


def write_metaimage(
    path: Path, values: np.ndarray, affine: np.ndarray, *, packed: bool = False, file: str = ""
) -> Path:
    """Writes .mha, or .mhd with its data in `file`."""
    at = LPS @ affine
    spacing = np.linalg.norm(at[:3, :3], axis=0)
    data = values.tobytes(order="F")
    data = zlib.compress(data) if packed else data
    text = (
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\n"
        f"CompressedData = {packed}\nTransformMatrix = {_row((at[:3, :3] / spacing).T)}\n"
        f"Offset = {_row(at[:3, 3])}\nCenterOfRotation = 0 0 0\nAnatomicalOrientation = RAI\n"
        f"ElementSpacing = {_row(spacing)}\nDimSize = {_row(np.array(values.shape))}\n"
        f"ElementType = {_META[code_of(values)]}\nElementDataFile = {file or 'LOCAL'}\n"
    )
    path.write_bytes(text.encode() + (b"" if file else data))
    if file:
        (path.parent / file).write_bytes(data)
    return path


def write_vti(path: Path, values: np.ndarray, affine: np.ndarray, *, cells: bool = False) -> Path:
    """Writes appended raw data, compressed; values in cells or at points."""
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    ends = np.array(values.shape) - (not cells)
    origin = affine[:3, 3] - (0.5 * cells) * affine[:3, :3].sum(axis=1)
    extent = _row(np.stack([0 * ends, ends], 1).ravel())
    data = values.tobytes(order="F")
    packed = zlib.compress(data)
    part, other = ("CellData", "PointData") if cells else ("PointData", "CellData")
    text = (
        '<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64" '
        f'compressor="vtkZLibDataCompressor"><ImageData WholeExtent="{extent}" '
        f'Origin="{_row(origin)}" Spacing="{_row(spacing)}" '
        f'Direction="{_row(affine[:3, :3] / spacing)}"><Piece Extent="{extent}">'
        f'<{part} Scalars="v"><DataArray type="{_VTK[code_of(values)]}" Name="v" '
        f'format="appended" offset="0"/></{part}><{other}/></Piece></ImageData>'
        '<AppendedData encoding="raw">_'
    )
    head = struct.pack("<4Q", 1, len(data), len(data), len(packed))
    path.write_bytes(text.encode() + head + packed + b"</AppendedData></VTKFile>")
    return path


def write_dicom(
    folder: Path,
    values: np.ndarray,
    affine: np.ndarray,
    *,
    scale: tuple[float, float] = (1.0, 0.0),
    series: str = "1.2.3",
    description: str = "",
    syntax: str = "1.2.840.10008.1.2.1",
    leave_out: int = -1,
) -> Path:
    """Writes slices with names in another order, and a thickness that is not their distance."""
    import pydicom
    from pydicom.dataset import FileDataset, FileMetaDataset

    folder.mkdir(exist_ok=True)
    at = LPS @ affine
    spacing = np.linalg.norm(at[:3, :3], axis=0)
    order = np.random.default_rng(3).permutation(values.shape[2])
    for name, k in enumerate(order):
        if k == leave_out:
            continue
        meta = FileMetaDataset()
        meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.2"
        meta.MediaStorageSOPInstanceUID = f"{series}.{k + 1}"
        meta.TransferSyntaxUID = syntax
        one = FileDataset(None, {}, file_meta=meta, preamble=b"\0" * 128)
        one.is_little_endian, one.is_implicit_VR = True, False
        one.SOPClassUID, one.SOPInstanceUID = meta.MediaStorageSOPClassUID, f"{series}.{k + 1}"
        one.SeriesInstanceUID, one.SeriesDescription, one.SeriesNumber = series, description, 7
        one.ImagePositionPatient = [float(x) for x in at[:3, 3] + k * at[:3, 2]]
        one.ImageOrientationPatient = [float(x) for x in (at[:3, :2] / spacing[:2]).T.ravel()]
        one.PixelSpacing = [float(spacing[1]), float(spacing[0])]
        one.SliceThickness = 2.0
        one.Rows, one.Columns = values.shape[1], values.shape[0]
        one.SamplesPerPixel, one.PhotometricInterpretation = 1, "MONOCHROME2"
        one.BitsAllocated = one.BitsStored = 16
        one.HighBit, one.PixelRepresentation = 15, 1
        one.RescaleSlope, one.RescaleIntercept = scale
        one.PixelData = values[:, :, k].T.astype("<i2").tobytes()
        pydicom.dcmwrite(folder / f"{description}{name:04d}.dcm", one, write_like_original=False)
    return folder


def _row(numbers: np.ndarray) -> str:
    return " ".join(f"{x:.15g}" for x in np.ravel(numbers))
