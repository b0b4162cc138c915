"""The second way to decide: evidence for each point, and nothing removed where there is none.

`summaries` reduces points to sums over voxels, once a tile; `terms` reads them around each point;
`model` weighs the terms, twice, the second time knowing what the points around were given.
"""
