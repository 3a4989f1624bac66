"""Charts as inline SVG, in the colours of the page, each with words for those who cannot see it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

_WIDTH, _HEIGHT = 560.0, 300.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 62.0, 16.0, 36.0, 46.0


def number(value: float, digits: int = 3) -> str:
    """Write a number for people: thousands apart, some significant digits below one thousand.

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
    rounded = f"{value:.{digits}g}"
    return f"{value:,.0f}".replace(",", "\u202f") if abs(float(rounded)) >= 1000 else rounded


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round numbers between two values.

    Parameters
    ----------
    low, high
        The range; ``high`` is larger.
    about
        How many are wanted.
    """
    rough = (high - low) / about
    power = 10.0 ** math.floor(math.log10(rough))
    step = min((m * power for m in (1, 2, 2.5, 5, 10)), key=lambda s: abs(s - rough))
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


class _Frame:
    """Axes, and the way from values to places."""

    def __init__(self, x: tuple[float, float], y: tuple[float, float]) -> None:
        self._x = x if x[1] > x[0] else (x[0] - 0.5, x[0] + 0.5)
        self._y = y if y[1] > y[0] else (y[0] - 0.5, y[0] + 0.5)

    def x(self, value: float) -> float:
        share = (value - self._x[0]) / (self._x[1] - self._x[0])
        return _LEFT + share * (_WIDTH - _LEFT - _RIGHT)

    def y(self, value: float) -> float:
        share = (value - self._y[0]) / (self._y[1] - self._y[0])
        return _HEIGHT - _BOTTOM - share * (_HEIGHT - _TOP - _BOTTOM)

    def axes(self, title: str, x_label: str, y_label: str) -> str:
        middle = 0.5 * (_LEFT + _WIDTH - _RIGHT)
        parts = [f'<text class="title" x="{_LEFT}" y="20">{escape(title)}</text>']
        for value in ticks(*self._y, 4):
            y = self.y(value)
            parts.append(f'<line class="axis" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
            parts.append(f'<text x="{_LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{number(value, 5)}</text>')
        for value in ticks(*self._x):
            label = number(value, 4)
            parts.append(
                f'<text x="{self.x(value):.1f}" y="{_HEIGHT - _BOTTOM + 18}" text-anchor="middle">{label}</text>'
            )
        parts.append(f'<text x="{middle}" y="{_HEIGHT - 8}" text-anchor="middle">{escape(x_label)}</text>')
        parts.append(f'<text x="{_WIDTH - _RIGHT}" y="20" text-anchor="end">{escape(y_label)}</text>')
        return "".join(parts)


def _svg(words: str, content: str) -> str:
    return (
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{escape(words, quote=True)}">'
        f"<title>{escape(words)}</title>{content}</svg>"
    )


def histogram(
    edges: Sequence[float],
    counts: Sequence[int],
    title: str,
    label: str,
    marks: dict[str, float],
    second: bool = False,
    beyond: int = 0,
) -> str:
    """Draw shares of a whole, with lines at the mean and at the worst value (at the rim, where that lies beyond it).

    Parameters
    ----------
    edges
        Of the bins, one more than ``counts``.
    counts
        In each bin.
    title, label
        What is counted, and the measure with its unit.
    marks
        ``mean``, and ``least``, ``smallest`` or ``largest``.
    second
        Whether the second colour is used.
    beyond
        How many lie outside all bins; they belong to the whole, and it is said that they are not shown.
    """
    total = max(sum(counts) + beyond, 1)
    shares = [100.0 * count / total for count in counts]
    frame = _Frame((edges[0], edges[-1]), (0.0, max(*shares, 1e-9) * 1.08))
    bars = [
        f'<rect x="{frame.x(a) + 0.4:.2f}" y="{frame.y(s):.2f}" width="{max(frame.x(b) - frame.x(a) - 0.8, 0.6):.2f}" '
        f'height="{frame.y(0.0) - frame.y(s):.2f}"/>'
        for a, b, s in zip(edges[:-1], edges[1:], shares, strict=True)
        if s > 0
    ]
    lines = []
    for name, value in marks.items():
        x = frame.x(min(max(value, edges[0]), edges[-1]))
        kind = "mean" if name == "mean" else "least"
        lines.append(f'<line class="{kind}" x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP}" y2="{frame.y(0.0):.1f}"/>')
    said = ", ".join(f"{name} {number(value)}" for name, value in marks.items())
    if beyond:
        said += f"; {number(beyond)} beyond"
    words = f"Histogram: {title}, {label}; {said}; {number(sum(counts) + beyond)} counted."
    colour = "bars second" if second else "bars"
    content = frame.axes(title, f"{label}  ({said})", "share, %")
    return _svg(words, f'{content}<g class="{colour}">{"".join(bars)}</g>{"".join(lines)}')


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
