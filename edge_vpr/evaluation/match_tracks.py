"""Matches as a track: the position of each matched place over time, for maps and for evo."""

from __future__ import annotations

import datetime as dt
import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.evaluation.tracks import Floats
from edge_vpr.events import UNIX_US
from edge_vpr.files import replacing
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap

SUFFIXES = (".gpx", ".geojson", ".tum")
_UNIX_ZERO = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
_GPX = "http://www.topografix.com/GPX/1/1"


def check_track_file(path: str | Path, reference: ReferenceMap) -> None:
    """Check that matches with a map can be written to a file of this name.

    Parameters
    ----------
    path : str or Path
        Ends in one of `SUFFIXES`.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(
            f"{path} is no format of tracks: name it for example track{', track'.join(SUFFIXES)}"
        )
    if reference.route is None and (suffix != ".tum" or reference.odometer_mm is None):
        raise UsageError(
            f"{path} needs the positions of the places, which the map does not have: make it with "
            "track=" + (" or odometry=" if suffix == ".tum" else "")
        )
    if suffix != ".tum" and reference.route is not None and reference.route.kind != "geographic":
        raise UsageError(
            f"{path} needs latitudes and longitudes, and the map has metres: write a .tum file, or "
            "make the map with a GPS log (track=)"
        )


def save_match_track(
    path: str | Path, reference: ReferenceMap, matches: Matches, *, start_us: int | None = None
) -> int:
    """Write the positions of the matched places as a track, atomically.

    Matches with a place of unknown position are left out, as are lost ones, except in GeoJSON,
    where they are marked. Of several matches at one time, the last is taken.

    Parameters
    ----------
    path : str or Path
        ``.gpx``: one track. ``.geojson``: a point for each match, with its time, place, probability
        and metres along the route. ``.tum``: seconds, metres and no rotation, as evo reads it; of
        geographic positions, metres east and north of the first place of the map, which a comment
        names.
    start_us : int, optional
        Start of the recording on its own clock (`Recording.start_us`). Where that clock counts from
        1970, the points of a ``.gpx`` have dates, else they have no time.

    Returns
    -------
    int
        Number of points written.
    """
    check_track_file(path, reference)
    suffix = Path(path).suffix.lower()
    position = _positions(reference)[matches.place]
    kept = np.isfinite(position).all(axis=1)
    kept &= np.diff(matches.time_us, append=matches.time_us[-1] + 1) > 0
    if suffix != ".geojson":
        kept &= ~matches.lost
    rows = np.flatnonzero(kept)
    if suffix == ".gpx":
        dated = start_us is not None and start_us >= UNIX_US
        text = _gpx(reference, matches, rows, start_us if dated else None)
    else:
        text = (_geojson if suffix == ".geojson" else _tum)(reference, matches, rows)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return len(rows)


def _positions(reference: ReferenceMap) -> Floats:
    """Return the positions of the places, or the metres along the route, shape (K, d)."""
    if reference.route is not None:
        return reference.route.position
    assert reference.odometer_mm is not None
    return reference.odometer_mm[:, None] / 1e3


Rows = npt.NDArray[np.intp]


def _gpx(reference: ReferenceMap, matches: Matches, rows: Rows, start_us: int | None) -> str:
    root = ElementTree.Element("gpx", version="1.1", creator="edge-vpr", xmlns=_GPX)
    segment = ElementTree.SubElement(ElementTree.SubElement(root, "trk"), "trkseg")
    position = _positions(reference)[matches.place]
    for i in rows:
        latitude, longitude = (f"{value:.7f}" for value in position[i])
        point = ElementTree.SubElement(segment, "trkpt", lat=latitude, lon=longitude)
        if start_us is not None:
            time = _UNIX_ZERO + dt.timedelta(microseconds=start_us + int(matches.time_us[i]))
            ElementTree.SubElement(point, "time").text = time.isoformat().replace("+00:00", "Z")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _geojson(reference: ReferenceMap, matches: Matches, rows: Rows) -> str:
    route = reference.route
    assert route is not None
    rejects = matches.settings.precision is not None
    points = []
    for i in rows:
        place, probability = int(matches.place[i]), float(matches.probability[i])
        latitude, longitude = route.position[place].round(7).tolist()
        values = {
            "time_s": int(matches.time_us[i]) / 1e6,
            "place": place,
            "probability": None if np.isnan(probability) else round(probability, 4),
            "lost": bool(matches.lost[i]) if rejects else None,
            "along_m": round(float(route.along_m[place]), 2),
        }
        point = {"type": "Point", "coordinates": [longitude, latitude]}
        points.append({"type": "Feature", "geometry": point, "properties": values})
    return json.dumps({"type": "FeatureCollection", "features": points}, indent=1) + "\n"


def _tum(reference: ReferenceMap, matches: Matches, rows: Rows) -> str:
    position, route = _positions(reference), reference.route
    lines = ["# time_s x_m y_m z_m qx qy qz qw"]
    if route is not None and route.kind == "geographic":
        origin = "latitude {:.7f}, longitude {:.7f}".format(*route.origin)
        lines.append(f"# x east and y north of {origin}")
        position = route.metres(position)
    metres = np.zeros((len(position), 3))
    metres[:, : position.shape[1]] = position
    for i in rows:
        x, y, z = metres[matches.place[i]]
        lines.append(f"{matches.time_us[i] / 1e6:.6f} {x:.3f} {y:.3f} {z:.3f} 0 0 0 1")
    return "\n".join(lines) + "\n"
