"""``isoparticles view CASE`` and :func:`isoparticles.view`: look at a mesh, and refine it there.

The modules: ``case`` opens cases and volumes; ``session`` keeps the meshes and their updates,
``journal`` writes the list of updates to disk, and ``lock`` allows one page for a folder;
``slices`` and ``scene`` draw the views; ``places`` lists failed checks, poor triangles and other
places to inspect; ``paint`` marks regions; ``run`` runs updates and stages in the background.
``views``, ``control``, ``choose`` and ``page`` connect these modules with the browser, and
``server`` serves the page.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isoparticles._errors import Error

if TYPE_CHECKING:
    from isoparticles._mesh import Mesh

HELP = """\
Look at a case in the browser, and refine its mesh by pointing.

CASE is the name of a case in --out, the folder of a case, or a volume. The program prints the
address of the page. Only this computer can open it. Over SSH, forward the port:
  ssh -t -L 8765:127.0.0.1:8765 HOST isoparticles view CASE --port 8765
"""


_pages: list[Any] = []
"""The pages of this notebook that have not ended."""


def expect_trame() -> None:
    """Raise an Error unless the packages of the page are installed."""
    missing = [name for name in ("trame", "trame_vtk") if find_spec(name) is None]
    if missing:
        raise Error(
            f"{', '.join(missing)}: not installed",
            "the page needs these packages",
            "run: pip install 'isoparticles[view]'",
        )


def view(
    mesh: Mesh | str | os.PathLike[str],
    image: str | os.PathLike[str] | None = None,
    *,
    folder: str | os.PathLike[str] | None = None,
    port: int = 0,
    height: int = 800,
) -> Any:
    """Show a mesh or a case in a notebook; elsewhere, serve its page and print the address.

    Parameters
    ----------
    mesh
        A mesh, or a case: its name in the folder ``out``, its folder, or a volume.
    image
        The volume that the slices of a mesh show. Default: the distance field of the mesh.
    folder
        The folder that "Save" writes a mesh to. A case is always written to its own folder.
    port
        The port of the page on this computer; 0 chooses a free one.
    height
        The height of the page in the notebook in pixels.

    Returns
    -------
    object
        In a notebook, an IFrame, whose attribute ``page.control.session.mesh`` is the present mesh.
        An earlier page of the same folder or ``port`` in the notebook ends.
        Elsewhere, the page itself, with the attribute ``control.session.mesh``; the function then
        returns after Ctrl-C.

    Raises
    ------
    Error
        If the packages of the extra ``view`` are missing, if there is no such case, if the port is
        in use, or if another process shows the case.
    """
    expect_trame()
    import isoparticles.viewer.case as cases
    from isoparticles.viewer.page import Page

    if isinstance(mesh, (str, os.PathLike)):
        if image is not None or folder is not None:
            raise TypeError("image and folder are only for a Mesh; a case has its own")
        shown = cases.open_case(os.fsdecode(mesh), Path("out"))
    else:
        shown = cases.of_mesh(mesh, image, None if folder is None else Path(folder))
    _close_pages(shown.folder, port)
    page = Page(shown, port)
    if "ipykernel" not in sys.modules:
        print(f"isoparticles: {page.address}", flush=True)
        page.start("main")
        return page
    page.start("task")
    _pages.append(page)
    frame: Any = import_module("IPython.display").IFrame(page.address, width="100%", height=height)
    frame.page = page
    return frame


def _close_pages(folder: Path | None, port: int) -> None:
    """End the pages of this notebook that show the folder or have the port."""
    locked = None if folder is None else folder.resolve()
    for page in list(_pages):
        if page.web.port == port or (locked is not None and page.locked_folder == locked):
            _pages.remove(page)
            page.close()


def main(words: Sequence[str]) -> int:
    """Run ``isoparticles view`` and return its exit code."""
    parser = argparse.ArgumentParser(
        prog="isoparticles view", description=HELP, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("case", metavar="CASE", help="the name or folder of a case, or a volume")
    parser.add_argument("-o", "--out", "--output", default="out", metavar="DIR", help="the folder of the results [out]")
    parser.add_argument("--name", help="the name of the results of a volume [that of its file]")
    parser.add_argument("--port", type=int, default=0, help="the port [a free one]")
    parser.add_argument("--browser", action="store_true", help="open the page in the browser")
    given = parser.parse_args(list(words))
    try:
        expect_trame()
        import isoparticles.viewer.case as cases
        from isoparticles.viewer.page import Page

        page = Page(cases.open_case(given.case, Path(given.out), given.name), given.port)
    except Error as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"isoparticles: open {page.address}", flush=True)
    print("isoparticles: Ctrl-C ends the page; the list of updates is kept", flush=True)
    if given.browser:
        import webbrowser

        webbrowser.open(page.address)
    page.start("main")
    return 0
