"""What the page of the morning shows beside words: a picture of each map, and the last nights."""

import json
import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

_MOST_NIGHTS = 30
_ICON = re.compile(r'<link rel="icon" href="(data:image/png;base64,[A-Za-z0-9+/=]+)">')
_HEAD = 100_000
"""Characters of a report within which its picture is."""


@dataclass(slots=True)
class NightFigures:
    """Of one night: maps by outcome, points of those that were cleaned, and how many went."""

    night: str
    maps: Counter[str] = field(default_factory=Counter)
    points: int = 0
    removed: int = 0

    @property
    def total(self) -> int:
        """Maps that were cleaned or failed."""
        return self.maps["cleaned"] + self.maps["failed"] + self.maps["no space"]

    @property
    def share(self) -> float | None:
        """Percent removed, None where nothing was cleaned."""
        return 100 * self.removed / self.points if self.points else None


def last_nights(lines: Path) -> list[NightFigures]:
    """Return the figures of the last nights that put something down, the latest last."""
    nights: dict[str, NightFigures] = {}
    if lines.is_file():
        with lines.open(encoding="utf-8", errors="replace") as stream:
            for text in stream:
                try:
                    line = json.loads(text)
                    of_night = nights.setdefault(line["night"], NightFigures(line["night"]))
                    of_night.maps[line["outcome"]] += 1
                    if line["outcome"] == "cleaned":
                        of_night.points += line.get("points") or 0
                        of_night.removed += line.get("removed") or 0
                except (ValueError, KeyError, TypeError):  # cut off by a kill
                    continue
    return [nights[night] for night in sorted(nights)][-_MOST_NIGHTS:]


def thumbnail(page: Path) -> str | None:
    """Return the picture that a report carries as its icon, as a data URI."""
    try:
        with page.open(encoding="utf-8") as stream:
            found = _ICON.search(stream.read(_HEAD))
    except (OSError, ValueError):
        return None
    return found[1] if found else None
