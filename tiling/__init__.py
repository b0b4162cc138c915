"""Maps on disk: streaming readers and writers of every format.

This package knows nothing of the method, nor of Dask.
"""
