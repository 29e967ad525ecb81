"""The reference map: selected pixels, a descriptor of each place, and how they came about."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import read_archive, write_archive
from edge_vpr.errors import MapError
from edge_vpr.events import Sensor
from edge_vpr.pixels import PixelMap
from edge_vpr.settings import Settings
from edge_vpr.windows import Descriptors

KIND = "reference map"


@dataclass(frozen=True, eq=False)
class ReferenceMap:
    """What a query is matched against.

    Attributes
    ----------
    settings : Settings
        With which it was made; a query is described with the same.
    pixel_map : PixelMap
    places : Descriptors
        One a place, K in all.
    saliency : ndarray of float32, shape (height, width)
        Variance (or mean) that the pixels were drawn from; for figures.
    hot : ndarray of bool, shape (height, width)
        Pixels that were left out.
    """

    settings: Settings
    pixel_map: PixelMap
    places: Descriptors
    saliency: npt.NDArray[np.float32]
    hot: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.places)

    @property
    def bytes_per_place(self) -> int:
        """Size of one descriptor as it is stored, in bytes."""
        return self.places.counts.shape[1] * self.places.counts.itemsize

    def save(self, path: str | Path) -> None:
        """Write as ``.npz``, atomically; `load` gives an equal map back."""
        arrays = {
            "pixel_x": self.pixel_map.x,
            "pixel_y": self.pixel_map.y,
            **self.places.to_arrays(),
            "saliency": self.saliency,
            "hot": self.hot,
        }
        meta = {"settings": self.settings.to_dict(), "sensor": list(self.pixel_map.sensor)}
        write_archive(path, KIND, arrays, meta)

    @classmethod
    def load(cls, path: str | Path) -> ReferenceMap:
        """Read a saved map.

        Raises
        ------
        MapError
            If the file is missing, unreadable, not a map, or from a newer version.
        """
        arrays, meta = read_archive(path, KIND)
        try:
            sensor = Sensor(*meta["sensor"])
            return cls(
                settings=Settings.from_dict(meta["settings"], source=str(path)),
                pixel_map=PixelMap(sensor, arrays["pixel_x"], arrays["pixel_y"]),
                places=Descriptors.from_arrays(arrays),
                saliency=arrays["saliency"],
                hot=arrays["hot"],
            )
        except KeyError as error:
            raise MapError(f"{path} lacks {error}: make the map again") from error
