"""Calls what a row of a list says of a stage, of `info` or of `page`, for the Snakefile: call.py ROWS.jsonl NAME WHAT [KEY=VALUE | --OPTION]...

The command becomes this process, so that its exit code and the signals to it are its own.
"""

import json
import os
import sys
from pathlib import Path


def main() -> None:
    """Becomes the command."""
    rows, name, what, *more = sys.argv[1:]
    told = (json.loads(line) for line in Path(rows).read_text().splitlines())
    row = next(row for row in told if row["name"] == name)
    stages = {it["stage"]: it["command"] for it in row["stages"]}
    program, goal, *words = stages[what] if what in stages else row[what]
    os.chdir(row["folder"])
    # Assignments come before the options of the command, some of which take any number of words.
    os.execv(program, [program, goal, *more, *words])


main()
