"""``isoparticles-read``: converts HDF5, MATLAB and Zarr files to VTK images for the stages."""

from __future__ import annotations

import json
import os
import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from isoparticles._errors import Error
from isoparticles._files import Given, Limits, format_of
from isoparticles._images import of_file
from isoparticles._native import Context, number_of_bytes
from tetmesh_check.errors import StageError, close, guarded
from tetmesh_check.parsing import Parser

TOOL = "isoparticles-read"
CHECK_OPTIONS = "--check-options"
"""First word of a command line that is only checked, as in ``tetmesh_check.cli``."""
EPILOG = f"""\
exit codes: 0 written; 2 bad usage or input, nothing written; 130 interrupted

examples:
  {TOOL} scan.h5 --dataset /volume --spacing 0.01 -o scan.vti
  {TOOL} image.ome.zarr --dataset 1 -o image.vti"""


def spacing(text: str) -> NDArray[np.float64]:
    """Parse one or three lengths, such as ``0.01`` or ``0.5,0.5,2``."""
    try:
        numbers = np.array([float(word) for word in text.split(",")])
    except ValueError:
        numbers = np.array([])
    if numbers.size not in (1, 3) or not np.all(np.isfinite(numbers) & (numbers > 0)):
        raise ArgumentTypeError(f"'{text}' is not one or three numbers above 0, separated by commas")
    return np.broadcast_to(numbers, 3)


def build_parser() -> ArgumentParser:
    """Build the parser of the command line."""
    parser = Parser(
        "read" if "ISOPARTICLES_FRONT" in os.environ else TOOL,
        description="Writes an array of an HDF5, MATLAB (.mat) or Zarr file (OME-Zarr 0.4 and 0.5) as a VTK\n"
        "image, with its position and the names of its labels. All stages read the image. `make` and\n"
        "`isoparticles mesh` do this themselves.",
        epilog=EPILOG,
    )
    parser.add_argument("input", metavar="FILE", type=Path, help="HDF5 or MATLAB file, or folder of a Zarr store")
    parser.add_argument("-o", "--output", metavar="V.vti", type=Path, required=True, help="VTK image to write")
    parser.add_argument(
        "--dataset",
        metavar="NAME",
        help="array to read: a path in an HDF5 file, a variable of a MATLAB file, a level of an OME-Zarr image or the labels "
        "of one (labels/NAME/LEVEL). `0:c=1` selects channel 1 of level 0 (default: the only volume, or the first level)",
    )
    parser.add_argument(
        "--spacing",
        metavar="MM",
        type=spacing,
        help="distance between voxel centres, mm: one number, or three for x, y and z; only for files that do not contain it",
    )
    parser.add_argument(
        "--max-memory", metavar="BYTES", type=number_of_bytes, help="refuse to use more memory, such as 8G"
    )
    parser.add_argument("--threads", metavar="N", type=int, default=0, help="number of threads in the report")
    parser.add_argument("--report", metavar="FILE.json", type=Path, help="write a report of the run")
    parser.add_argument("--force", action="store_true", help="replace existing files")
    parser.add_argument("-v", "--verbose", action="count", default=0, help="print more")
    parser.add_argument("-q", "--quiet", action="store_true", help="print only warnings and errors")
    return parser


def run(parsed: Namespace, context: Context) -> list[str]:
    """Read the array and write the image."""
    del context.parameters["seed"]
    context.parameters.update(
        dataset=parsed.dataset, spacing=None if parsed.spacing is None else parsed.spacing.tolist()
    )
    if parsed.output.suffix != ".vti":
        raise Error(f"{parsed.output}: does not end in .vti", "the output is a VTK image", "name it V.vti")
    context.check_outputs([parsed.output])
    if format_of(str(parsed.input)) is None:
        raise Error(
            f"{parsed.input}: is not an HDF5, MATLAB or Zarr file",
            "this program reads only these formats",
            "check the name of the file; `isoparticles convert` reads the other formats",
        )

    def check_memory(needed: int) -> None:
        context.check_memory(needed, f"{parsed.input}: the array", "choose a smaller array or level")

    with context.step("read"):
        limits = Limits(check_memory, context.warn)
        volume = of_file(str(parsed.input), parsed.dataset, Given(parsed.spacing), limits).volume
        assert volume is not None
        context.add_value(parsed.input, volume.hash())
    with context.step("write"):
        volume.write(parsed.output, json.dumps(context.history()))
    return []


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program.

    Parameters
    ----------
    argv
        The command line without the program's name; that of the process by default.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    if words[:1] == [CHECK_OPTIONS]:
        build_parser().parse_args(words[2:])
        print(words[1])
        return 0
    parsed = build_parser().parse_args(words)
    parsed.progress, parsed.seed = "auto", 0
    try:
        context = Context(words, parsed, TOOL)
    except StageError as error:
        return close([], error, False)
    return guarded(TOOL, lambda: run(parsed, context), context.close)


if __name__ == "__main__":
    sys.exit(main())
