"""How a neighbourhood is spread: the principal axes of its points (second moments)."""

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.decorators import inlined
from dynahull.kernels.frame import Neighbourhood

_SWEEPS = 6
"""Of Jacobi's rotations: they converge quadratically, the third is the last that changes much."""

_NEGLIGIBLE = 1e-15
"""Of the trace: smaller elements beside the diagonal change no digit of a float32."""


@inlined
def measure_spread(points: Neighbourhood, count: int, spread: NDArray[np.float32]) -> None:
    """Write down how a neighbourhood is spread.

    Parameters
    ----------
    points : Neighbourhood
        `offset` given, each of `count` places once.
    spread : (SPREAD_COLUMNS,) float32 array
        Overwritten by thickness, width and length (standard deviations along the principal axes,
        metres), |z| of the normal, and the distance from the query to the mean.
    """
    size = np.uint64(count)
    x, y, z = points.offset
    mx = my = mz = 0.0
    for i in range(size):
        mx += x[i]
        my += y[i]
        mz += z[i]
    mx, my, mz = mx / count, my / count, mz / count
    xx = xy = xz = yy = yz = zz = 0.0
    for i in range(size):
        dx, dy, dz = x[i] - mx, y[i] - my, z[i] - mz
        xx += dx * dx
        xy += dx * dy
        xz += dx * dz
        yy += dy * dy
        yz += dy * dz
        zz += dz * dz
    least, middle, most, normal = principal_axes(xx, xy, xz, yy, yz, zz)
    spread[0] = np.sqrt(least / count)
    spread[1] = np.sqrt(middle / count)
    spread[2] = np.sqrt(most / count)
    spread[3] = normal
    spread[4] = np.sqrt(mx * mx + my * my + mz * mz)


@inlined
def principal_axes(
    xx: float, xy: float, xz: float, yy: float, yz: float, zz: float
) -> tuple[float, float, float, float]:
    """Return the eigenvalues of a symmetric matrix, ascending, and |z| of the first eigenvector.

    Only sums, products, quotients and square roots, in a fixed order: the same bits everywhere.
    """
    # The last row of the eigenvectors: the z of each axis.
    ux, uy, uz = 0.0, 0.0, 1.0
    limit = _NEGLIGIBLE * (xx + yy + zz)
    for _ in range(_SWEEPS):
        if abs(xy) + abs(xz) + abs(yz) <= limit:
            break
        xx, yy, xy, xz, yz, ux, uy = _rotated(xx, yy, xy, xz, yz, ux, uy)
        xx, zz, xz, xy, yz, ux, uz = _rotated(xx, zz, xz, xy, yz, ux, uz)
        yy, zz, yz, xy, xz, uy, uz = _rotated(yy, zz, yz, xy, xz, uy, uz)
    least, normal = xx, ux
    if yy < least:
        least, normal = yy, uy
    if zz < least:
        least, normal = zz, uz
    most = max(xx, yy, zz)
    middle = (xx + yy + zz) - least - most
    return max(least, 0.0), max(middle, 0.0), most, abs(normal)


@inlined
def _rotated(
    pp: float, qq: float, pq: float, pr: float, qr: float, up: float, uq: float
) -> tuple[float, float, float, float, float, float, float]:
    """Rotate axes p and q so that pq vanishes (Jacobi; Golub and Van Loan, section 8.5)."""
    if pq == 0.0:
        return pp, qq, pq, pr, qr, up, uq
    theta = (qq - pp) / (2.0 * pq)
    tangent = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
    if theta < 0.0:
        tangent = -tangent
    cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    return (
        pp - tangent * pq,
        qq + tangent * pq,
        0.0,
        cosine * pr - sine * qr,
        sine * pr + cosine * qr,
        cosine * up - sine * uq,
        sine * up + cosine * uq,
    )
