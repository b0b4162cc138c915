"""The sample as the page holds it: a few bytes a point, in base64.

Coordinates are rounded to the 65,535th part of the map's extent and densities to a 255th of their
range, which is finer than a screen shows. Nothing but pictures is made of them.
"""

import base64
import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from dynahull.labels import Label
from pipeline.outputs.map_sample import MapSample, magnitude
from pipeline.report_page.percentages import NEVER, Percentages

PERCENT_CODES = 600
"""Codes for each percent of the slider."""

NEVER_CODE = 65_535

_ICON_SIZE = (192, 128)
_MOST = 65_535
_NO_DENSITY = 255
_OUTLIERS = 0.001
"""Share of the points, at either end of an axis, that do not decide what the views show."""


@dataclass(frozen=True, slots=True)
class EncodedSample:
    """What the page's scripts read."""

    arrays: dict[str, str]
    """Base64 of little-endian numbers, by name."""
    facts: dict[str, Any]
    """How to read them."""


def encode(sample: MapSample, percentages: Percentages) -> EncodedSample:
    """Encode a sample, and the percentages of the same points."""
    low, high = view_bounds(sample.xyz)
    shown = np.flatnonzero(((sample.xyz >= low) & (sample.xyz <= high)).all(axis=1))
    span = np.where(high > low, high - low, 1.0)
    places = np.rint((sample.xyz[shown] - low) / span * _MOST)
    labels = sample.labels[shown]
    density, density_range = _density_codes(sample.density[shown])
    arrays = {
        "places": places.astype("<u2"),
        "percentages": _percentage_codes(percentages)[shown],
        # The percentage decides between static and dynamic.
        "labels": np.where(labels == Label.DYNAMIC, np.uint8(Label.STATIC), labels),
        "clusters": (sample.cluster[shown] % 250).astype(np.uint8),
        "densities": density,
    }
    facts = {
        "count": len(shown),
        "outside": len(sample) - len(shown),
        "sampled": len(sample),
        "total": sample.total,
        "low": low.tolist(),
        "span": span.tolist(),
        "own": percentages.own,
        "own_code": _own_code(percentages.own),
        "density_range": density_range,
        "margin": percentages.margin,
    }
    seen, scans = _seen(sample, shown)
    encoded = {
        name: base64.b64encode(array.tobytes()).decode() for name, array in (arrays | seen).items()
    }
    return EncodedSample(encoded, facts | scans)


def _seen(
    sample: MapSample, shown: NDArray[np.intp]
) -> tuple[dict[str, NDArray[Any]], dict[str, list[int]]]:
    """Return scans, from 1 on and 0 where not known, what they saw, and the first and the last."""
    scan = np.empty(0, np.int64) if sample.scan is None else sample.scan[shown].astype(np.int64)
    known = scan[scan >= 0]
    if not len(known) or known.min() == known.max():
        return {}, {}
    first, last = int(known.min()), int(known.max())
    numbers = np.rint((scan - first) / max((last - first) / (_MOST - 1), 1)) + 1
    arrays = {"scans": _narrow(np.where(scan < 0, 0, numbers))}
    if sample.met is not None and sample.through is not None:
        arrays |= {"met": _narrow(sample.met[shown]), "through": _narrow(sample.through[shown])}
    return arrays, {"scans": [first, last]}


def _narrow(values: NDArray[Any]) -> NDArray[Any]:
    """Return numbers as bytes, where each is one, or as two bytes each."""
    kind: DTypeLike = np.uint8 if values.max() < 256 else "<u2"
    return np.asarray(np.minimum(values, _MOST), kind)


def view_bounds(xyz: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the box that the views show: all points but those far away from nearly all others."""
    if not len(xyz):
        return np.zeros(3), np.ones(3)
    near, far = np.quantile(xyz, [_OUTLIERS, 1 - _OUTLIERS], axis=0)
    spread = far - near
    margin = np.maximum(spread, spread.max() / 10) / 2
    return (np.maximum(xyz.min(axis=0), near - margin), np.minimum(xyz.max(axis=0), far + margin))


def icon(sample: MapSample) -> str:
    """Return the map from above as a small picture, a data URI: what is removed is orange."""
    wide, tall = _ICON_SIZE
    low, high = view_bounds(sample.xyz)
    span = max((high[0] - low[0]) / wide, (high[1] - low[1]) / tall, 1e-9)
    cells = np.floor((sample.xyz[:, :2] - low[:2]) / span).astype(np.int64)
    inside = ((cells >= 0) & (cells < _ICON_SIZE)).all(axis=1)
    colours = np.zeros((tall, wide), np.uint8)
    for label, code in ((Label.GROUND, 1), (Label.STATIC, 2), (Label.DYNAMIC, 3)):
        x, y = cells[inside & (sample.labels == label)].T
        colours[tall - 1 - y, x] = code
    rows = b"".join(b"\0" + row.tobytes() for row in colours)
    parts = [
        (b"IHDR", struct.pack(">IIBBBBB", wide, tall, 8, 3, 0, 0, 0)),
        (b"PLTE", bytes([255, 255, 255, 205, 200, 190, 43, 108, 163, 213, 94, 0])),
        (b"IDAT", zlib.compress(rows, 9)),
        (b"IEND", b""),
    ]
    image = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
    return f"data:image/png;base64,{base64.b64encode(image).decode()}"


def _own_code(own: float) -> int:
    return round(own * PERCENT_CODES)


def _percentage_codes(percentages: Percentages) -> NDArray[np.uint16]:
    """Round percentages, so that just what the run removed is at or below its own code."""
    own = _own_code(percentages.own)
    codes = np.full(len(percentages.removed_from), NEVER_CODE, "<u2")
    known = percentages.removed_from < NEVER
    code = np.rint(percentages.removed_from[known] * PERCENT_CODES)
    removed = percentages.removed_from[known] <= percentages.own
    codes[known] = np.where(removed, np.minimum(code, own), np.maximum(code, own + 1))
    return codes


def _density_codes(
    density: NDArray[np.float64],
) -> tuple[NDArray[np.uint8], tuple[float, float] | None]:
    """Round the logarithm of densities within the range that nearly all of them have."""
    codes = np.full(len(density), _NO_DENSITY, np.uint8)
    finite = np.isfinite(density)
    if not finite.any():
        return codes, None
    low, high = np.quantile(magnitude(density[finite]), [0.005, 0.995]).tolist()
    place = (magnitude(density[finite]) - low) / ((high - low) or 1.0)
    codes[finite] = np.rint(np.clip(place, 0, 1) * (_NO_DENSITY - 1))
    return codes, (low, high)
