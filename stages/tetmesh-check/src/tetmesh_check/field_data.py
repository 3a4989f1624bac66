"""Texts in the field data of VTK files.

VTK has a type for strings, but not every program reads it: meshio stops at it. Texts are therefore
written as their bytes (UTF-8), one unsigned number of 8 bits each, in every file of this project.
Files of before, with strings, are read as well.
"""

from __future__ import annotations

import numpy as np
import pyvista as pv


def add_text(dataset: pv.DataSet, name: str, text: str) -> None:
    """Put a text into the field data.

    Parameters
    ----------
    dataset
        The data set.
    name
        Name of the array.
    text
        Any text without zero characters.
    """
    dataset.field_data.set_array(np.frombuffer(text.encode(), dtype=np.uint8).copy(), name)


def text_of(dataset: pv.DataSet, name: str) -> str | None:
    """Return a text of the field data, or ``None`` where there is none.

    Parameters
    ----------
    dataset
        A file as read.
    name
        Name of the array.
    """
    if name not in dataset.field_data:
        return None
    values = np.asarray(dataset.field_data[name]).ravel()
    if values.dtype == np.uint8:
        return values.tobytes().partition(b"\0")[0].decode(errors="replace")
    return str(values[0]) if len(values) else None
