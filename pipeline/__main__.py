"""`python -m pipeline`: the command line, where the script of an environment is not on the path."""

from pipeline.commands.app import main

if __name__ == "__main__":
    main()
