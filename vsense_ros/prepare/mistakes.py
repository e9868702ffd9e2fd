"""Mistakes that people make in vehicle files, and what the file would be without them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from math import pi
from typing import Any

from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.vehicle import Vehicle

POUND = 0.45359237  # [kg]
DEGREE = pi / 180
Document = dict[str, Any]


@dataclass(frozen=True)
class Mistake:
    """What was probably done, in words; the keys that are wrong; and what puts a file right."""

    words: str
    keys: tuple[str, ...]
    mend: Callable[[Document], None]

    def mended(self, document: Document) -> Vehicle | None:
        """The car of a file's content without the mistake; None if there can be no such car."""
        copy = deepcopy(document)
        try:
            self.mend(copy)
            return Vehicle.model_validate(copy)
        except (ValueError, KeyError, TypeError, IndexError, ZeroDivisionError):
            return None


# By the last part of a key: in which units it is often written instead, and the factor that puts it right.
_UNITS: Mapping[str, tuple[tuple[str, float], ...]] = {
    "mass": (("pounds instead of kg", POUND), ("newtons instead of kg", 1 / GRAVITY), ("tonnes instead of kg", 1e3),
             ("grams instead of kg", 1e-3), ("the mass of a quarter of the car", 4.0)),
    "roll_inertia": (("g m² instead of kg m²", 1e-3), ("lb ft² instead of kg m²", POUND * 0.3048**2),
                     ("slug ft² instead of kg m²", 1.3558)),
    "pitch_inertia": (("g m² instead of kg m²", 1e-3), ("lb ft² instead of kg m²", POUND * 0.3048**2),
                      ("slug ft² instead of kg m²", 1.3558)),
    "yaw_inertia": (("g m² instead of kg m²", 1e-3), ("lb ft² instead of kg m²", POUND * 0.3048**2),
                    ("slug ft² instead of kg m²", 1.3558)),
    "cog_height": (("dm instead of m", 0.1), ("cm instead of m", 0.01), ("feet instead of m", 0.3048),
                   ("m written with the point one place off", 10.0)),
    "hub_mass": (("grams instead of kg", 1e-3), ("newtons instead of kg", 1 / GRAVITY),
                 ("the mass of the axle instead of one corner", 0.5), ("pounds instead of kg", POUND)),
    "wheel_mass": (("grams instead of kg", 1e-3), ("newtons instead of kg", 1 / GRAVITY),
                   ("the mass of the axle instead of one wheel", 0.5), ("pounds instead of kg", POUND)),
    "wheel_spin_inertia": (("g m² or kg dm² instead of kg m²", 1e-2), ("g m² instead of kg m²", 1e-3)),
    "wheel_diametral_inertia": (("kg dm² instead of kg m²", 1e-2), ("g m² instead of kg m²", 1e-3)),
    "suspension_stiffness": (("N/mm instead of N/m", 1e3), ("kN/m instead of N/m", 1e3), ("N/cm instead of N/m", 1e2)),
    "antiroll_stiffness": (("N/mm instead of N/m", 1e3), ("N m/rad instead of N/m at the wheel", 0.5),
                           ("N/km instead of N/m", 1e-3)),
    "suspension_damping": (("N s/mm instead of N s/m", 1e3), ("kN s/m instead of N s/m", 1e3),
                           ("a damping ratio instead of N s/m", 4e3)),
    "tyre_stiffness": (("N/cm instead of N/m", 1e2), ("N/mm instead of N/m", 1e3),
                       ("N/km instead of N/m", 1e-3)),
    "unloaded_radius": (("the diameter instead of the radius", 0.5), ("feet instead of m", 0.3048)),
    "track": (("half the track instead of all of it", 2.0), ("feet instead of m", 0.3048)),
    "cog_to_front_axle": (("feet instead of m", 0.3048),),
    "cog_to_rear_axle": (("feet instead of m", 0.3048),),
    "roll_centre_height": (("dm instead of m", 0.1),),
    "nominal_load": (("kg instead of N", GRAVITY), ("kN instead of N", 1e3)),
    "pneumatic_trail": (("cm instead of m", 0.01), ("mm instead of m", 1e-3)),
    "ratio": (("road-wheel over steering-wheel angle instead of the inverse", -1.0), ("degrees over radians", DEGREE)),
    "gain": (("degrees over radians", DEGREE), ("radians over degrees", 1 / DEGREE), ("the inverse", -1.0)),
    "drag_area": (("square feet instead of m²", 0.3048**2),),
    "rolling_resistance": (("per cent or per thousand instead of a share", 0.1), ("N/kN instead of a share", 1e-3),
                           ("per cent instead of a share", 1e-2)),
    "friction": (("per cent instead of a share", 0.01),),
    "latency": (("ms instead of s", 1e-3),),
    "rate_noise": (("degrees per second instead of rad/s", DEGREE),),
    "rate_offset": (("degrees per second instead of rad/s", DEGREE),),
    "force_noise": (("mg instead of m/s²", GRAVITY * 1e-3),),
    "force_offset": (("mg instead of m/s²", GRAVITY * 1e-3),),
    "attitude": (("degrees instead of radians", DEGREE),),
    "noise": (("cm instead of m", 0.01), ("mm instead of m", 1e-3), ("km/h instead of m/s", 1 / 3.6),
              ("degrees per second instead of rad/s", DEGREE), ("rpm instead of rad/s", pi / 30)),
    "grade": (("degrees instead of radians", DEGREE), ("per cent instead of a slope", 0.01)),
    "bank": (("degrees instead of radians", DEGREE), ("per cent instead of a slope", 0.01)),
    "steering_offset": (("degrees instead of radians", DEGREE),),
    "radius_error": (("per cent instead of a share", 0.01), ("mm instead of a share of the radius", 1 / 330)),
    "load": (("newtons instead of kg", 1 / GRAVITY), ("grams instead of kg", 1e-3)),
}  # fmt: skip
# Units of the force curves of a tyre: all slopes of one direction together.
_CURVES = (
    ("lateral", "initial_slope", "N/deg instead of N/rad", 1 / DEGREE),
    ("lateral", "initial_slope", "kN/rad instead of N/rad", 1e3),
    ("lateral", "initial_slope", "the stiffness of an axle instead of one tyre", 0.5),
    ("longitudinal", "initial_slope", "N per per cent of slip instead of N", 1e2),
    ("longitudinal", "initial_slope", "kN instead of N", 1e3),
)


