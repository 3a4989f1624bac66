"""Pictures drawn beside other work, and what the report says of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from tetmesh_check.context import Context
from tetmesh_check.report.pictures import Drawing, PictureJob


@contextmanager
def drawing(job: PictureJob | None, context: Context) -> Iterator[None]:
    """Have the pictures drawn beside the work of the block.

    Parameters
    ----------
    job
        The pictures to draw, if any.
    context
        For times, warnings, and ``pictures`` in the results.
    """
    if job is None:
        yield
        return
    drawn: list[str] = []
    try:
        job.folder.mkdir(parents=True, exist_ok=True)
        processes = Drawing(job)
    except OSError as error:
        skipped = {"all": str(error)}
        yield
    else:
        with processes:
            yield
            with context.step("pictures"):
                try:
                    drawn, skipped = processes.finish()
                except OSError as error:
                    skipped = {"all": str(error)}
    context.results["pictures"] = {"drawn": drawn, "skipped": skipped}
    for reason in sorted(set(skipped.values())):
        names = ", ".join(name for name, why in skipped.items() if why == reason)
        context.warn(f"pictures skipped ({names}): {reason}")
