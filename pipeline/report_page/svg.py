"""Axes and text of the page's charts, as SVG."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from math import ceil, floor, isfinite, log10

Format = Callable[[float], str]


@dataclass(frozen=True, slots=True)
class Axis:
    """A straight scale between two numbers, along some pixels.

    Attributes
    ----------
    low, high : float
        What is at the ends.
    begin, end : float
        Pixels of the ends.
    """

    low: float
    high: float
    begin: float
    end: float

    def at(self, value: float) -> float:
        """Return the pixel of a value, to a tenth."""
        span = (self.high - self.low) or 1.0
        return round(self.begin + (value - self.low) / span * (self.end - self.begin), 1)

    def ticks(self, count: int = 5) -> list[float]:
        """Return about `count` round numbers on the axis."""
        span = self.high - self.low
        if span <= 0:
            return [self.low]
        rough = span / max(count, 1)
        if not isfinite(rough):
            raise ValueError(f"expected an axis of finite limits, found {self.low} to {self.high}")
        size = 10.0 ** floor(log10(rough))
        step = next(size * factor for factor in (1, 2, 5, 10) if size * factor >= rough * 0.999)
        first, last = ceil(self.low / step - 1e-9), floor(self.high / step + 1e-9)
        return [round(number * step, 12) for number in range(first, last + 1)]


def text(x: float, y: float, words: str, kind: str = "", anchor: str = "middle") -> str:
    """Return some words at a place."""
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" class="{kind}">{escape(words)}</text>'


def frame(x: Axis, y: Axis, labels: tuple[str, str], formats: tuple[Format, Format]) -> str:
    """Return grid lines, tick labels and titles of two axes."""
    parts = []
    for value in y.ticks(4):
        at = y.at(value)
        parts.append(f'<path d="M{x.begin:g} {at}H{x.end:g}" class="grid"/>')
        parts.append(text(x.begin - 6, at + 4, formats[1](value), "tick", "end"))
    for value in x.ticks(5):
        at = x.at(value)
        parts.append(f'<path d="M{at} {y.begin:g}v5" class="axis"/>')
        parts.append(text(at, y.begin + 18, formats[0](value), "tick"))
    middle = (y.begin + y.end) / 2
    parts.append(f'<path d="M{x.begin:g} {y.begin:g}H{x.end:g}" class="axis"/>')
    parts.append(text((x.begin + x.end) / 2, y.begin + 36, labels[0], "label"))
    parts.append(
        f'<text transform="translate(12 {middle:g}) rotate(-90)" text-anchor="middle" '
        f'class="label">{escape(labels[1])}</text>'
    )
    return "".join(parts)


def picture(width: int, height: int, title: str, parts: Sequence[str]) -> str:
    """Return a whole drawing that grows and shrinks with the page."""
    return (
        f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}">'
        f"{''.join(parts)}</svg>"
    )


def short(value: float) -> str:
    """Write a number as people read it on an axis: 1.2 k, 35 M."""
    for size, unit in ((1e9, " G"), (1e6, " M"), (1e3, " k")):
        if abs(value) >= size:
            return f"{value / size:.3g}{unit}"
    return f"{value:.3g}"


def power_of_ten(exponent: float) -> str:
    """Write 10 to a power as a number where that is short."""
    return short(10.0**exponent) if -3 < exponent < 9 else f"1e{exponent:g}"
