"""Fills surfaces with tetrahedra by the program ``tetmesh-check``."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, NoReturn, Unpack

from isoparticles._errors import Error, warn
from isoparticles._progress import Callback, Progress, shown
from isoparticles._results import DistanceField, Result, SizeField, Surface, expect, refuse_existing
from isoparticles._words import words_of

if TYPE_CHECKING:
    import pyvista

    from isoparticles._options import TetmeshOptions

LOG = "log.txt"
REPORT = "report.json"
TOOL = "tetmesh-check"


class Tetrahedra:
    """Tetrahedra inside a surface."""

    name: str
    """The file name in histories."""
    report: dict[str, Any]
    """The report that the program writes with ``--report``."""
    failed_checks: list[str]
    """The checks that failed, in words."""
    quadratic: Tetrahedra | None
    """With ``order=2``: the same tetrahedra with a node on each edge; otherwise None."""

    def __init__(
        self,
        name: str,
        content: bytes,
        report: dict[str, Any],
        quadratic: Tetrahedra | None = None,
    ) -> None:
        self.name = name
        self._content = content
        self.report = report
        self.failed_checks = report["failed_checks"]
        self.quadratic = quadratic

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
    field: DistanceField | None = None,
    *,
    order: Literal[1, 2] = 1,
    name: str = "volume.vtu",
    progress: Progress = None,
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
    field
        The distance field from which the surface was made. Required with ``order=2``.
    order
        With 2, :attr:`Tetrahedra.quadratic` has a node on each edge.
    name
        The file name of the result in histories, with the extension ``.vtu``.
    progress
        As for :func:`isoparticles.distance_field`. The total work is unknown.
    **options
        The options of the program ``tetmesh-check``.

    Raises
    ------
    Error
        If the surface cannot be filled, or if an option is invalid.
    """
    expect(Surface, surface=surface)
    words = [*words_of(TOOL, options), *(() if order == 1 else ("--order", str(order)))]
    inputs: list[tuple[list[str], Result]] = [([], surface)]
    if size is not None:
        expect(SizeField, size=size)
        inputs.append((["--sizefield"], size))
    if field is not None:
        expect(DistanceField, field=field)
        inputs.append((["--distfield"], field))
    if Path(name).name != name or not name.endswith(".vtu"):
        raise ValueError(f"name={name!r}: must be a file name that ends with .vtu")
    names = [name, LOG, REPORT, *(given.name for _, given in inputs)]
    if len(set(names)) < len(names):
        raise ValueError(f"two of the files have the same name: {', '.join(names)}")
    command = [word for option, given in inputs for word in (*option, _word(given.name))]
    command += ["-o", name, *words]
    _refuse_usage(command)
    with TemporaryDirectory(prefix="isoparticles-") as place, shown(progress) as callback:
        folder = Path(place)
        for _, given in inputs:
            given.save(folder / given.name)
        report = _run(command, folder, callback)
        files = [file for file in folder.glob("*.quadratic.vtu") if file.name != name]
        quadratic = [Tetrahedra(file.name, file.read_bytes(), report) for file in files]
        return Tetrahedra(name, (folder / name).read_bytes(), report, *quadratic)


def _word(name: str) -> str:
    """Return a file name as a word that is not an option."""
    return f"./{name}" if name.startswith("-") else name


def _refuse_usage(words: list[str]) -> None:
    """Raise an Error if ``tetmesh-check`` does not accept its command line."""
    from tetmesh_check.cli import build_parser
    from tetmesh_check.parsing import Parser

    class Raising(Parser):
        def error(self, message: str) -> NoReturn:
            raise Error(message, "the options were not understood", f"see `isoparticles {TOOL} --help`")

    build_parser(Raising).parse_args(words)


def _run(words: list[str], folder: Path, callback: Callback | None) -> dict[str, Any]:
    """Run the program in a folder and return its report."""
    command = [sys.executable, "-m", "isoparticles._filling", *words, "--quiet", "--report", REPORT]
    # the process finds the same packages
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}
    with (
        (folder / LOG).open("wb") as log,
        subprocess.Popen(
            command,
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        ) as process,
    ):
        assert process.stdout is not None
        try:
            for line in process.stdout:
                step, message = json.loads(line)
                if callback is not None:
                    callback(TOOL, step, 0, None, message)
        except BaseException:
            process.terminate()
            raise
    path = folder / REPORT
    report: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for warning in report.get("warnings", []):
        warn(warning)
    if process.returncode in (0, 1) and report:
        return report
    told = report.get("error") or {
        "what": f"{TOOL} has ended with the code {process.returncode}: "
        + (folder / LOG).read_text(encoding="utf-8", errors="replace").strip(),
        "why": "there are no tetrahedra",
        "next": "check the free memory; if there is enough, report this bug",
    }
    raise Error(told["what"], told["why"], told["next"], report or None)
