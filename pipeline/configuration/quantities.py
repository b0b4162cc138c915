"""Values of the configuration as people write them: sizes and durations with a unit, and `~`."""

import re
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from pipeline.errors import ConfigurationError

_UNITS = {
    "": 1, "b": 1,
    "kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12,
    "kib": 2**10, "mib": 2**20, "gib": 2**30, "tib": 2**40,
}  # fmt: skip

_SECONDS = {"s": 1, "min": 60, "h": 3600, "d": 86400}


def _bytes(value: object) -> object:
    """Turn text like `1.5 GiB` into bytes."""
    if not isinstance(value, str):
        return value
    match = re.fullmatch(r"([0-9.]+)\s*([a-z]*)", value.strip().lower())
    try:
        return int(float(match[1]) * _UNITS[match[2]])  # type: ignore[index]
    except (TypeError, ValueError, KeyError):
        raise ValueError("expected a size such as 2GiB") from None


def _seconds(value: object) -> object:
    """Turn `2-12:00:00`, `36:00:00` or `90 min` into seconds.

    YAML reads 36:00:00 without quotes as 129600, which is the same.
    """
    if not isinstance(value, str):
        return value
    text = value.strip().lower()
    if clock := re.fullmatch(r"(?:(\d+)-)?(\d+):([0-5]\d):([0-5]\d)", text):
        days, hours, minutes, seconds = (int(part or 0) for part in clock.groups())
        return ((days * 24 + hours) * 60 + minutes) * 60 + seconds
    if plain := re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)\s*(s|min|h|d)", text):
        return round(float(plain[1]) * _SECONDS[plain[2]])
    raise ValueError("expected a duration such as 90 min or 36:00:00")


Bytes = Annotated[int, Field(ge=1), BeforeValidator(_bytes)]
"""A size: a number of bytes, or text such as `2GiB`."""

Size = Annotated[int, Field(ge=0), BeforeValidator(_bytes)]
"""A number of bytes that may be 0."""

Seconds = Annotated[int, Field(ge=1), BeforeValidator(_seconds)]
"""A duration: a number of seconds, or text such as `36:00:00`, `2-12:00:00` or `90 min`."""


def clock(seconds: int) -> str:
    """Return a duration as hours, minutes and seconds, as schedulers read it."""
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


def in_units(size: float) -> str:
    """Return a number of bytes as people read it."""
    units = ["bytes", "KiB", "MiB", "GiB", "TiB"]
    while size >= 1024 and len(units) > 1:
        size /= 1024
        del units[0]
    return f"{size:.0f} {units[0]}" if units[0] == "bytes" else f"{size:.1f} {units[0]}"


def in_time(seconds: float) -> str:
    """Return a duration as people read it."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"


def in_home(path: str | Path) -> Path:
    """Return a path with `~` replaced; without such a home it is a `ConfigurationError`."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise ConfigurationError(
            f"{path}: expected the home folder of a user, found none (HOME is not set)"
        ) from None
