"""Charts as inline SVG, in the colours of the page, each with words for those who cannot see it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from tetmesh_check.numerals import plain

_WIDTH, _HEIGHT = 560.0, 330.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 66.0, 16.0, 36.0, 46.0
_ROW = 17.0
"""Height of a row of words over a histogram."""


@dataclass(frozen=True)
class Limit:
    """A limit of a check, to be drawn into a histogram."""

    value: float
    """In the unit of the measure."""
    above: bool = False
    """Whether what lies above it fails, rather than what lies below."""


@dataclass(frozen=True)
class Axis:
    """The measure, and the measured items."""

    title: str
    """Title of the chart."""
    measure: str
    """With its unit."""
    things: str
    """Name of the counted items."""


def number(value: float, digits: int = 3) -> str:
    """Write a number for people, with few digits, and without decimals from 1000 on.

    Parameters
    ----------
    value
        The number.
    digits
        Significant digits.
    """
    if not math.isfinite(value):
        return "-"
    if value == round(value) and abs(value) < 1e15:
        return f"{int(value):,}".replace(",", "\u202f")
    return plain(value, digits, spaced=True)


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round numbers between two values.

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


class _Frame:
    """Axes, and the way from values to places."""

    def __init__(self, x: tuple[float, float], y: tuple[float, float], top: float = _TOP) -> None:
        self._x = x if x[1] > x[0] else (x[0] - 0.5, x[0] + 0.5)
        self._y = y if y[1] > y[0] else (y[0] - 0.5, y[0] + 0.5)
        self.top = top

    def x(self, value: float) -> float:
        share = (value - self._x[0]) / (self._x[1] - self._x[0])
        return _LEFT + share * (_WIDTH - _LEFT - _RIGHT)

    def y(self, value: float) -> float:
        share = (value - self._y[0]) / (self._y[1] - self._y[0])
        return _HEIGHT - _BOTTOM - share * (_HEIGHT - self.top - _BOTTOM)

    def axes(self, title: str, x_label: str, y_label: str, y_ticks: Sequence[tuple[float, str]] | None = None) -> str:
        middle = 0.5 * (_LEFT + _WIDTH - _RIGHT)
        parts = [f'<text class="title" x="{_LEFT}" y="20">{escape(title)}</text>']
        for value, label in y_ticks or [(value, number(value, 5)) for value in ticks(*self._y, 4)]:
            y = self.y(value)
            parts.append(f'<line class="axis" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
            parts.append(f'<text x="{_LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{label}</text>')
        for value in ticks(*self._x):
            label = number(value, 4)
            parts.append(
                f'<text x="{self.x(value):.1f}" y="{_HEIGHT - _BOTTOM + 18}" text-anchor="middle">{label}</text>'
            )
        parts.append(f'<text x="{middle}" y="{_HEIGHT - 8}" text-anchor="middle">{escape(x_label)}</text>')
        parts.append(f'<text x="{_WIDTH - _RIGHT}" y="20" text-anchor="end">{escape(y_label)}</text>')
        return "".join(parts)

    def mark(self, kind: str, value: float, words: str, row: int) -> tuple[str, str]:
        """A line, and its label in a row of its own over the plot."""
        x = self.x(min(max(value, self._x[0]), self._x[1]))
        y = _TOP + _ROW * row
        right = x < 0.5 * _WIDTH
        place = f'x="{x + 6:.1f}" text-anchor="start"' if right else f'x="{x - 6:.1f}" text-anchor="end"'
        return (
            f'<line class="{kind}" x1="{x:.1f}" x2="{x:.1f}" y1="{y - 9:.1f}" y2="{self.y(self._y[0]):.1f}"/>',
            f'<text class="{kind}" {place} y="{y + 1:.1f}">{escape(words)}</text>',
        )


def _svg(words: str, content: str) -> str:
    return (
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{escape(words, quote=True)}">'
        f"<title>{escape(words)}</title>{content}</svg>"
    )


def _beyond(
    frame: _Frame, limit: Limit, edges: Sequence[float], ground: float, row: int
) -> tuple[str, tuple[str, str], str]:
    """The area in which the check fails, the line at its limit, and both in words."""
    side = "above" if limit.above else "below"
    start, end = (limit.value, edges[-1]) if limit.above else (edges[0], limit.value)
    left, right = (frame.x(min(max(v, edges[0]), edges[-1])) for v in (start, end))
    area = (
        f'<rect class="fails" x="{left:.1f}" y="{frame.top:.1f}" width="{max(right - left, 0.0):.1f}" '
        f'height="{ground - frame.top:.1f}"/>'
    )
    words = f"limit {number(limit.value)}: {side} it the check fails"
    return area, frame.mark("limit", limit.value, words, row), words


def histogram(
    edges: Sequence[float],
    counts: Sequence[int],
    axis: Axis,
    marks: dict[str, float],
    limit: Limit | None = None,
    second: bool = False,
    beyond: int = 0,
) -> str:
    """Draw a histogram with lines at the mean, the worst value and the limit.

    The axis of counts is logarithmic, so a few poor elements are visible next to many good ones.

    Parameters
    ----------
    edges
        Of the bins, one more than ``counts``.
    counts
        In each bin.
    axis
        Title, measure and things counted.
    marks
        ``mean``, and ``minimum`` or ``maximum``; drawn at the edge if it lies beyond the bins.
    limit
        The limit of the check, if there is one.
    second
        Whether the second colour is used.
    beyond
        Number of values outside all bins. The chart states that they are not shown.
    """
    powers = max(1, math.ceil(math.log10(max(*counts, 2))))
    rows = len(marks) + (limit is not None)
    # half a thing stands on the ground line, so that a bin with one of them is seen
    ground = math.log10(0.5)
    frame = _Frame((edges[0], edges[-1]), (ground, float(powers)), _TOP + _ROW * rows)
    bars = [
        f'<rect x="{frame.x(a) + 0.4:.2f}" y="{frame.y(math.log10(c)):.2f}" width="{max(frame.x(b) - frame.x(a) - 0.8, 0.6):.2f}" '
        f'height="{frame.y(ground) - frame.y(math.log10(c)):.2f}"><title>{number(a)} to {number(b)}: {number(c)}</title></rect>'
        for a, b, c in zip(edges[:-1], edges[1:], counts, strict=True)
        if c > 0
    ]
    drawn = [
        frame.mark("mean" if name == "mean" else "least", value, f"{name} {number(value)}", row)
        for row, (name, value) in enumerate(marks.items())
    ]
    said = ", ".join(f"{name} {number(value)}" for name, value in marks.items())
    fails = ""
    if limit is not None:
        fails, line, words = _beyond(frame, limit, edges, frame.y(ground), rows - 1)
        drawn.append(line)
        said += f", {words}"
    if beyond:
        said += f"; {number(beyond)} beyond"
    words = f"Histogram: {axis.title}, {axis.measure}; {said}; {number(sum(counts) + beyond)} counted."
    colour = "bars second" if second else "bars"
    decades = [(float(power), number(10.0**power)) for power in range(powers + 1)]
    measure = axis.measure + (f" ({number(beyond)} beyond)" if beyond else "")
    lines = "".join(line for line, _ in drawn) + "".join(text for _, text in drawn)
    content = frame.axes(axis.title, measure, f"{axis.things}, in powers of ten", decades)
    return _svg(words, f'{content}<g class="{colour}">{"".join(bars)}</g>{fails}{lines}')


def curve(x: Sequence[float], y: Sequence[float], title: str, x_label: str, y_label: str, second: bool = False) -> str:
    """Draw a line through values.

    Parameters
    ----------
    x, y
        The values, from left to right.
    title, x_label, y_label
        What is shown.
    second
        Whether the second colour is used.
    """
    span = max(y) - min(y) or abs(max(y)) or 1.0
    frame = _Frame((min(x), max(x)), (min(y) - 0.06 * span, max(y) + 0.06 * span))
    path = " ".join(f"{frame.x(a):.1f},{frame.y(b):.1f}" for a, b in zip(x, y, strict=True))
    words = f"Line: {title} against {x_label}, from {number(y[0], 5)} to {number(y[-1], 5)} after {number(x[-1])}."
    colour = "curve second" if second else "curve"
    return _svg(words, frame.axes(title, x_label, y_label) + f'<polyline class="{colour}" points="{path}"/>')
