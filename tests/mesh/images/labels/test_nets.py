"""Surfaces between voxels: closed, smooth, with the volume of their regions; islands."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from helpers.images import OBLIQUE
from helpers.phantoms import affine, cut_ball, nested_balls, shaft

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.formats.surfaces.filling.bodies import bodies_of, region_volumes
from dolfin_elastic.mesh.formats.surfaces.filling.plc import Plc
from dolfin_elastic.mesh.images.image import Image
from dolfin_elastic.mesh.images.labels.nets import Smoothing, surfaces_between
from dolfin_elastic.mesh.images.labels.regions import Labels, regions_of

SMOOTH = Smoothing(30, 0.1)
NAMES = ["bone", "marrow"]
PHANTOMS = {"nested": nested_balls, "cut": cut_ball, "shaft": shaft}


def image(values: AnyArray, places: AnyArray | None = None) -> Image:
    return Image(values, OBLIQUE if places is None else places, LengthUnit.of(1e-3))


@pytest.mark.parametrize("phantom", PHANTOMS.values(), ids=PHANTOMS)
def test_regions_keep_the_volume_of_their_voxels(phantom: Callable[..., AnyArray]) -> None:
    """The filter alone changes it by 0.6 %, shifts after it end at 1e-10.

    Voxels differ from the true bodies by up to 0.6 %.
    """
    labels, true = phantom(40)
    plc = surfaces_between(labels, affine(40), NAMES, SMOOTH)
    voxels = np.bincount(labels.ravel())[1:] * 0.5**3
    assert region_volumes(plc) == pytest.approx(voxels, rel=1e-6)
    assert region_volumes(plc) == pytest.approx(true, rel=6e-3)
    assert bodies_of(plc)[1].tolist() == [0, 1]


def test_a_ball_is_smooth() -> None:
    labels, _ = nested_balls(40)
    plc = surfaces_between(labels, affine(40), NAMES, SMOOTH)
    outer = np.unique(plc.triangles[plc.patches == plc.patch_names.index("bone-outer")])
    radius = np.linalg.norm(plc.points[outer] - [10.137, 9.863, 10.07], axis=1)
    # Voxels have steps of half a voxel, 0.25; what is left is a twelfth of that.
    assert radius.std() < 0.05 * 0.5
    assert radius.mean() == pytest.approx(8, abs=0.1 * 0.5)


def test_the_ends_of_the_image_stay_plane() -> None:
    labels, _ = shaft(40)
    plc = surfaces_between(labels, affine(40), NAMES, SMOOTH)
    for name, x in (("xmin", 0.0), ("xmax", 20.0)):
        rows = np.isin(plc.patches, [k for k, n in enumerate(plc.patch_names) if n == name])
        assert plc.points[plc.triangles[rows], 0] == pytest.approx(x, abs=1e-12)
    assert plc.points[:, 0].min() == pytest.approx(0, abs=1e-12)


def test_normals_point_out_of_oblique_and_mirrored_images() -> None:
    labels, _ = nested_balls(20)
    for places in (OBLIQUE, OBLIQUE @ np.diag([-1.0, 1, 1, 1])):
        plc = surfaces_between(labels, places, NAMES, SMOOTH)
        volume = abs(np.linalg.det(places[:3, :3]))
        voxels = np.bincount(labels.ravel())[1:] * volume
        assert region_volumes(plc) == pytest.approx(voxels, rel=1e-6)


def test_names_of_sides_follow_the_places() -> None:
    """The first axis of this image runs along -y, the second along x."""
    labels = np.ones((2, 3, 4), dtype=np.int16)
    places = np.array([[0.0, 2, 0, 0], [-1, 0, 0, 0], [0, 0, 3, 0], [0, 0, 0, 1]])
    plc = surfaces_between(labels, places, ["all"], Smoothing(0, 0.0))
    ends = {name: np.ptp(plc.points[plc.triangles[plc.patches == k]].reshape(-1, 3), axis=0)
            for k, name in enumerate(plc.patch_names)}  # fmt: skip
    assert ends["xmin"].tolist() == [0, 2, 12]
    assert ends["ymax"].tolist() == [6, 0, 12]
    assert ends["zmax"].tolist() == [6, 2, 0]
    low = plc.points[plc.triangles[plc.patches == plc.patch_names.index("ymax")]]
    assert low[..., 1] == pytest.approx(0.5)


def test_a_few_voxels_are_noise() -> None:
    labels = np.zeros((20, 20, 20), dtype=np.int16)
    labels[4:16, 4:16, 4:16] = 1
    labels[8, 8, 8] = 0  # a hole
    labels[12, 12, 10:13] = 2  # within the other region
    labels[1, 1, 1] = 1  # outside
    labels[6:10, 6:10, 11:15] = 2
    found = regions_of(image(labels), Labels({"bone": [1], "marrow": [2]}))
    assert np.unique(found.numbers[8, 8, 8]) == 1
    assert found.numbers[12, 12, 11] == 1
    assert found.numbers[1, 1, 1] == 0
    assert "1 of 'bone' (1 voxels), 1 of 'marrow' (3 voxels)" in found.notes[0]
    assert "1 outside of all regions (1 voxels)" in found.notes[0]


FAULTS = {
    "no such value": ({"bone": [1], "marrow": [3]}, None, "no voxel of the image has the value 3"),
    "one value twice": ({"bone": [1], "all": [1, 2]}, None, "the value 1 is that of 'bone'"),
    "no labels": ({}, None, "labels are missing"),
    "threshold too large": ({}, 7.0, "no voxel of the image is 7 or more"),
}


@pytest.mark.parametrize(("labels", "threshold", "text"), FAULTS.values(), ids=FAULTS)
def test_labels_that_mean_nothing(labels, threshold, text) -> None:
    values = np.zeros((4, 4, 4), dtype=np.uint8)
    values[1:3, 1:3, 1:3] = 1
    values[2] = 2
    with pytest.raises(MeshError) as caught:
        regions_of(image(values), Labels(labels, threshold))
    assert text in str(caught.value)


def test_a_grey_image_needs_a_threshold() -> None:
    grey = np.linspace(0, 1, 27 * 8, dtype=np.float32).reshape(6, 6, 6)
    with pytest.raises(MeshError, match="no whole numbers"):
        regions_of(image(grey), Labels({"bone": [1]}))
    found = regions_of(image(grey), Labels({}, 0.5))
    assert found.numbers.sum() == 108
    assert list(found.names) == ["body"]


def closed(plc: Plc) -> bool:
    """Whether no edge belongs to one triangle alone."""
    ends = np.sort(plc.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return bool((np.unique(ends, axis=0, return_counts=True)[1] > 1).all())


def test_noise_leaves_closed_surfaces() -> None:
    """Of random voxels, which touch in edges and corners."""
    labels = np.random.default_rng(1).integers(0, 3, (8, 8, 8)).astype(np.int16)
    plc = surfaces_between(labels, np.eye(4), NAMES, SMOOTH)
    assert closed(plc)
    bodies, regions = bodies_of(plc)
    assert (bodies[plc.regions >= 0] >= 0).all()
    assert len(regions) > 2
