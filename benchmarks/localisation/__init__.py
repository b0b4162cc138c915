"""Does a robot find its place on a cleaned map as well as on the true one? The paper's last figure.

`python -m benchmarks.localisation --help` says how; docs/evaluation.md says what came of it.
"""
