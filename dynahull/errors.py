"""The errors of the method: one base class, flat subclasses, messages that carry the numbers."""


class DynaHullError(Exception):
    """Base class of every error that this package raises on purpose."""


class InvalidPointsError(DynaHullError, ValueError):
    """The array given as points is not an (N, 3) array of real numbers."""


class InvalidParametersError(DynaHullError, ValueError):
    """A parameter of the method has a value, or a name, that is not allowed."""


class MissingDependencyError(DynaHullError, ImportError):
    """An optional package is needed by the parameters chosen and is not installed."""


class MissingClassificationError(DynaHullError, ValueError):
    """`ground.method: las_class` was chosen for points that carry no classification."""
