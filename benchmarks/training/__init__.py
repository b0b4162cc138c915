"""Train the model of `dynahull.evidence` from simulated scenes alone."""
