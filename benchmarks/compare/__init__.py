"""The same data given to DynaHull and to what people would pick instead, and the paper's tables.

`python -m benchmarks.compare --help` says how; docs/evaluation.md has tables of it.
"""
