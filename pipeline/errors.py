"""The errors of the product: one base class, flat subclasses, one line each."""

from tiling.foreign_text import LONGEST_LINE, printable


class PipelineError(Exception):
    """Base class of every error that this package raises on purpose.

    The message is made one printable line: it may quote names of files, and what they hold.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(" ".join(str(message).split()), LONGEST_LINE))


class ConfigurationError(PipelineError):
    """A configuration file, or a `--set`, names an unknown key or gives a value not allowed."""


class OutputError(PipelineError):
    """The results cannot be written where they were asked for."""


class InputChangedError(PipelineError):
    """A map file changed while it was being cleaned."""


class MissingViewerError(PipelineError):
    """`view` was asked for, and the optional package that draws is not installed."""


class LostPointsError(PipelineError):
    """The outputs together do not hold the points of the input: nothing is published."""


class VerificationError(PipelineError):
    """The results of a run are not what follows from its input, or are no results of a run."""


class MissingPackageError(PipelineError):
    """A figure or a picture was asked for, and the optional package for it is not installed."""


class EvaluationError(PipelineError):
    """The maps and labels given for an evaluation do not fit each other."""


class PlanError(PipelineError):
    """A run would take more memory or disk than there is: refused before any work."""


class DiskSpaceError(PlanError):
    """A run would take more disk than there is."""


class NightlyError(PipelineError):
    """What a night works with or left behind is not what it must be."""


class NightLockedError(PipelineError):
    """Another night works on the same output folder."""


class TasksFailedError(PipelineError):
    """Tasks of a run failed; what the others did is kept."""


class WorkError(PipelineError):
    """A folder holds no work of a run, or is not one that may be removed."""


class ClusterError(PipelineError):
    """A batch system does not start what it is asked for, or workers cannot take part."""
