"""Fills surfaces with tetrahedra by the program ``tetmesh-check``."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Unpack

from isoparticles._errors import Error, warn
from isoparticles._results import SizeField, Surface, expect, refuse_existing
from isoparticles._words import words_of

if TYPE_CHECKING:
    import pyvista

    from isoparticles._options import TetmeshOptions

LOG = "log.txt"
REPORT = "report.json"
TOOL = "tetmesh-check"


class Tetrahedra:
    """Tetrahedra inside a surface.

    Attributes
    ----------
    name
        The file name in histories.
    report
        The report that the program writes with ``--report``.
    failed_checks
        The checks that failed, in words.
    """

    def __init__(self, name: str, content: bytes, report: dict[str, Any]) -> None:
        self.name = name
        self._content = content
        self.report = report
        self.failed_checks: list[str] = report["failed_checks"]

    def to_pyvista(self) -> pyvista.UnstructuredGrid:
        """Read the tetrahedra with all arrays. Positions are world coordinates in mm."""
        import pyvista

        with TemporaryDirectory(prefix="isoparticles-") as folder:
            path = Path(folder) / self.name
            path.write_bytes(self._content)
            grid = pyvista.read(path)
        assert isinstance(grid, pyvista.UnstructuredGrid)
        return grid

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write the file that ``tetmesh-check`` writes (.vtu).

        Raises
        ------
        FileExistsError
            If the file exists and ``overwrite`` is false.
        """
        refuse_existing([Path(path)], overwrite)
        Path(path).write_bytes(self._content)

    def __repr__(self) -> str:
        checks = f"; failed checks: {'; '.join(self.failed_checks)}" if self.failed_checks else ""
        return f"<Tetrahedra {self.name!r}{checks}>"


def fill(
    surface: Surface,
    size: SizeField | None = None,
    *,
    name: str = "volume.vtu",
    **options: Unpack[TetmeshOptions],
) -> Tetrahedra:
    """Fill a surface with tetrahedra and check them.

    Tetrahedra that fail a check are a result: see ``failed_checks``. By default, test problems are
    solved on small meshes; see ``solve``.

    Parameters
    ----------
    surface
        A closed surface.
    size
        The size field. Default: all tetrahedra get the median edge length of the surface.
    name
        The file name of the result in histories, with the extension ``.vtu``.
    **options
        The options of the program ``tetmesh-check``.

    Raises
    ------
    Error
        If the surface cannot be filled, or if an option is invalid.
    """
    expect(Surface, surface=surface)
    words = words_of(TOOL, options)
    inputs: list[tuple[list[str], Surface | SizeField]] = [([], surface)]
    if size is not None:
        expect(SizeField, size=size)
        inputs.append((["--sizefield"], size))
    if Path(name).name != name or not name.endswith(".vtu"):
        raise ValueError(f"name={name!r}: must be a file name that ends with .vtu")
    names = [name, LOG, REPORT, *(given.name for _, given in inputs)]
    if len(set(names)) < len(names):
        raise ValueError(f"two of the files have the same name: {', '.join(names)}")
    with TemporaryDirectory(prefix="isoparticles-") as place:
        folder = Path(place)
        files: list[str] = []
        for option, given in inputs:
            given.save(folder / given.name)
            files += [*option, f"./{given.name}" if given.name.startswith("-") else given.name]
        report = _run([*files, "-o", name, *words], folder)
        return Tetrahedra(name, (folder / name).read_bytes(), report)


def _run(words: list[str], folder: Path) -> dict[str, Any]:
    """Run the program in a folder and return its report."""
    command = [sys.executable, "-m", "tetmesh_check", *words, "--quiet", "--report", REPORT]
    with (folder / LOG).open("wb") as log:
        process = subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            process.wait()
        except BaseException:
            process.terminate()
            process.wait()
            raise
    path = folder / REPORT
    report: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for warning in report.get("warnings", []):
        warn(warning)
    if process.returncode in (0, 1) and "failed_checks" in report:
        return report
    log_text = (folder / LOG).read_text(encoding="utf-8", errors="replace").strip()
    told = re.search(r"error: (.+)\n  why it matters: (.+)\n  what to do: (.+)", log_text)
    if told is not None:
        raise Error(told[1], told[2], told[3])
    raise Error(
        f"{TOOL} has ended with the code {process.returncode}: {log_text}",
        "there are no tetrahedra",
        f"see `isoparticles {TOOL} --help`",
    )
