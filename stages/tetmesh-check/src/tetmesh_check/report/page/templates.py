"""The templates of the pages (folder ``templates``), and the functions that they call."""

from __future__ import annotations

import base64
import io
import json
import math
import os
import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any
from urllib.parse import quote

import numpy as np
from isoparticles._native import VERSION
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from PIL import Image

from tetmesh_check.checks import percent
from tetmesh_check.errors import file_error
from tetmesh_check.numerals import plain
from tetmesh_check.report.colours import PALETTE
from tetmesh_check.report.page.case import dig
from tetmesh_check.report.pictures import MESH_SHARE
from tetmesh_check.surface import with_changes

_PICTURE_WIDTH = 1400
_ZOOMS = (1.0, 0.85, 0.7, 0.6, 0.5)
"""Sizes of the part that :func:`filled` tries, relative to the picture."""
_FULL = 0.9
"""Share of a part that the mesh must cover for :func:`filled` to stop there."""


def number(value: float | None, digits: int = 3) -> str:
    """Write a number with few digits, and without decimals from 1000 on; a dash if unknown.

    Parameters
    ----------
    value
        The number.
    digits
        Significant digits.
    """
    if value is None or not math.isfinite(value):
        return "-"
    if value == round(value) and abs(value) < 1e15:
        return f"{int(value):,}".replace(",", "\u202f")
    return plain(value, digits, spaced=True)


def duration(seconds: float) -> str:
    """Write a time with its unit.

    Parameters
    ----------
    seconds
        The time, s.
    """
    if seconds >= 90:
        return f"{seconds / 60:.1f} min"
    return f"{seconds:.1f} s" if seconds >= 1 else f"{1000 * seconds:.0f} ms"


def memory(size: float) -> str:
    """Write an amount of memory with its unit.

    Parameters
    ----------
    size
        In bytes.
    """
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.0f} MiB"


def amount(size: float) -> str:
    """Write the size of a file with its unit.

    Parameters
    ----------
    size
        In bytes.
    """
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= scale:
            return f"{size / scale:.3g} {unit}"
    return f"{size:.0f} bytes"


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Return round numbers between two values.

    Parameters
    ----------
    low, high
        The range; ``high`` is larger.
    about
        The approximate number.
    """
    rough = (high - low) / about
    power = 10.0 ** math.floor(math.log10(rough))
    step = min((m * power for m in (1, 2, 2.5, 5, 10)), key=lambda s: abs(s - rough))
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def anchor(title: str) -> str:
    """Return the identifier of the section with a title."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def titles(body: str) -> list[str]:
    """Find the titles of the sections of a page."""
    return re.findall(r'<section id="[^"]+"><h2>(.*?)</h2>', body)


def link(path: Path, folder: Path) -> str:
    """Return the address of a file, relative to the folder of the page."""
    return quote(Path(os.path.relpath(path, folder)).as_posix())


def resource(name: str) -> Markup:
    """Return the text of a file of CSS, JavaScript or JSON in this package."""
    return Markup(files("tetmesh_check.report.page").joinpath(name).read_text(encoding="utf-8"))


def _applies(entry: dict[str, str], parameters: Mapping[str, str]) -> bool:
    name, equals, value = entry.get("set", "").partition("=")
    return not name or (parameters.get(name) == value if equals else name in parameters)


def advice_for(words: str, parameters: Mapping[str, str] = MappingProxyType({})) -> str:
    """Say what to do about a check; empty if the message itself says it.

    The texts are in ``advice.json``, which ``pipelines/case/src/advice.rs`` reads as well: page and
    terminal give the same advice. ``advice`` lists words of messages; the first entry that applies
    is used. ``terms`` replaces words in braces by the variable that applies to the case. An entry
    with ``set`` applies only if this variable is set, or has this value (``BORDER=open``).

    Parameters
    ----------
    words
        The message of the check.
    parameters
        The variables that are set for the case.
    """
    lowered = words.lower()
    table: dict[str, list[dict[str, str]]] = json.loads(str(resource("advice.json")))
    entry = next(entry for entry in table["advice"] if entry["words"] in lowered and _applies(entry, parameters))
    advice = entry["do"]
    for term in table["terms"]:
        if _applies(term, parameters):
            advice = advice.replace(term["words"], term["do"])
    return advice


def image_data(image: Image.Image, lossless: bool = False) -> str:
    """Return an image as a data URL (WebP).

    Parameters
    ----------
    image
        The image.
    lossless
        Whether every pixel keeps its colour, as labels require.
    """
    stream = io.BytesIO()
    image.save(stream, "WEBP", quality=82, method=4, lossless=lossless)
    return f"data:image/webp;base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"


def filled(image: Image.Image) -> Image.Image:
    """Enlarge the part of a picture that the mesh covers best. The colour bar is kept.

    Parameters
    ----------
    image
        A picture in RGBA, which is changed; the background is transparent.
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
        # of equal parts, the one nearest to the middle of the picture
        aside = np.hypot(left + 0.5 * wide - 0.5 * width, top + 0.5 * high - 0.5 * height) / width
        shares = sums / (wide * high) - 0.01 * aside
        k = int(shares.argmax())
        if shares.flat[k] > best:
            x, y = int(left.flat[k]), int(top.flat[k])
            best, box = float(shares.flat[k]), (x, y, x + wide, y + high)
        if best >= _FULL:
            break
    image.paste(image.crop(box).resize((width, height), Image.Resampling.LANCZOS))
    return image


def picture_data(path: Path, kind: str = "", width: int = _PICTURE_WIDTH) -> tuple[str, int, int]:
    """Return a picture as a data URL, with its width and height, pixels.

    Parameters
    ----------
    path
        A picture. Transparency is kept.
    kind
        A ``closeup`` is enlarged (:func:`filled`). The names below ``regions`` are removed, because
        the page has them as text.
    width
        Maximum width, pixels.
    """
    try:
        image = Image.open(path).convert("RGBA")
    except OSError as error:
        raise file_error(path, "read", error, "draw the pictures again (tetmesh-check --pictures)") from error
    if kind == "closeup":
        image = filled(image)
    elif kind == "regions":
        image = image.crop((0, 0, image.width, round(MESH_SHARE * image.height)))
    image.thumbnail((width, image.height), Image.Resampling.LANCZOS, reducing_gap=None)
    return image_data(image), image.width, image.height


_FUNCTIONS = (
    number, plain, percent, json.dumps, duration, memory, amount, ticks, anchor, titles, link, resource,
    picture_data, dig, advice_for, with_changes,
)  # fmt: skip


@cache
def environment() -> Environment:
    """Return the environment of the templates. All functions are also filters."""
    made = Environment(
        loader=PackageLoader("tetmesh_check.report.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    functions = {function.__name__: function for function in _FUNCTIONS}
    made.filters |= functions
    made.globals |= {**functions, "np": np, "palette": len(PALETTE), "version": VERSION}
    return made


def render(template: str, **values: Any) -> Markup:
    """Fill in a template; texts among the values are escaped.

    Parameters
    ----------
    template
        Name of the file without ``.html``.
    values
        The names that the template uses.

    Raises
    ------
    UndefinedError
        If the report of a stage lacks something that the template shows.
    """
    return Markup(environment().get_template(f"{template}.html").render(**values).strip())
