"""What the method tells whoever watches it: the stage, its size, and how far it is."""

from typing import Protocol


class Observer(Protocol):
    """Is told about the progress of a run; the method never asks anything back."""

    def stage(self, name: str, total: int) -> None:
        """Begin a stage of `total` points; the stage before it has ended."""

    def advance(self, points: int) -> None:
        """Count `points` more points of the present stage as done."""

    def warn(self, message: str) -> None:
        """Report something the user should know, in one sentence."""


class SilentObserver:
    """Watches nothing; the default."""

    def stage(self, name: str, total: int) -> None:
        """Ignore the stage."""

    def advance(self, points: int) -> None:
        """Ignore the points."""

    def warn(self, message: str) -> None:
        """Ignore the warning."""
