"""The ground step measured side by side: `slope` and `csf`, on simulated and on real maps.

Run `python -m benchmarks.ground [--data FOLDER] [--only airborne]`. Real maps are read from
`../shared/data` beside the project; where it is absent only the simulated building is measured.
`csf` is given settings that suit the map, on airborne scans the best of a search; `slope` has
one setting for buildings and streets (its defaults) and one for airborne scans
(`configs/outdoor.yaml`).
"""

import argparse
import os
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt
import yaml

from benchmarks.building import Building, simulate_building
from dynahull.ground.methods import ground_mask
from dynahull.ground.parameters import ClothParameters, GroundParameters
from dynahull.ground.reach import ground_radius

Floats = npt.NDArray[np.float64]
Booleans = npt.NDArray[np.bool_]

ROOT = Path(__file__).resolve().parents[1]
DEFAULT = GroundParameters()
OUTDOOR = GroundParameters.model_validate(
    yaml.safe_load((ROOT / "configs/outdoor.yaml").read_text())["ground"]
)
MOVING = 2
GROUND_CLASS = 2
INDOOR = ("corridor", "lobby_a", "lobby_b", "room_static_sensor")


def cloth(resolution: float, rigidness: int, threshold: float, smooth: bool) -> GroundParameters:
    """Return the settings of one csf run."""
    return GroundParameters(
        method="csf",
        csf=ClothParameters(
            cloth_resolution=resolution,
            rigidness=rigidness,
            class_threshold=threshold,
            slope_smooth=smooth,
        ),
    )


def best_cloth(
    errors: Callable[[GroundParameters], Floats],
) -> tuple[GroundParameters, Floats, int]:
    """Search csf's settings for the least mean error.

    Resolution, rigidness and smoothing are searched together at a threshold of 0.5 m. The finest
    resolution takes minutes a setting and is tried with the two best; then the thresholds are.
    """
    results = []

    def try_one(setting: tuple[float, int, float, bool]) -> None:
        results.append((errors(cloth(*setting)), setting))
        print(f"  {describe(cloth(*setting)):38} {results[-1][0].mean():6.2f}", flush=True)
        results.sort(key=lambda result: float(result[0].mean()))

    for resolution, rigidness, smooth in product((1.0, 2.0), (1, 2, 3), (False, True)):
        try_one((resolution, rigidness, 0.5, smooth))
    for _, (_, rigidness, threshold, smooth) in results[:2]:
        try_one((0.5, rigidness, threshold, smooth))
    for _, (resolution, rigidness, _, smooth) in results[:2]:
        for threshold in (0.3, 0.8, 1.2, 1.8):
            try_one((resolution, rigidness, threshold, smooth))
    return cloth(*results[0][1]), results[0][0], len(results)


def timed(points: Floats, parameters: GroundParameters) -> tuple[Booleans, float]:
    """Return the mask and the microseconds a point."""
    ground_mask(points[:100], parameters)  # compiled, or read from numba's cache
    start = time.perf_counter()
    mask = ground_mask(points, parameters)
    return mask, (time.perf_counter() - start) / len(points) * 1e6


def describe(parameters: GroundParameters) -> str:
    """Name a setting in a few words."""
    if parameters.method != "csf":
        return parameters.method
    p = parameters.csf
    smooth = ", smooth" if p.slope_smooth else ""
    return f"csf {p.cloth_resolution} m, rigid {p.rigidness}, {p.class_threshold} m{smooth}"


def measure_building() -> None:
    """Criterion 1: at least 97 % of the floor, at most 1 % of the others."""
    print("\n## Two storeys and a ramp, simulated (percent called ground)")
    print(f"{'map':30} {'method':34} floor  upper   ramp others  >5cm   us/pt")
    for name, building in buildings():
        for parameters in (DEFAULT, cloth(0.2, 3, 0.05, False)):
            mask, cost = timed(building.points, parameters)
            floor = building.floor
            shares = [
                mask[floor].mean(),
                mask[building.upper].mean(),
                mask[building.ramp].mean(),
                mask[~floor].mean(),
                (mask & ~floor & building.clear).sum() / (~floor).sum(),
            ]
            figures = " ".join(f"{100 * share:6.2f}" for share in shares)
            print(f"{name:30} {describe(parameters):34} {figures} {cost:6.2f}")


