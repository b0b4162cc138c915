"""How clean a map is: measured against the truth, by the figures of the field's papers.

Nothing is imported here, so that the command line can name its options at once.
"""
