"""The plain versions: the oracles that the compiled code is tested against."""
