"""What the designation of a tyre says: its radius, its width and the load that it carries.

`205/55R16 91V` is a tyre 205 mm wide whose sidewall is 55 % of that high, on a rim of 16 inches, with the load index 91
(ETRTO Standards Manual). `16x7.5-10` is a racing tyre of 16 inches diameter, 7.5 inches wide, on a rim of 10 inches.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from vsense_ros.errors import InputError
from vsense_ros.model.constants import GRAVITY

INCH = 0.0254  # [m]
_METRIC = re.compile(
    r"(?:P|LT)?(\d{3})\s*/\s*(\d{2,3})\s*Z?[RBD-]?F?\s*(\d{2}(?:\.5)?)C?\s*(?:XL\s*)?(\d{2,3})?", re.IGNORECASE
)
_INCHES = re.compile(r"(\d{2}(?:\.\d+)?)\s*[x/]\s*(\d{1,2}(?:\.\d+)?)\s*[-R]\s*(\d{1,2})", re.IGNORECASE)


@dataclass(frozen=True)
class TyreSize:
    """A tyre by its designation; lengths in metres."""

    designation: str
    width: float  # of the section
    rim: float  # diameter of the rim
    height: float  # of the sidewall
    load_index: int | None = None

    @property
    def radius(self) -> float:
        """Radius of the unloaded tyre [m]."""
        return self.rim / 2 + self.height

    @property
    def aspect(self) -> float:
        """Height of the sidewall over the width [-]."""
        return self.height / self.width

    @property
    def stated_load(self) -> float | None:
        """Load that the load index allows [N]: 450 kg for 80, ten times as much for 80 more (ETRTO)."""
        return None if self.load_index is None else 450.0 * 10 ** ((self.load_index - 80) / 80) * GRAVITY

    @property
    def usual_load(self) -> float:
        """Load that tyres of this size usually carry [N], as the rule `load_capacity` has it."""
        return 279.95e3 * self.width**1.733 * self.aspect**0.910 * self.rim**0.651

    def vertical_stiffness(self, pressure: float) -> float:
        """Vertical stiffness [N/m] at a pressure [Pa] (Rhyne 2005, Tire Science and Technology 33, eq. 14, which is in
        kg/mm, kPa and mm)."""
        width, rim, aspect = 1e3 * self.width, 1e3 * self.rim, 100 * self.aspect
        shape = (1.03 - 0.004 * aspect) * width * (width * aspect / 50 + rim)
        return (0.00028 * pressure / 1e3 * shape**0.5 + 3.45) * 1e3 * GRAVITY


def tyre_size(designation: str) -> TyreSize:
    """The size that a designation names. Raises `InputError` for one that names none."""
    text = designation.strip()
    if match := _METRIC.match(text):
        width, aspect, rim, index = match.groups()
        section = float(width) * 1e-3
        return TyreSize(text, section, float(rim) * INCH, section * float(aspect) / 100, int(index) if index else None)
    if match := _INCHES.match(text):
        outer, across, rim = (float(part) * INCH for part in match.groups())
        if outer > rim:
            return TyreSize(text, across, rim, (outer - rim) / 2)
    raise InputError(f"--tyre: expected a size such as 205/55R16 or 205/55R16 91V, found {designation!r}")
