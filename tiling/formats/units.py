"""What a map's coordinates are measured in."""

import math
import re
from dataclasses import dataclass

METRE, FOOT, US_SURVEY_FOOT = 1.0, 0.3048, 1200 / 3937
"""Metres."""

_NAMES = {METRE: "metre", FOOT: "foot", US_SURVEY_FOOT: "US survey foot"}
_SYMBOLS = {"metre": "m", "foot": "ft", "US survey foot": "US ft", "degree": "°"}
_SPELLINGS = {
    METRE: {"m", "metre", "meter", "metres", "meters"},
    FOOT: {"ft", "foot", "feet", "footinternational", "internationalfoot", "internationalfeet"},
    US_SURVEY_FOOT: {"ussurveyfoot", "ussurveyfeet", "footus", "usfoot", "ftus", "usft"},
}
_SAME = 1e-7
"""Relative: the two feet differ by twenty times as much."""

_BELIEVED = 1e-3
"""Relative: a factor that contradicts the unit's name by more is not believed."""

_LONGEST_NAME = 40


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of length, or of angle."""

    name: str
    """For people."""
    metres: float | None
    """Metres in one; None for an angle."""

    @property
    def symbol(self) -> str:
        """The unit as it is written behind a number."""
        return _SYMBOLS.get(self.name, self.name)


DEGREE = Unit("degree", None)


@dataclass(frozen=True, slots=True)
class Units:
    """The units of a map."""

    horizontal: Unit | None
    """Of x and y; None where the file does not tell."""
    vertical: Unit | None = None
    """Of z; None where the file does not tell: as x and y."""

    def __str__(self) -> str:
        """Return them in words."""
        across = self.horizontal.name if self.horizontal else "unit not told"
        if self.vertical is None or self.vertical == self.horizontal:
            return across
        return f"{across}, heights in {self.vertical.name}"


def length(name: str, metres: float) -> Unit | None:
    """Return a unit of length by its name and its metres, as a file has them.

    Where they contradict each other, the name counts: writers that copy a name and leave the factor
    at 1 are known, the other way round none are.
    """
    spelt = re.sub(r"[^a-z]", "", name.lower())
    named = next((value for value, names in _SPELLINGS.items() if spelt in names), None)
    if not (math.isfinite(metres) and metres > 0):
        metres = named or 0.0
    if named and abs(metres / named - 1) > _BELIEVED:
        metres = named
    if not metres:
        return None
    for known, known_name in _NAMES.items():
        if abs(metres / known - 1) < _SAME:
            return Unit(known_name, known)
    printable = "".join(filter(str.isprintable, name))[:_LONGEST_NAME]
    return Unit(printable or f"{metres:g} m", metres)
