"""Settings that are given, and that nothing looks at."""

from collections.abc import Sequence

from pipeline.configuration.run import Configuration
from pipeline.errors import ConfigurationError

_IDLE = {
    "paper": (
        ("removal.confidence",),
        "give removal.min_percent and removal.max_percent alone, or removal.decision=auto as well",
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
    """Refuse settings, as `--set` takes them, about the work of a run, where there is none."""
    _refuse(settings, _WORK, "on apply, which works without tiles")


def check_effect(settings: Sequence[str], configuration: Configuration) -> None:
    """Refuse settings that have no effect on what is decided by the configuration they make."""
    decision = configuration.removal.decision
    idle, remedy = _IDLE[decision]
    _refuse(settings, idle, f"where removal.decision is {decision}: {remedy}")


def _refuse(settings: Sequence[str], idle: Sequence[str], where: str) -> None:
    for key in (setting.partition("=")[0] for setting in settings):
        if key in idle:
            raise ConfigurationError(f"{key} has no effect {where}")
