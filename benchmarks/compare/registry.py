"""All methods that are compared, in the order of the tables."""

from benchmarks.compare import ours
from benchmarks.compare.method import Method
from benchmarks.compare.peers import (
    dbscan,
    dufomap,
    dynamic_object_removal,
    nothing,
    octomap,
    open3d_outliers,
    pdal_outliers,
    voxel_counts,
)

__all__ = ["all_methods"]

_PEERS = (
    nothing,
    open3d_outliers,
    dbscan,
    pdal_outliers,
    voxel_counts,
    dufomap,
    dynamic_object_removal,
    octomap,
)


def all_methods() -> list[Method]:
    """Return every method, whether what it needs is installed or not."""
    return [*ours.methods(), *(method for peer in _PEERS for method in peer.METHODS)]
