"""What the parameters do: k, the number of clusters, and the bounds of Eq. 1, as in the paper.

`python -m benchmarks.studies --help` says how; docs/evaluation.md shows the plots.
"""
