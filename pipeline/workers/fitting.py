"""The clusters are fitted by a process of their own, which gets ready while workers start.

To import scikit-learn takes a second, in which one core would have nothing to do, and memory that
nothing needs once the clusters are found. Where a process cannot be forked safely, or there is no
core for it, the caller imports and fits.
"""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from threading import Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.clustering import Clusters, fit_clusters
from dynahull.parameters import ClusteringParameters
from pipeline.configuration.run import Configuration
from pipeline.plan.machine import available_cores
from pipeline.workers.fork_server import fork, has_one_thread

Fit = Callable[[NDArray[np.float64], ClusteringParameters], Clusters]
"""Fits clusters, see `dynahull.clustering.fit_clusters`."""

_LIBRARY = "sklearn.cluster"

_LESS_URGENT = 5
"""By how much the priority of that process is lower: what it does is not needed at once."""


@contextmanager
def fitting(configuration: Configuration) -> Iterator[Fit]:
    """Get ready for fitting the clusters of a map, and do not wait for it."""
    there_is_a_core = available_cores(configuration.execution.workers) > 1
    if configuration.clustering.scope == "map" and there_is_a_core and has_one_thread():
        with _process() as connection:
            yield lambda sample, parameters: _fit(connection, sample, parameters)
    else:
        yield fit_clusters


def import_meanwhile(fit: Fit) -> None:
    """Import what fitting takes, if it is done by this process, while there is time.

    Not before what else this process needs is imported: two threads would import the same.
    """
    if fit is fit_clusters:
        Thread(target=import_module, args=(_LIBRARY,), daemon=True).start()


@contextmanager
def _process() -> Iterator["Connection[Any, Any]"]:
    """Fork a process that fits what it is sent, once, and ends with this block."""
    ours, theirs = Pipe()
    process = fork(lambda: _serve(theirs), [theirs.fileno()])
    theirs.close()
    try:
        with ours:
            yield ours
    finally:
        os.kill(process, signal.SIGKILL)  # where nothing was to be fitted, it may be importing yet
        os.waitpid(process, 0)


def _serve(connection: "Connection[Any, Any]") -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who waits for this process
    os.nice(_LESS_URGENT)
    import_module(_LIBRARY)
    with suppress(EOFError):  # nothing to fit
        connection.send(fit_clusters(*connection.recv()).centroids)


def _fit(
    connection: "Connection[Any, Any]",
    sample: NDArray[np.float64],
    parameters: ClusteringParameters,
) -> Clusters:
    try:
        connection.send((sample, parameters))
        return Clusters(connection.recv())
    except (EOFError, OSError):  # it has failed, or was killed
        return fit_clusters(sample, parameters)
