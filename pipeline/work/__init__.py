"""The work folder of a run: what survives a kill."""