def mistakes(keys: Collection[str]) -> Iterator[Mistake]:
    """Mistakes that concern one of the dotted keys of a file."""
    for key in sorted(keys):
        *_, name = key.split(".")
        for words, factor in _UNITS.get(name, ()):
            yield Mistake(words, (key,), _scaled((key,), factor))
            if key.startswith("physics.front."):  # the same in both axles, as one writes it
                pair = (key, key.replace(".front.", ".rear."))
                yield Mistake(words, pair, _scaled(pair, factor))
        if name == "force_offset":
            yield Mistake("gravity counted as an offset", (key,), _without_gravity(key))
        if name == "position":
            yield Mistake("z counted downwards instead of upwards", (key,), _reversed(key, 2))
            yield Mistake("y counted to the right, and z downwards", (key,), _reversed(key, 1, 2))
            for factor, unit in ((1e-1, "dm"), (1e-2, "cm"), (1e-3, "mm")):
                yield Mistake(f"{unit} instead of m", (key,), _scaled((key,), factor))
            yield Mistake("the height over the road instead of over cog", (key,), _from_road(key))
        if name == "tyre":
            yield from _tyre_mistakes(key)
    for axle in ("front", "rear"):
        inertias = {f"physics.chassis.{name}_inertia" for name in ("roll", "pitch", "yaw")}
        if axle == "front" and inertias & set(keys):
            for first, second in (("roll", "yaw"), ("roll", "pitch"), ("pitch", "yaw")):
                pair = (f"physics.chassis.{first}_inertia", f"physics.chassis.{second}_inertia")
                yield Mistake(f"{first} and {second} inertia exchanged", pair, _exchanged(*pair))
        wheel = tuple(f"physics.{axle}.wheel_{part}_inertia" for part in ("spin", "diametral"))
        if set(wheel) & set(keys):
            yield Mistake("spin and diametral inertia exchanged", wheel, _exchanged(*wheel))
    arms = ("physics.chassis.cog_to_front_axle", "physics.chassis.cog_to_rear_axle")
    if set(arms) & set(keys):
        yield Mistake("the distances to the front and the rear axle exchanged", arms, _exchanged(*arms))
    if any(key.startswith(("physics.front.", "physics.rear.")) for key in keys):
        bars = ("physics.front.antiroll_stiffness", "physics.rear.antiroll_stiffness")
        yield Mistake("front and rear anti-roll bar exchanged", bars, _exchanged(*bars))
        tyres = ("physics.front.tyre", "physics.rear.tyre")
        yield Mistake("front and rear tyres exchanged", tyres, _exchanged(*tyres))
        axles = ("physics.front", "physics.rear")
        yield Mistake("front and rear axle exchanged", axles, _exchanged(*axles))
    tracks = ("physics.front.track", "physics.rear.track")
    if set(tracks) & set(keys):
        yield Mistake("half the track instead of all of it", tracks, _scaled(tracks, 2.0))


