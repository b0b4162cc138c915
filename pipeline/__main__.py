"""`python -m pipeline`: the command line, where the script of an environment is not on the path."""

from pipeline.commands.app import leave_at_once

if __name__ == "__main__":
    leave_at_once()
