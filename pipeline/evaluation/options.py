"""What an evaluation can be told."""

from typing import Any, Self

from pydantic import BaseModel, Field, ValidationError

from dynahull.parameters import validation_message
from pipeline.errors import ConfigurationError
from pipeline.evaluation.earth_mover import GroundCost


class EvaluationOptions(BaseModel, extra="forbid", frozen=True):
    """The options of `evaluate`; all of them are in its report."""

    labels: str | None = None
    """Field of the truth that holds a label of every point; None: the truth is the static map."""
    dynamic: str = "1"
    unlabelled: str = ""
    """Label values, as `labels.parse_values` reads them."""
    truth_tolerance: float = Field(1e-4, ge=0, allow_inf_nan=False)
    cleaned_tolerance: float = Field(1e-4, ge=0, allow_inf_nan=False)
    """Metres within which a point of the original is at a point of the truth, and of the cleaned
    map. The default is finer than the millimetre grid of most LAS files, and coarser than the
    rounding of float32 within a kilometre of the origin."""
    match_distance: float = Field(0.05, gt=0, allow_inf_nan=False)
    """Metres, of SA and DA."""
    voxel: float = Field(0.2, ge=1e-6, allow_inf_nan=False)
    """Metres, of PR and RR; at least a micrometre."""
    emd_points: int = Field(2000, ge=0)
    """Size of the samples for the Earth Mover's Distance; 0: none is computed."""
    ground_cost: GroundCost = "euclidean"
    seed: int = Field(0, ge=0)
    """Of the samples."""

    @classmethod
    def checked(cls, **values: Any) -> Self:
        """Make options of what the command line was given.

        Raises
        ------
        ConfigurationError
            In one line: the option, what is allowed, and what was found.
        """
        try:
            return cls(**values)
        except ValidationError as error:
            option, _, problem = validation_message(error, cls).partition(":")
            raise ConfigurationError(f"--{option.replace('_', '-')}:{problem}") from None

    def refuse_unused(self, *, labelled: bool, original: bool) -> None:
        """Refuse options that were given and have no effect.

        Parameters
        ----------
        labelled : bool
            Whether the truth is labels; otherwise it is a map of what is static.
        original : bool
            Whether there is an original map.

        Raises
        ------
        ConfigurationError
        """
        unused: dict[str, str] = {}
        if labelled:
            unused["truth_tolerance"] = "the truth is labels, not a map of what is static"
        else:
            without_labels = "the truth is a map without labels (--labels names their field)"
            unused |= dict.fromkeys(("dynamic", "unlabelled"), without_labels)
        if not original:
            names = ("truth_tolerance", "cleaned_tolerance", "match_distance", "voxel")
            unused |= dict.fromkeys(names, "there is no original map (--original)")
        if not self.emd_points:
            without_transport = "no samples are drawn (--emd-points 0)"
            unused |= dict.fromkeys(("ground_cost", "seed"), without_transport)
        for name, reason in unused.items():
            if name in self.model_fields_set:
                option = name.replace("_", "-")
                raise ConfigurationError(f"--{option}: it has no effect here: {reason}")
