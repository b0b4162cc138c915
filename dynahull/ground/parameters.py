"""Parameters of the ground step: one method is chosen, each has a section of its own."""

from typing import Annotated, Literal

from pydantic import BaseModel, Field


class SlopeExpert(BaseModel, extra="forbid", frozen=True):
    """What the slope method seldom needs to be told: how it looks, and how near is near."""

    cell: float = Field(
        0.25, gt=0, le=10, description="Side of a lattice cell, metres (0 < cell <= 10)."
    )
    level: Annotated[float, Field(gt=0, le=5)] = Field(
        0.1, description="Thickness of a floor's layer of points, metres (0 < level <= 5)."
    )
    clutter: Annotated[float, Field(ge=0, le=1)] = Field(
        0.2,
        description="Points tolerated in the free height, as a share of those of the floor "
        "beneath (0 to 1): the ghosts of those who walked there.",
    )
    flatness: Annotated[float, Field(ge=0, le=1)] = Field(
        0.5,
        description="Share of the occupied cells about a floor's cell that must continue it "
        "(0 to 1).",
    )
    continuity: Annotated[float, Field(gt=0, le=10)] = Field(
        0.3,
        description="Rise over distance within which a cell continues its neighbour "
        "(0 < continuity <= 10).",
    )
    breadth: Annotated[float, Field(ge=0, le=2)] = Field(
        0.8,
        description="Least extent across of the cells that continue a floor, variance in cells "
        "squared (0 to 2; a line has 0): the foot of a wall is no floor.",
    )
    storey_radius: Annotated[float, Field(gt=0, le=100)] = Field(
        3.5,
        description="Radius within which something must stand on an upper floor, lest it be a "
        "ceiling, metres (0 < storey_radius <= 100).",
    )
    extension: Annotated[float, Field(gt=0, le=100)] = Field(
        1.0,
        description="How far the ground goes on under walls and furniture, metres "
        "(0 < extension <= 100).",
    )
    tolerance: Annotated[float, Field(gt=0, le=10)] = Field(
        0.01,
        description="Distance from the ground's surface within which points are ground, metres "
        "(0 < tolerance <= 10), before the next two are added.",
    )
    noise_tolerance: Annotated[float, Field(ge=0, le=10)] = Field(
        2.2,
        description="Tolerance added per metre of the floor's own noise, the standard deviation "
        "of its points about the local plane (0 to 10).",
    )
    slope_tolerance: Annotated[float, Field(ge=0, le=10)] = Field(
        0.1, description="Tolerance added per unit of the surface's slope, metres (0 to 10)."
    )
    foot: Annotated[float, Field(ge=0, le=1000)] = Field(
        1.0,
        description="A point near the ground is the foot of a wall or a walker where, within a "
        "quarter of a cell, the 0.3 m above hold more than `foot` times the points that are near "
        "the ground (0 to 1000). Not used where `clearance` is null.",
    )
    tolerance_limit: float = Field(
        0.15, gt=0, le=100, description="The three together at most, metres (0 < limit <= 100)."
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
        description="Free height above a floor, metres (0 < clearance <= 100). null: one storey, "
        "the lowest points, as in airborne scans; `expert.clutter`, `expert.breadth` "
        "and `expert.storey_radius` then mean nothing.",
    )
    window: Annotated[float, Field(gt=0, le=100)] = Field(
        2.0,
        description="Half-width of the widest object told from the ground, metres "
        "(0 < window <= 100).",
    )
    slope: Annotated[float, Field(gt=0, le=5)] = Field(
        0.3,
        description="Rise over distance (0 < slope <= 5): what stands out by more than "
        "step + slope * r, and is as wide as a disk of radius r, is an object.",
    )
    step: float = Field(
        0.05, ge=0, le=5, description="Height of a step that is still ground, metres (0 to 5)."
    )
    steepest: Annotated[float, Field(gt=0, le=100)] = Field(
        0.45,
        description="Rise over distance of the steepest surface that is ground "
        "(0 < steepest <= 100).",
    )
    expert: SlopeExpert = Field(SlopeExpert(), description="What seldom needs another value.")


class ClothParameters(BaseModel, extra="forbid", frozen=True):
    """Cloth simulation (Zhang et al. 2016), by the package cloth-simulation-filter."""

    cloth_resolution: float = Field(
        0.5, gt=0, le=100, description="Distance between the cloth's particles, metres (0 to 100)."
    )
    rigidness: Literal[1, 2, 3] = Field(
        3, description="Stiffness of the cloth: 1 steep slopes, 2 terraces, 3 flat ground."
    )
    class_threshold: Annotated[float, Field(gt=0, le=100)] = Field(
        0.1,
        description="Distance from the cloth within which points are ground, metres (0 to 100).",
    )
    slope_smooth: bool = Field(False, description="Fit the cloth to steep slopes afterwards.")
    time_step: float = Field(
        0.65, gt=0, le=10, description="Time step of the simulation (0 to 10)."
    )
    iterations: int = Field(500, ge=1, le=100_000, description="Steps of the simulation, at most.")


class GroundParameters(BaseModel, extra="forbid", frozen=True):
    """How the ground is found."""

    method: Literal["slope", "csf", "none", "las_class"] = Field(
        "slope",
        description="`slope`: by the slope of the local surface. `csf`: cloth simulation (an "
        "optional package, not local: the map is one piece). `none`: no point is ground. "
        "`las_class`: points of LAS class 2 are ground.",
    )
    slope: SlopeParameters = Field(SlopeParameters(), description="For `method: slope`.")
    csf: ClothParameters = Field(ClothParameters(), description="For `method: csf`.")