def buildings() -> Iterator[tuple[str, Building]]:
    """Yield the variants: ramps, ceilings, places and directions."""
    for seed, slope in ((0, 0.12), (1, 0.15), (2, 0.08)):
        for ceilings in (True, False):
            title = f"ramp {slope:.0%}" + ("" if ceilings else ", no ceilings")
            yield title, simulate_building(seed, ramp_slope=slope, ceilings=ceilings)
    turned = simulate_building(0, ramp_slope=0.15)
    angle = np.radians(33.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points = turned.points.copy()
    points[:, :2] = points[:, :2] @ turn.T
    yield "turned 33 degrees", turned._replace(points=points)
    yield "in UTM, z = -50", turned._replace(points=turned.points + np.array([4e5, 6.7e6, -50.0]))


def measure_indoor(maps: Path) -> None:
    """Criterion 2: there is no truth but the eye's; only the shares are printed."""
    print("\n## Indoor maps (percent of points called ground)")
    for name in INDOOR:
        points = load(maps, name)
        for parameters in (DEFAULT, cloth(0.2, 3, 0.1, False)):
            mask, cost = timed(points, parameters)
            print(f"{name:30} {describe(parameters):34} {100 * mask.mean():6.2f} {cost:6.2f} us/pt")


def measure_street(maps: Path) -> None:
    """Criterion 3: at most 2 % of the points labelled moving; the road is found."""
    import laspy  # noqa: PLC0415 (only where there are maps)

    print("\n## Street (percent called ground)")
    cloud = laspy.read(maps / "street_64beam_labelled.laz")
    points = np.column_stack([cloud.x, cloud.y, cloud.z])
    moving = np.asarray(cloud.user_data) == MOVING
    road = near_lowest(points)
    print(f"{'method':40}  moving   all  near lowest   us/pt")
    grid = [cloth(0.5, rigid, threshold, False) for rigid in (2, 3) for threshold in (0.1, 0.2)]
    for parameters in (DEFAULT, *grid):
        mask, cost = timed(points, parameters)
        shares = f"{100 * mask[moving].mean():6.2f} {100 * mask.mean():6.2f} "
        found = 100 * mask[road & ~moving].mean()
        print(f"{describe(parameters):40} {shares} {found:8.2f} {cost:8.2f}")
    points = load(maps, "campus_loop")
    mask, cost = timed(points, DEFAULT)
    print(f"campus_loop: {100 * mask.mean():.2f} % ground, {cost:.2f} us/pt")


def near_lowest(points: Floats, cell: float = 1.0, height: float = 0.1) -> Booleans:
    """Stand in for the road: within 10 cm of the lowest twentieth of a square metre's points.

    Only squares of at least a hundred points count, and none beyond 30 m, where the lowest points
    may lie on anything.
    """
    keys = np.floor(points[:, :2] / cell).astype(np.int64)
    _, groups, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    groups = groups.ravel()
    order = np.lexsort([points[:, 2], groups])
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    lowest = points[order[starts + counts // 20], 2]
    dense = counts[groups] >= 100
    close = np.hypot(points[:, 0], points[:, 1]) < 30
    near: Booleans = dense & close & (np.abs(points[:, 2] - lowest[groups]) < height)
    return near


def measure_airborne(folder: Path) -> None:
    """Criterion 4: the mean total error over the ISPRS samples, one setting for all."""
    import laspy  # noqa: PLC0415 (only where there are samples)

    print("\n## ISPRS samples (total error, percent)")
    samples = []
    for path in sorted(folder.glob("samp*.laz")):
        cloud = laspy.read(path)
        points = np.column_stack([cloud.x, cloud.y, cloud.z])
        samples.append((path.stem[:6], points, np.asarray(cloud.classification) == GROUND_CLASS))
    print(f"{'method':40} " + " ".join(f"{name:>6}" for name, _, _ in samples) + "   mean")

    def errors(parameters: GroundParameters) -> Floats:
        return np.array(
            [100 * (ground_mask(p, parameters) != truth).mean() for _, p, truth in samples]
        )

    def show(title: str, values: Floats) -> None:
        print(f"{title:40} " + " ".join(f"{v:6.2f}" for v in values) + f" {values.mean():6.2f}")

    show("slope, configs/outdoor.yaml", errors(OUTDOOR))
    left_out(show, errors)
    parameters, values, tried = best_cloth(errors)
    show(f"best of {tried}: {describe(parameters)}", values)


def left_out(
    show: Callable[[str, Floats], None], errors: Callable[[GroundParameters], Floats]
) -> None:
    """Choose the setting on seven samples, measure it on the eighth, for each in turn."""
    grid = []
    for cell, slope, window, base in product(
        (1.25, 1.5, 2.0), (0.15, 0.2, 0.25), (15, 18), (0.25, 0.4)
    ):
        expert = OUTDOOR.slope.expert.model_copy(update={"cell": cell, "tolerance": base})
        changed = {"slope": slope, "window": window, "expert": expert}
        grid.append(OUTDOOR.model_copy(update={"slope": OUTDOOR.slope.model_copy(update=changed)}))
    table = np.array([errors(parameters) for parameters in grid])
    others = table.sum(axis=1, keepdims=True) - table
    show(
        f"slope, one left out ({len(grid)} settings)",
        table[others.argmin(axis=0), range(table.shape[1])],
    )
    show("slope, worst of these settings", table[table.mean(axis=1).argmax()])


def measure_turning(maps: Path | None) -> None:
    """Criterion 5: what moving or turning a map about z changes."""
    print("\n## Moved or turned about z (percent of labels that change)")
    sets = [("building", simulate_building(0).points)]
    if maps is not None:
        sets += [(name, load(maps, name)) for name in ("corridor", "lobby_a")]
    random = np.random.default_rng(0)
    for name, points in sets:
        before = ground_mask(points, DEFAULT)
        moved, turned = [], []
        for _ in range(8):
            shift = np.append(random.uniform(-100, 100, 2), 0.0)
            moved.append(100 * (ground_mask(points + shift, DEFAULT) != before).mean())
            angle = random.uniform(0, 2 * np.pi)
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            other = points.copy()
            other[:, :2] = points[:, :2] @ turn.T
            turned.append(100 * (ground_mask(other, DEFAULT) != before).mean())
        print(f"{name:12} moved {np.mean(moved):.2f} (worst {np.max(moved):.2f})", end="  ")
        print(f"turned {np.mean(turned):.2f} (worst {np.max(turned):.2f})")


def load(maps: Path, name: str) -> Floats:
    """Read the coordinates of a map."""
    if (maps / f"{name}.laz").exists():
        import laspy  # noqa: PLC0415 (only where there are maps)

        cloud = laspy.read(maps / f"{name}.laz")
        return np.column_stack([cloud.x, cloud.y, cloud.z])
    content = (maps / f"{name}.pcd").read_bytes()
    end = content.index(b"\n", content.index(b"\nDATA ") + 1) + 1
    header = dict(line.split(" ", 1) for line in content[:end].decode().splitlines()[1:])
    fields = len(header["FIELDS"].split())
    if header["DATA"] == "binary":
        values = np.frombuffer(content, np.float32, fields * int(header["POINTS"]), end).astype(
            np.float64
        )
    else:
        values = np.array(content[end:].split(), np.float64)
    points = values.reshape(-1, fields)[:, :3]
    return np.ascontiguousarray(points[np.isfinite(points).all(axis=1)])


def main() -> None:
    """Print every table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("--data", type=Path, default=ROOT / "../shared/data")
    parser.add_argument("--only", choices=("airborne",), help="measure nothing else")
    options = parser.parse_args()
    # csf, which is loaded when it is first used, on one core, as `slope` and a worker are.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    data: Path = options.data
    print(
        f"radius: defaults {ground_radius(DEFAULT):.2f} m, outdoor {ground_radius(OUTDOOR):.2f} m"
    )
    if options.only == "airborne":
        measure_airborne(data / "ground")
        return
    measure_building()
    if not data.is_dir():
        measure_turning(None)
        print(f"\n{data} is absent: no real maps were measured")
        return
    measure_turning(data / "maps")
    measure_indoor(data / "maps")
    measure_street(data / "maps")
    measure_airborne(data / "ground")


if __name__ == "__main__":
    main()
