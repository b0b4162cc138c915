"""The six labels a point can have, by the same names everywhere."""

from enum import IntEnum


class Label(IntEnum):
    """What became of a point.

    Only `DYNAMIC` points leave the map; all others stay in it.
    """

    STATIC = 0
    """Scored and dense: kept."""
    DYNAMIC = 1
    """Scored and among the least dense of its cluster: removed."""
    GROUND = 2
    """Ground, set aside before the scoring: kept."""
    ABOVE = 3
    """Higher than `max_height` above the local ground, set aside: kept."""
    UNSCORED = 4
    """Left out as noise, a stray, or in a cluster of fewer than four points: kept in place."""
    INVALID = 5
    """A coordinate is NaN or infinite, or the point is of a heap at the origin: kept in place."""

    @property
    def title(self) -> str:
        """The name used in files and messages: `static`, `dynamic` and so on."""
        return self.name.lower()
