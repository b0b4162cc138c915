"""Parameters of the ground step: one method is chosen, each has a section of its own."""

from typing import Annotated, Literal

from pydantic import BaseModel, Field


class SlopeExpert(BaseModel, extra="forbid", frozen=True):
    """What the slope method seldom needs to be told: how it looks, and how near is near."""

    cell: float = Field(0.25, gt=0, le=10, description="Side of a lattice cell, metres.")
    level: Annotated[float, Field(gt=0, le=5)] = Field(
        0.1, description="Thickness of a floor's layer of points, metres."
    )
    clutter: Annotated[float, Field(ge=0, le=1)] = Field(
        0.2,
        description="Points tolerated in the free height, such as ghosts, as a share of those of "
        "the floor beneath.",
    )
    flatness: Annotated[float, Field(ge=0, le=1)] = Field(
        0.5,
        description="Share of the occupied cells around a floor's cell that must continue it.",
    )
    continuity: Annotated[float, Field(gt=0, le=10)] = Field(
        0.3,
        description="Rise over distance within which a cell continues its neighbour.",
    )
    breadth: Annotated[float, Field(ge=0, le=2)] = Field(
        0.8,
        description="Least extent across of the cells that continue a floor, variance in cells "
        "squared. A line has 0: the foot of a wall is no floor.",
    )
    storey_radius: Annotated[float, Field(gt=0, le=100)] = Field(
        3.5,
        description="Radius within which something must stand on an upper floor, lest it be a "
        "ceiling, metres.",
    )
    extension: Annotated[float, Field(gt=0, le=100)] = Field(
        1.0,
        description="How far the ground goes on under walls and furniture, metres.",
    )
    tolerance: Annotated[float, Field(gt=0, le=10)] = Field(
        0.01,
        description="Points within this distance of the ground's surface are ground, metres. The "
        "next two are added.",
    )
    noise_tolerance: Annotated[float, Field(ge=0, le=10)] = Field(
        2.2,
        description="Tolerance added per metre of the floor's noise, the standard deviation of its "
        "points about the local plane.",
    )
    slope_tolerance: Annotated[float, Field(ge=0, le=10)] = Field(
        0.1, description="Tolerance added per unit of slope, metres."
    )
    foot: Annotated[float, Field(ge=0, le=1000)] = Field(
        1.0,
        description="A point near the ground is the foot of a wall or person where, within a "
        "quarter of a cell, the 0.3 m above hold more than `foot` times the points near the "
        "ground. Not used where `clearance` is null.",
    )
    tolerance_limit: float = Field(
        0.15, gt=0, le=100, description="The three together at most, metres."
    )


class SlopeParameters(BaseModel, extra="forbid", frozen=True):
    """The ground from the slope of the surface under each point.

    The defaults suit maps of buildings and streets seen from the ground; `configs/outdoor.yaml`
    holds those for airborne scans of open country.
    """

    clearance: float | None = Field(
        1.8,
        gt=0,
        le=100,
        description="Free height above a floor, metres. null: one storey, the lowest points, as in "
        "airborne scans; `expert.clutter`, `expert.breadth` and `expert.storey_radius` then mean "
        "nothing.",
    )
    window: Annotated[float, Field(gt=0, le=100)] = Field(
        2.0,
        description="Half-width of the widest object told from the ground, metres.",
    )
    slope: Annotated[float, Field(gt=0, le=5)] = Field(
        0.3,
        description="Rise over distance. What stands out by more than step + slope * r, and is no "
        "wider than a disk of radius r, is an object.",
    )
    step: float = Field(
        0.05, ge=0, le=5, description="Height of a step that is still ground, metres."
    )
    steepest: Annotated[float, Field(gt=0, le=100)] = Field(
        0.45,
        description="Rise over distance of the steepest ground.",
    )
    expert: SlopeExpert = Field(SlopeExpert(), description="What seldom needs another value.")


class ClothParameters(BaseModel, extra="forbid", frozen=True):
    """Cloth simulation (Zhang et al. 2016), by the package cloth-simulation-filter."""

    cloth_resolution: float = Field(
        0.5, gt=0, le=100, description="Distance between the cloth's particles, metres."
    )
    rigidness: Literal[1, 2, 3] = Field(
        3, description="Stiffness of the cloth: 1 steep slopes, 2 terraces, 3 flat ground."
    )
    class_threshold: Annotated[float, Field(gt=0, le=100)] = Field(
        0.1,
        description="Points within this distance of the cloth are ground, metres.",
    )
    slope_smooth: bool = Field(False, description="Fit the cloth to steep slopes afterwards.")
    time_step: float = Field(0.65, gt=0, le=10, description="Time step of the simulation.")
    iterations: int = Field(500, ge=1, le=100_000, description="Most steps of the simulation.")


class GroundParameters(BaseModel, extra="forbid", frozen=True):
    """How the ground is found."""

    method: Literal["slope", "csf", "none", "las_class"] = Field(
        "slope",
        description="`slope`: by the slope of the local surface. `csf`: cloth simulation; needs "
        "the extra `csf`, and the map in one piece. `none`: no point is ground. `las_class`: "
        "points of LAS class 2.",
    )
    slope: SlopeParameters = Field(SlopeParameters(), description="For `method: slope`.")
    csf: ClothParameters = Field(ClothParameters(), description="For `method: csf`.")
