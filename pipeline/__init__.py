"""The product: command line, configuration, and the run from map to cleaned map."""
