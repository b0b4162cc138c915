"""Runs on a cluster: workers that a batch system starts, and whole runs handed over to it."""
