"""A finished run on the screen, coloured by label and by density: `dynahull-pipeline view`.

Rerun draws it, an optional extra: its viewer comes with its package, shows tens of millions of
points, and lets each label be switched on and off.
"""

import logging
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.labels import Label
from pipeline.errors import MissingViewerError
from pipeline.outputs.reading import ResultPoints, read_result
from pipeline.showing import check_named_file, named_file, optional_package
from pipeline.temporary import temporary_folder

LABEL_COLOURS = {
    Label.STATIC: (125, 140, 155),
    Label.DYNAMIC: (225, 50, 35),
    Label.GROUND: (165, 130, 90),
    Label.ABOVE: (90, 125, 190),
    Label.UNSCORED: (215, 180, 60),
}
"""Red, green and blue; points without finite coordinates are not drawn."""

UNSCORED_COLOUR = (70, 70, 70)

_RAMP = np.array([(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)])
"""Colours of densities from the least to the greatest."""

_POINT_SIZE = 1.5
"""On the screen, whatever the distance."""

logger = logging.getLogger("dynahull")


def view_result(folder: Path, recording: Path | None = None) -> None:
    """Open a window with the result in a run's output folder, and return when it is closed.

    A recording, a file of Rerun's (`.rrd`), is written instead if wanted; `rerun FILE` opens it, on
    any machine.

    Raises
    ------
    MissingViewerError
        When Rerun is not installed, or there is no screen to draw on.
    OutputError
        When the folder holds no complete result, or the recording cannot be written.
    """
    if recording is not None:
        check_named_file(recording, ".rrd")
    rerun = _import_rerun()
    if recording is None and not _has_screen():
        raise MissingViewerError(
            "view needs a screen, and found neither DISPLAY nor WAYLAND_DISPLAY; "
            "--save FILE.rrd writes what `rerun FILE.rrd` opens on a machine that has one"
        )
    points = read_result(folder)
    if points.density is None:
        logger.info("Colouring by density needs --labels: run again with it.")
    if recording is not None:
        with named_file(recording) as file:
            write_recording(rerun, points, folder.name, file)
        return
    with TemporaryDirectory(prefix="view-", dir=temporary_folder()) as temporary:
        file = Path(temporary) / "result.rrd"
        write_recording(rerun, points, folder.name, file)
        ended = subprocess.run([sys.executable, "-P", "-m", "rerun", str(file)], check=False)
    if ended.returncode:
        raise MissingViewerError(
            f"Rerun's viewer ended with code {ended.returncode}, see above; --save FILE.rrd "
            "writes what `rerun FILE.rrd` opens on another machine"
        )


def view_with_open3d(folder: Path) -> None:
    """Open a window of Open3D with the result of a run, coloured by label; see `view_result`."""
    open3d = optional_package(
        "view needs Open3D", "open3d", "open3d", "open3d", refusal=MissingViewerError
    )
    if not _has_screen():
        raise MissingViewerError(
            "view needs a screen, and found neither DISPLAY nor WAYLAND_DISPLAY"
        )
    points = read_result(folder)
    open3d.visualization.draw_geometries([open3d_cloud(open3d, points)], window_name=folder.name)


def open3d_cloud(open3d: Any, points: ResultPoints) -> Any:
    """Return points as a cloud of Open3D, coloured by label, from the lowest corner of the map."""
    colours = np.full((256, 3), UNSCORED_COLOUR)
    for label, colour in LABEL_COLOURS.items():
        colours[label] = colour
    corner = _corner(points)
    vectors = open3d.utility.Vector3dVector
    cloud = open3d.geometry.PointCloud(vectors(points.xyz - corner))
    cloud.colors = vectors(colours[points.labels] / 255)
    return cloud


def write_recording(rerun: Any, points: ResultPoints, name: str, path: Path) -> None:
    """Write points as a recording: a view coloured by label, and beside it one by density.

    Coordinates are drawn from the lowest corner of the map, since viewers draw in single
    precision; the corner is among the recording's properties.
    """
    corner = _corner(points)
    xyz = (points.xyz - corner).astype(np.float32)
    blueprint = rerun.blueprint
    views = [blueprint.Spatial3DView(origin="/label", name="by label")]
    if points.density is not None:
        views.append(blueprint.Spatial3DView(origin="/density", name="by density"))
    layout = blueprint.Blueprint(
        blueprint.Horizontal(*views),
        blueprint.BlueprintPanel(state="expanded"),
        blueprint.SelectionPanel(state="collapsed"),
        blueprint.TimePanel(state="hidden"),
    )
    with rerun.RecordingStream("dynahull", send_properties=True) as stream:
        stream.save(path, default_blueprint=layout)
        stream.send_recording_name(name)
        stream.send_property("map", rerun.AnyValues(corner=corner))
        stream.log("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        radius = rerun.Radius.ui_points(_POINT_SIZE)
        for label, colour in LABEL_COLOURS.items():
            own = xyz[points.labels == label]
            if len(own):
                cloud = rerun.Points3D(own, colors=[colour], radii=radius)
                stream.log(f"/label/{label.title}", cloud, static=True)
        if points.density is not None:
            scored = ~np.isnan(points.density)
            for part, chosen in (("scored", scored), ("not_scored", ~scored)):
                if chosen.any():
                    colours = density_colours(points.density[chosen])
                    cloud = rerun.Points3D(xyz[chosen], colors=colours, radii=radius)
                    stream.log(f"/density/{part}", cloud, static=True)


def density_colours(density: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return a colour for each density, (n, 3): by rank, so that all of them can be told apart.

    Infinite densities, of flat neighbourhoods, are the greatest; NaN is dark grey.
    """
    colours = np.empty((len(density), 3), np.uint8)
    scored = ~np.isnan(density)
    values = np.sort(density[scored])
    rank = np.searchsorted(values, density[scored]) / max(len(values) - 1, 1)
    for channel in range(3):
        ramp = np.interp(rank, np.linspace(0, 1, len(_RAMP)), _RAMP[:, channel])
        colours[scored, channel] = np.rint(ramp)
    colours[~scored] = UNSCORED_COLOUR
    return colours


def _import_rerun() -> Any:
    modules = ("rerun", "rerun.blueprint")
    return optional_package(
        "view needs Rerun", "rerun", "rerun-sdk", *modules, refusal=MissingViewerError
    )


def _corner(points: ResultPoints) -> NDArray[np.float64]:
    return np.asarray(points.xyz.min(axis=0) if len(points.xyz) else np.zeros(3))


def _has_screen() -> bool:
    """Whether a window can be opened, as far as the environment tells."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
