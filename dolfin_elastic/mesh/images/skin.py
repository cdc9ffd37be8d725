"""The skin of a body in an image, where voxels are partly air: values carried outwards from inside.

A scanner blurs, so the outer one or two layers of voxels of a bone are too low.  Leaving out voxels
below a threshold does not help; voxels deeper than the skin have right values, and each voxel
further out gets that of the nearest of these.  What the body encloses, as marrow, belongs to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray, FloatArray

Mask: TypeAlias = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Skinned:
    """Values carried outwards.

    Attributes:
        values: Of the image.
        thin: Part of the voxels above the threshold that lie in walls without a core.
    """

    values: AnyArray
    thin: float


def carried_outwards(
    values: AnyArray, threshold: float, depth: int, spacing: FloatArray
) -> Skinned:
    """Gives each voxel the value of the nearest one that lies deeper than the skin. Local.

    Args:
        values: Shape (ni, nj, nk).
        threshold: Voxels at or above it are the body.
        depth: Of the skin, in voxels along each axis.
        spacing: Edges of a voxel, shape (3,).

    Raises:
        MeshError: No voxel lies so deep.
    """
    from scipy.ndimage import binary_erosion, distance_transform_edt

    body = _filled(values >= threshold)
    within = body[:, :, 0] if body.shape[2] == 1 else body
    core = binary_erosion(within, iterations=depth).reshape(body.shape)
    if not core.any():
        raise MeshError(
            f"no voxel lies {depth} voxels below the surface of what is at least {threshold:g}; "
            f"the image has {values.min():g} to {values.max():g} here",
            where="skin",
            expected="another threshold, a thinner skin, or an image with smaller voxels",
        )
    nearest = distance_transform_edt(
        ~core, sampling=spacing, return_distances=False, return_indices=True
    )
    found = values[tuple(nearest)]
    far = np.zeros(int(np.count_nonzero(body)))
    for axis, at in enumerate(np.nonzero(body)):
        far += (nearest[axis][body] - at) ** 2.0
    # The corner of a box of many voxels is 1.7 skins away from its core.
    return Skinned(found, float(np.count_nonzero(far > (2 * depth) ** 2) / max(len(far), 1)))


def _filled(body: Mask) -> Mask:
    """The body with what it encloses in slices across any axis: the image may cut it open."""
    from scipy.ndimage import binary_fill_holes

    result = body.copy()
    for axis in range(3):
        slices = np.moveaxis(result, axis, 0)
        for i, own in enumerate(np.moveaxis(body, axis, 0)):
            slices[i] |= binary_fill_holes(own)
    return result
