"""Step 1: the ground, which is set aside before the scoring.

The paper removes the ground first: it is dense and says nothing about what moved. `slope` is
this package's own method, local and free of any origin; `csf`, `las_class` and `none` are the
others.
"""
