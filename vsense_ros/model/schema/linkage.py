"""The linkages of a vehicle file: hard points and masses of its suspensions, for the car with all its bodies.

Hard points are those of the left wheel in the design position, measured from its centre in the axes of the vehicle
(ISO 8855: x forward, y left, z up; so points on the chassis have negative y). The right wheel is its mirror image.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from vsense_ros.model.parameter import Part, Triple, parameter

SHORTEST = 0.02  # [m] between the ends of a link


def _point(description: str) -> Triple:
    result: Triple = parameter("m", description)
    return result


class Link(Part):
    """A rod with a ball joint at each end."""

    inner: Triple = _point("centre of the joint on the chassis, or on the rack for a tie rod that steers")
    outer: Triple = _point("centre of the joint on the upright")
    mass: float = parameter("kg", "mass", gt=0, default=0.5)

    @model_validator(mode="after")
    def _has_a_length(self) -> Link:
        _apart(self.inner, self.outer, "inner", "outer")
        return self


class Wishbone(Part):
    """A control arm that turns about the line through its two joints on the chassis."""

    front: Triple = _point("front joint on the chassis")
    rear: Triple = _point("rear joint on the chassis")
    outer: Triple = _point("centre of the ball joint on the upright")
    mass: float = parameter("kg", "mass", gt=0, default=1.5)

    @model_validator(mode="after")
    def _has_an_axis(self) -> Wishbone:
        _apart(self.front, self.rear, "front", "rear")
        _apart(self.front, self.outer, "front", "outer")
        _apart(self.rear, self.outer, "rear", "outer")
        return self


class Strut(Part):
    """Spring and damper about one line. Their rates follow from `suspension_stiffness` and `suspension_damping` at the
    wheel and the ratio of the linkage; the preload makes the design position that of rest."""

    upper: Triple = _point("joint on the chassis")
    lower: Triple = _point("joint on the lower wishbone, or on the upright of a five-link suspension")
    tube_mass: float = parameter("kg", "mass of the part on the chassis", gt=0, default=1.0)
    rod_mass: float = parameter("kg", "mass of the part that slides in it", gt=0, default=1.0)

    @model_validator(mode="after")
    def _has_a_length(self) -> Strut:
        _apart(self.upper, self.lower, "upper", "lower")
        return self


class DoubleWishbone(Part):
    """Two wishbones, an upright, a tie rod, and a strut of two bodies on the lower wishbone."""

    kind: Literal["double_wishbone"] = "double_wishbone"
    lower: Wishbone
    upper: Wishbone
    tie_rod: Link
    strut: Strut
    steered: bool = Field(description="whether the rack moves the inner joint of the tie rod", default=False)
    tie_rod_length: float | None = Field(
        description="length of the tie rod where it is not the distance of its points: sets the toe angle [m]",
        default=None, gt=0, json_schema_extra={"unit": "m"},
    )  # fmt: skip
    gyration: float = parameter("m", "radius of gyration of the upright", gt=0, lt=1, default=0.07)

    def link_masses(self) -> float:
        """Mass of everything but upright and wheel [kg]."""
        strut = self.strut.tube_mass + self.strut.rod_mass
        return self.lower.mass + self.upper.mass + self.tie_rod.mass + strut


class FiveLink(Part):
    """Five rods between chassis and upright, spring and damper between chassis and upright.

    Two wishbones and a toe link are the special case in which two pairs of rods share an outer joint.
    """

    kind: Literal["five_link"] = "five_link"
    links: tuple[Link, Link, Link, Link, Link]
    strut: Strut
    gyration: float = parameter("m", "radius of gyration of the upright", gt=0, lt=1, default=0.07)

    @property
    def steered(self) -> bool:
        """False, as no rack moves the links of this suspension."""
        return False

    def link_masses(self) -> float:
        """Mass of everything but upright and wheel [kg]; the strut's is counted with the upright."""
        return sum(link.mass for link in self.links)


Suspension = Annotated[DoubleWishbone | FiveLink, Field(discriminator="kind")]


class Linkages(Part):
    """The suspensions of both axles."""

    front: Suspension
    rear: Suspension


def _apart(a: Triple, b: Triple, first: str, second: str) -> None:
    distance = sum((x - y) ** 2 for x, y in zip(a, b, strict=True)) ** 0.5
    if distance < SHORTEST:
        raise ValueError(
            f"{first} {a} and {second} {b} are {1e3 * distance:.3g} mm apart; at least {1e3 * SHORTEST:g} mm are needed"
        )
