"""E57: its scans as one map, read and written through libE57 (pye57, the extra `e57`)."""
