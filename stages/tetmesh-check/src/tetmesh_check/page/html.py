"""Pieces of HTML, and numbers for people, that several parts of the pages share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def table(head: Sequence[str], rows: Iterable[Sequence[str]], text: Sequence[int] = (), kind: str = "") -> str:
    """Write a table; cells are HTML already.

    Parameters
    ----------
    head
        Names of the columns.
    rows
        Their cells.
    text
        Columns of words rather than numbers.
    kind
        Class of the table.
    """
    kinds = [" class=text" if column in text else "" for column in range(len(head))]
    top = "".join(f'<th scope="col"{named}>{name}</th>' for named, name in zip(kinds, head, strict=True))
    lines = ("".join(f"<td{named}>{cell}</td>" for named, cell in zip(kinds, row, strict=True)) for row in rows)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    named = f' class="{kind}"' if kind else ""
    return f'<div class="wide"><table{named}><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def figure(content: str, caption: str) -> str:
    """Write a figure with what is to be seen in it.

    Parameters
    ----------
    content
        Picture or chart.
    caption
        Plain text.
    """
    return f"<figure>{content}<figcaption>{escape(caption)}</figcaption></figure>"


def duration(seconds: float) -> str:
    """Write a time for people.

    Parameters
    ----------
    seconds
        The time, s.
    """
    if seconds >= 90:
        return f"{seconds / 60:.1f} min"
    return f"{seconds:.1f} s" if seconds >= 1 else f"{1000 * seconds:.0f} ms"


def memory(size: float) -> str:
    """Write an amount of memory for people.

    Parameters
    ----------
    size
        In bytes.
    """
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.0f} MiB"
