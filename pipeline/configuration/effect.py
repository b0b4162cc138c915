"""Settings that are given, and that nothing looks at."""

from collections.abc import Sequence

from pipeline.configuration.run import Configuration
from pipeline.errors import ConfigurationError

_IDLE = {
    "paper": (
        ("removal.confidence",),
        "give removal.min_percent and removal.max_percent, or run with -c auto",
    ),
    "auto": (
        ("removal.min_percent", "removal.max_percent", "removal.threshold"),
        "give removal.confidence, or removal.decision=paper as well",
    ),
}
"""What each decision does not look at, and what to do instead."""

_WORK = ("execution.cluster", "execution.scheduler", "execution.memory", "output.keep_work")
"""What is about workers and tiles."""


def check_work(settings: Sequence[str]) -> None:
    """Refuse settings about the work of a run, where there is none.

    Raises
    ------
    ConfigurationError
    """
    for key in (setting.partition("=")[0] for setting in settings):
        if key in _WORK:
            raise ConfigurationError(f"{key} has no effect on apply, which works without tiles")


def check_effect(settings: Sequence[str], configuration: Configuration) -> None:
    """Refuse settings that have no effect on what is decided.

    Parameters
    ----------
    settings : sequence of str
        As `--set` takes them.
    configuration : Configuration
        As they make it.

    Raises
    ------
    ConfigurationError
    """
    decision = configuration.removal.decision
    idle, remedy = _IDLE[decision]
    for key in (setting.partition("=")[0] for setting in settings):
        if key in idle:
            raise ConfigurationError(
                f"{key} has no effect where removal.decision is {decision}: {remedy}"
            )
