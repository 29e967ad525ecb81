"""The reference map: selected pixels, a descriptor of each place, and how they came about."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import read_archive, write_archive
from edge_vpr.descriptors.codes import codes_of
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors, narrow
from edge_vpr.errors import MapError
from edge_vpr.events import Sensor
from edge_vpr.settings import Settings
from fixedpoint.codes import PixelCodes, packed_bytes

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
    full_scale : ndarray of uint16, shape (J,), optional
        Of each counter's code, where the settings scale it to each pixel.
    """

    settings: Settings
    pixel_map: PixelMap
    places: Descriptors
    saliency: npt.NDArray[np.float32]
    hot: npt.NDArray[np.bool_]
    full_scale: npt.NDArray[np.uint16] | None = None

    def __len__(self) -> int:
        return len(self.places)

    def __repr__(self) -> str:
        return (
            f"ReferenceMap({len(self)} places, {len(self.pixel_map)} pixels of "
            f"{self.pixel_map.sensor}, {self.counter_bits} bits a counter)"
        )

    @property
    def codes(self) -> PixelCodes | None:
        """What the places hold in place of event counts; None where they hold those."""
        return codes_of(self.settings, self.places.counts.shape[1], self.full_scale)

    def coded(self, counted: Descriptors) -> Descriptors:
        """Put codes in place of counts, as in the places of this map."""
        if self.codes is None:
            return counted
        return replace(counted, counts=narrow(self.codes.encode(counted.counts)))

    def decoded(self, descriptors: Descriptors) -> Descriptors:
        """Put counts back in place of codes, each in the middle of its code's, for plots."""
        if self.codes is None:
            return descriptors
        return replace(descriptors, counts=narrow(self.codes.decode(descriptors.counts)))

    @property
    def bytes_per_place(self) -> int:
        """Size of one descriptor as it is stored and compared here, in bytes."""
        return self.places.counts.shape[1] * self.places.counts.itemsize

    @property
    def counter_bits(self) -> int:
        """Bits of each counter of a descriptor: of its code, or of the count as stored."""
        code = self.settings.shared_code
        return 8 * self.places.counts.itemsize if code is None else code.bits

    @property
    def packed_bytes_per_place(self) -> int:
        """Size of one descriptor where codes are packed without gaps, in bytes."""
        return packed_bytes(self.places.counts.shape[1], self.counter_bits)

    def save(self, path: str | Path) -> None:
        """Write as ``.npz``, atomically; `load` gives an equal map back."""
        arrays = {
            "pixel_x": self.pixel_map.x,
            "pixel_y": self.pixel_map.y,
            **self.places.to_arrays(),
            "saliency": self.saliency,
            "hot": self.hot,
        }
        if self.full_scale is not None:
            arrays["full_scale"] = self.full_scale
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
                full_scale=arrays.get("full_scale"),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise MapError(f"{path} is damaged or lacks {error}: make the map again") from error
