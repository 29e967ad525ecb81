"""Moving objects: oncoming cars, cars ahead, cyclists, people who cross the road."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.simulate.drive import Drive, Motion
from edge_vpr.simulate.texture import noise_2d
from edge_vpr.simulate.view import CAMERA_M, View

_TRAFFIC = 31
NEAREST_M, FURTHEST_M = 2.5, 60.0


class Mover(NamedTuple):
    """A flat figure that faces the camera and moves at constant velocity."""

    picture: npt.NDArray[np.float32]
    """Light and cover, shape (rows from below, columns, 2), transparent at its rim."""
    width_m: float
    height_m: float
    position_m: float
    """Place on the route at time 0."""
    speed_mps: float
    x_m: float
    """Place across the road at time 0; positive is right."""
    x_mps: float


def traffic(drive: Drive, motion: Motion, seed: int) -> list[Mover]:
    """Draw the moving objects of a drive at random.

    Parameters
    ----------
    drive : Drive
    motion : Motion
        When the camera is where: each mover is placed so that it is met.
    seed : int
    """
    rng = np.random.default_rng((seed, _TRAFFIC))
    length_m = float(motion.position_m[-1])
    movers = []
    for at in rng.uniform(0, length_m, rng.poisson(drive.traffic_per_km * length_m / 1000)):
        met_s = float(np.interp(at, motion.position_m, motion.time_us)) / 1e6
        kind = rng.choice(("oncoming", "ahead", "crossing", "cyclist"), p=(0.45, 0.15, 0.25, 0.15))
        x, x_mps = 1.5, 0.0
        if kind == "oncoming":
            picture, width, height = _car(rng), 1.8, 1.5
            speed, ahead = -rng.uniform(5, 12), 0.0
        elif kind == "ahead":  # pulls in before the camera and draws away from it
            picture, width, height = _car(rng), 1.8, 1.5
            speed, ahead, x = drive.speed_mps * rng.uniform(1.0, 1.3), rng.uniform(6, 15), -1.3
        elif kind == "crossing":
            picture, width, height = _figure(rng), 0.6, 1.75
            speed, ahead = 0.0, rng.uniform(4, 12)
            x_mps = rng.uniform(0.9, 1.8) * rng.choice((-1, 1))
            x = 0.0
        else:
            picture, width, height = _figure(rng), 0.7, 1.8
            speed, ahead, x = rng.uniform(2, 5), 5.0, -3.0
        position = at + ahead - speed * met_s
        movers.append(
            Mover(picture, width, height, position, float(speed), x - x_mps * met_s, float(x_mps))
        )
    return movers


def _car(rng: np.random.Generator) -> npt.NDArray[np.float32]:
    body = rng.choice((0.05, 0.1, 0.25, 0.5, 0.8))
    picture = np.zeros((17, 20, 2), np.float32)
    picture[1:11, 1:-1] = body, 1
    picture[11:16, 3:-3] = 0.6 * body, 1
    picture[11:15, 4:-4] = 0.06, 1
    picture[6:8, 2:5] = picture[6:8, -5:-2] = 0.9, 1
    picture[1:3, 1:-1] = 0.03, 1
    picture[4:6, 8:-8] = 0.6, 1
    return _premultiplied(picture)


def _figure(rng: np.random.Generator) -> npt.NDArray[np.float32]:
    picture = np.zeros((20, 9, 2), np.float32)
    picture[1:9, 2:4] = picture[1:9, 5:7] = rng.uniform(0.04, 0.2), 1
    picture[9:16, 1:8] = rng.uniform(0.05, 0.8), 1
    picture[16:19, 3:6] = rng.uniform(0.15, 0.4), 1
    picture[..., 0] *= 1 + 0.3 * noise_2d(rng, (20, 9), (2, 2))
    return _premultiplied(picture)


def _premultiplied(picture: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    picture[..., 0] *= picture[..., 1]
    return picture


def paint_traffic(
    movers: list[Mover], view: View, time_us: int, position_m: float, frame: npt.NDArray[np.float32]
) -> None:
    """Paint the visible objects over a frame of the street, the farthest first.

    Parameters
    ----------
    movers : list of Mover
    view : View
    time_us : int
    position_m : float
        Place of the camera.
    frame : ndarray of float32, shape of the view
        Is drawn upon.
    """
    seconds = time_us / 1e6
    seen = []
    for mover in movers:
        ahead = mover.position_m + mover.speed_mps * seconds - position_m
        x = mover.x_m + mover.x_mps * seconds - view.lane_m
        if NEAREST_M < ahead < FURTHEST_M and abs(x) < 5.0:
            seen.append((ahead, x, mover))
    for ahead, x, mover in sorted(seen, key=lambda item: -item[0]):
        corners = np.array(
            [
                (x + side * mover.width_m / 2, CAMERA_M - height, ahead)
                for side in (-1, 1)
                for height in (0.0, mover.height_m)
            ]
        )
        # from the street's axes to the camera's, then through the pinhole
        seen_at = corners @ view.turn
        columns = seen_at[:, 0] / seen_at[:, 2] * view.focal + (view.shape[1] - 1) / 2
        rows = seen_at[:, 1] / seen_at[:, 2] * view.focal + (view.shape[0] - 1) / 2
        top, bottom = max(int(rows.min()) - 1, 0), min(int(rows.max()) + 2, view.shape[0])
        left, right = max(int(columns.min()) - 1, 0), min(int(columns.max()) + 2, view.shape[1])
        if top < bottom and left < right:
            _paint(
                mover.picture, mover.width_m, mover.height_m, x, ahead,
                view.across, view.down, top, bottom, left, right, frame,
            )  # fmt: skip


@kernel
def _paint(
    picture: Any, width: float, height: float, x: float, ahead: float, across: Any, down: Any,
    top: int, bottom: int, left: int, right: int, frame: Any,
) -> None:  # fmt: skip
    rows, columns = picture.shape[0], picture.shape[1]
    for r in range(top, bottom):
        for c in range(left, right):
            column = ((ahead * across[r, c] - x) / width + 0.5) * columns - 0.5
            row = (CAMERA_M - ahead * down[r, c]) / height * rows - 0.5
            if not (0 <= column < columns - 1 and 0 <= row < rows - 1):
                continue
            i, j = int(row), int(column)
            u, v = np.float32(row - i), np.float32(column - j)
            one = np.float32(1.0)
            a, b, d, e = (one - u) * (one - v), (one - u) * v, u * (one - v), u * v
            light = (
                a * picture[i, j, 0]
                + b * picture[i, j + 1, 0]
                + d * picture[i + 1, j, 0]
                + e * picture[i + 1, j + 1, 0]
            )
            cover = (
                a * picture[i, j, 1]
                + b * picture[i, j + 1, 1]
                + d * picture[i + 1, j, 1]
                + e * picture[i + 1, j + 1, 1]
            )
            frame[r, c] = light + (one - cover) * frame[r, c]