def _tyre_mistakes(key: str) -> Iterator[Mistake]:
    """Wrong units of the force curves of one tyre, or of both."""
    both_tyres = ("physics.front.tyre", "physics.rear.tyre")
    for tyres in ((key,), both_tyres):
        yield Mistake("kN instead of N", tyres, _forces(tyres, 1e3))
        yield Mistake("N instead of kN", tyres, _forces(tyres, 1e-3))
        for direction, field, words, factor in _CURVES:
            paths = tuple(f"{tyre}.{direction}.{load}.{field}" for tyre in tyres for load in ("nominal", "double"))
            yield Mistake(words, paths, _scaled(paths, factor))
        stiffness = tuple(f"{tyre}.cornering_stiffness" for tyre in tyres)
        for words, factor in (("N/deg instead of N/rad", 1 / DEGREE), ("an axle instead of one tyre", 0.5)):
            yield Mistake(words, stiffness, _scaled(stiffness, factor))


def _parent(document: Document, key: str) -> tuple[Any, str]:
    *parents, last = key.split(".")
    node: Any = document
    for part in parents:
        node = node[part]
    return node, last


def _scaled(keys: tuple[str, ...], factor: float) -> Callable[[Document], None]:
    """Multiply numbers by a factor; -1 stands for the inverse."""

    def mend(document: Document) -> None:
        for key in keys:
            node, last = _parent(document, key)
            value = node[last]
            node[last] = 1 / value if factor < 0 else _times(value, factor)

    return mend


def _times(value: Any, factor: float) -> Any:
    return tuple(component * factor for component in value) if isinstance(value, tuple | list) else value * factor


def _exchanged(first_path: str, second_path: str) -> Callable[[Document], None]:
    def mend(document: Document) -> None:
        (first, a), (second, b) = _parent(document, first_path), _parent(document, second_path)
        first[a], second[b] = second[b], first[a]

    return mend


def _reversed(key: str, *axes: int) -> Callable[[Document], None]:
    def mend(document: Document) -> None:
        node, last = _parent(document, key)
        node[last] = tuple(-value if axis in axes else value for axis, value in enumerate(node[last]))

    return mend


def _without_gravity(key: str) -> Callable[[Document], None]:
    def mend(document: Document) -> None:
        node, last = _parent(document, key)
        x, y, z = node[last]
        node[last] = (x, y, z - GRAVITY if z > 0 else z + GRAVITY)

    return mend


def _from_road(key: str) -> Callable[[Document], None]:
    def mend(document: Document) -> None:
        node, last = _parent(document, key)
        x, y, z = node[last]
        node[last] = (x, y, z - document["physics"]["chassis"]["cog_height"])

    return mend


def _forces(tyres: tuple[str, ...], factor: float) -> Callable[[Document], None]:
    """Multiply all forces of TMeasy tyres."""

    def mend(document: Document) -> None:
        for key in tyres:
            node, last = _parent(document, key)
            for direction in ("longitudinal", "lateral"):
                for curve in node[last][direction].values():
                    for name in ("initial_slope", "maximum", "sliding"):
                        curve[name] *= factor

    return mend
