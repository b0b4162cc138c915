"""The user's home, which not every user has: in containers, an unknown number without HOME."""

import getpass
import os
from pathlib import Path

from pipeline.errors import ConfigurationError


def in_home(path: str | Path) -> Path:
    """Return a path with `~` replaced.

    Raises
    ------
    ConfigurationError
        When it begins with `~`, and there is no such home.
    """
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise ConfigurationError(
            f"{path}: expected the home folder of a user, found none (HOME is not set)"
        ) from None


def user_name() -> str:
    """Return the name of the user, or the number of one without a name."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())
