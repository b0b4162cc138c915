"""The time of a night, and what ends it early: its budget, or a signal."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

Ending = Literal["time", "signal"]

_SIGNALS = ("SIGTERM", "SIGINT", "SIGHUP")

_SLICE = 1.0
"""Seconds that are slept before a look at whether the night is over."""


class Clock:
    """The machine's own time."""

    def now(self) -> float:
        """Return the seconds since 1970, as files are dated."""
        return time.time()

    def monotonic(self) -> float:
        """Return seconds that nobody sets back."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(seconds)


class NightEnd:
    """Knows whether the night is over: so many seconds from now, or never."""

    def __init__(self, clock: Clock, stop_after: float | None) -> None:
        self._clock = clock
        self._end = None if stop_after is None else clock.monotonic() + stop_after
        self._signalled = False

    def reason(self) -> Ending | None:
        """Return why the night is over, None while it is not."""
        if self._signalled:
            return "signal"
        if self._end is not None and self._clock.monotonic() >= self._end:
            return "time"
        return None

    def is_over(self) -> bool:
        """Tell whether the night is over."""
        return self.reason() is not None

    def sleep(self, seconds: float) -> None:
        """Let time pass, but not beyond the end of the night."""
        until = self._clock.monotonic() + seconds
        while not self.is_over() and (left := until - self._clock.monotonic()) > 0:
            self._clock.sleep(min(left, _SLICE))

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Take SIGTERM, SIGINT and SIGHUP for the end of the night."""

        def end(*_: object) -> None:
            self._signalled = True

        earlier = {}
        for name in _SIGNALS:
            number = getattr(signal, name, None)
            # What is ignored stays so: nohup.
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                earlier[number] = signal.signal(number, end)
        try:
            yield
        finally:
            for number, handler in earlier.items():
                signal.signal(number, handler)
