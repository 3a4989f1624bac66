"""Run one command of a row: a stage, `info` or `page`. The Snakefile calls this program.

    call.py ROWS.jsonl NAME WHAT [KEY=VALUE | --OPTION]...

The command replaces this process, so it receives the signals and returns the exit code.
"""

import json
import os
import sys
from pathlib import Path


def main() -> None:
    """Replace this process with the command."""
    rows, name, what, *more = sys.argv[1:]
    told = (json.loads(line) for line in Path(rows).read_text().splitlines())
    row = next((row for row in told if row["name"] == name), None)
    if row is None:
        sys.exit(
            f"error: {name}: no row of that name in {rows}\n  why it matters: the list has changed since this job was made\n"
            "  what to do: make the list again"
        )
    stages = {it["stage"]: it["command"] for it in row["stages"]}
    program, goal, *words = stages[what] if what in stages else row[what]
    os.chdir(row["folder"])
    # Assignments go before the options, because some options take any number of values. The last
    # assignment to a key takes effect, so a setting of the job overrides the same setting of the
    # row.
    at = next((n for n, word in enumerate(words) if word.startswith("-")), len(words))
    set_here = [word for word in more if not word.startswith("-")]
    options = [word for word in more if word.startswith("-")]
    os.execv(program, [program, goal, *words[:at], *set_here, *options, *words[at:]])


main()
