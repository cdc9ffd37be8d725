"""Fixed pictures of a page, for paper and where a viewer of mail runs no scripts.

They come from the process that draws all pictures.
"""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from dolfin_elastic.report.scene import FIRST, Shown, Viewed
from dolfin_elastic.results.fields import field_in_file
from dolfin_elastic.results.scene.renderer import RENDERER
from dolfin_elastic.results.scene.scene import Frame, Picture
from dolfin_elastic.results.scene.series import Limits, draw_pictures, finished

_MOST = 3
"""Fields of which there are fixed pictures."""


def stills(viewed: Viewed, palette: Mapping[str, str]) -> tuple[list[tuple[str, str]], str]:
    """Pictures of the first fields, and one of supports and loads on the undeformed body.

    Args:
        palette: Key of each support and load to its colour.

    Returns:
        Titles and data URLs of the former, and a data URL, empty without supports and loads.

    Raises:
        DrawingError: No picture can be drawn here.
    """
    scene, glyphs = viewed.scene, viewed.scene.glyphs
    body = Picture(
        replace(scene, frames=(viewed.frame,), glyphs=()),
        "z" if scene.plane else "isometric",
        scale=viewed.scale,
        outline=False,
    )
    varied = [one for one in viewed.fields if one.name in FIRST and one.high > one.low][:_MOST]
    result = [(one.title, _coloured(body, viewed, one)) for one in varied]
    result = result or [("", replace(body, bare=True))]
    still = (Frame("", np.zeros_like(scene.points)),)
    held = replace(
        scene,
        frames=still,
        glyphs=tuple(replace(one, colour=palette[one.key]) for one in glyphs),
        obstacles=tuple(replace(one, shift=np.zeros(3)) for one in scene.obstacles),
    )
    try:
        drawn = [(title, data_url(one)) for title, one in result]
        return drawn, data_url(replace(body, scene=held, bare=True)) if glyphs else ""
    finally:
        RENDERER.release(data_url)


def _coloured(body: Picture, viewed: Viewed, shown: Shown) -> Picture:
    name = shown.name
    # A mode has no size of its own.
    factor, unit = (shown.factor, "") if viewed.modes else (1.0, field_in_file(name).unit)
    values = np.asarray(viewed.frame.values[name] / factor, dtype=np.float64)
    frame = replace(viewed.frame, values={name: values})
    picture = replace(
        body,
        scene=replace(body.scene, frames=(frame,)),
        field=name,
        unit=unit,
        tensor=field_in_file(name).shape == "tensor",
        allowable=shown.limit,
        reliable=viewed.reliable.get(name),
    )
    ends = shown.low / factor, shown.high / factor
    return finished(picture, ends, Limits(), picture.seen, marks=True)


def data_url(picture: Picture) -> str:
    """A picture as data."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "still.png"
        draw_pictures(data_url, [picture], file)
        return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode("ascii")
