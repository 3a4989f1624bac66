"""Pictures as data addresses, so that a page needs no other files."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import numpy as np
from PIL import Image

from tetmesh_check.errors import file_error
from tetmesh_check.report.pictures import MESH_SHARE

_PICTURE_WIDTH = 1400
_ZOOMS = (1.0, 0.85, 0.7, 0.6, 0.5)
"""Sizes of the part that :func:`filled` tries, over that of the picture."""
_FULL = 0.9
"""Share of a part that the mesh must cover for :func:`filled` to stop there."""


def image_data(image: Image.Image, lossless: bool = False) -> str:
    """Turn an image into a data address (WebP).

    Parameters
    ----------
    image
        The image.
    lossless
        Whether every pixel is kept, as labels need.
    """
    stream = io.BytesIO()
    image.save(stream, "WEBP", quality=82, method=4, lossless=lossless)
    return f"data:image/webp;base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"


def filled(image: Image.Image) -> Image.Image:
    """Enlarge the part of a picture that the mesh covers best, above the colour bar, which stays.

    Parameters
    ----------
    image
        A picture in RGBA; the background is transparent.
    """
    width, height = image.width, round(MESH_SHARE * image.height)
    cover = np.zeros((height + 1, width + 1))
    cover[1:, 1:] = (np.asarray(image)[:height, :, 3] > 0).cumsum(axis=0).cumsum(axis=1)
    best, box = -1.0, (0, 0, width, height)
    for zoom in _ZOOMS:
        wide, high = round(zoom * width), round(zoom * height)
        lefts, tops = (np.unique(np.linspace(0, room, 25).astype(int)) for room in (width - wide, height - high))
        top, left = np.meshgrid(tops, lefts, indexing="ij")
        sums = cover[top + high, left + wide] - cover[top, left + wide] - cover[top + high, left] + cover[top, left]
        # of equal parts the one nearest to the middle, at which the picture looks
        aside = np.hypot(left + 0.5 * wide - 0.5 * width, top + 0.5 * high - 0.5 * height) / width
        shares = sums / (wide * high) - 0.01 * aside
        k = int(shares.argmax())
        if shares.flat[k] > best:
            x, y = int(left.flat[k]), int(top.flat[k])
            best, box = float(shares.flat[k]), (x, y, x + wide, y + high)
        if best >= _FULL:
            break
    part = image.crop(box).resize((width, height), Image.Resampling.LANCZOS)
    whole = image.copy()
    whole.paste(part, (0, 0))
    return whole


def picture_data(path: Path, kind: str = "", width: int = _PICTURE_WIDTH) -> tuple[str, int, int]:
    """Turn a picture into a data address for the page; with its width and height, pixels.

    Parameters
    ----------
    path
        A picture; what is transparent in it stays so.
    kind
        A ``closeup`` is enlarged where the mesh is. ``regions`` lose the names below the mesh,
        which the page writes as text.
    width
        Wider ones are made smaller.
    """
    try:
        with Image.open(path) as opened:
            image: Image.Image = opened.convert("RGBA")
    except OSError as error:
        raise file_error(path, "read", error, "draw the pictures again (tetmesh-check --pictures)") from error
    if kind == "closeup":
        image = filled(image)
    elif kind == "regions":
        image = image.crop((0, 0, image.width, round(MESH_SHARE * image.height)))
    if image.width > width:
        image = image.resize((width, round(image.height * width / image.width)), Image.Resampling.LANCZOS)
    return image_data(image), image.width, image.height
