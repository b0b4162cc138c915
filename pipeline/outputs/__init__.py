"""The output folder, and all that is written into it or read from it."""
