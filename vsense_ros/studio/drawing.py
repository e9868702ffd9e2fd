"""A drawing of a car from its vehicle file, to scale: from the side and from above, with sensors and axles."""

from __future__ import annotations

from html import escape

from vsense_ros.model.vehicle import Vehicle

_WIDTH, _SIDE, _TOP = 560, 190, 250  # [px]
_COLOURS = ("#0b63b6", "#b4540a", "#0a7a53", "#8a3ea8", "#a8123e", "#006b7d")


def drawing(car: Vehicle) -> str:
    """The car as SVG: side view above, top view below; x forward is to the left, as in most drawings of cars."""
    chassis, front, rear = car.physics.chassis, car.physics.front, car.physics.rear
    ahead, behind = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
    scale = (_WIDTH - 150) / ((ahead + behind) * 1.62)
    middle = _WIDTH / 2 + (ahead - behind) / 2 * scale
    ground = _SIDE - 26

    def x(forward: float) -> float:
        return middle - forward * scale

    def z(up: float) -> float:
        return ground - up * scale

    parts = [f'<line x1="20" x2="{_WIDTH - 20}" y1="{ground}" y2="{ground}" class="ground"/>']
    body = [
        (ahead + 0.8, 0.32),
        (ahead + 0.75, 0.72),
        (ahead * 0.55, 0.92),
        (ahead * 0.12, 1.36),
        (-behind * 0.6, 1.38),
        (-behind - 0.35, 0.98),
        (-behind - 0.85, 0.92),
        (-behind - 0.85, 0.34),
    ]
    parts.append(f'<polygon class="body" points="{" ".join(f"{x(a):.1f},{z(b):.1f}" for a, b in body)}"/>')
    for axle, place in ((front, ahead), (rear, -behind)):
        radius = axle.unloaded_radius
        parts.append(f'<circle class="wheel" cx="{x(place):.1f}" cy="{z(radius):.1f}" r="{radius * scale:.1f}"/>')
        parts.append(
            f'<circle class="roll" cx="{x(place):.1f}" cy="{z(axle.roll_centre_height):.1f}" r="3">'
            f"<title>roll centre, {axle.roll_centre_height:.3f} m</title></circle>"
        )
    parts.append(_cog(x(0), z(chassis.cog_height)))
    y0 = ground + 16
    for a, b, text in ((ahead, 0.0, f"{ahead:.3f} m"), (0.0, -behind, f"{behind:.3f} m")):
        parts.append(f'<line class="dim" x1="{x(a):.1f}" x2="{x(b):.1f}" y1="{y0}" y2="{y0}"/>')
        parts.append(f'<text x="{(x(a) + x(b)) / 2:.1f}" y="{y0 - 3}" text-anchor="middle">{text}</text>')
    height = f"h {chassis.cog_height:.2f} m"
    parts.append(f'<text x="{x(0) + 9:.1f}" y="{z(chassis.cog_height) - 8:.1f}">{height}</text>')
    parts += _from_above(car, x, scale)
    parts += _sensors(car, x, z, scale, chassis.cog_height)
    label = (
        f"{car.name}: wheelbase {ahead + behind:.3f} m, track {front.track:.2f} and {rear.track:.2f} m, "
        f"centre of gravity {chassis.cog_height:.2f} m above the ground"
    )
    size = f"0 0 {_WIDTH} {_SIDE + _TOP + 40}"
    return f'<svg viewBox="{size}" role="img" aria-label="{escape(label)}">{"".join(parts)}</svg>'


def _cog(x: float, y: float) -> str:
    return (
        f'<circle class="cog" cx="{x:.1f}" cy="{y:.1f}" r="6"/>'
        f'<path class="cogq" d="M{x:.1f},{y:.1f} v-6 a6,6 0 0 1 6,6 z '
        f'M{x:.1f},{y:.1f} v6 a6,6 0 0 1 -6,-6 z"><title>centre of gravity</title></path>'
    )


def _from_above(car: Vehicle, x: object, scale: float) -> list[str]:
    assert callable(x)
    chassis = car.physics.chassis
    ahead, behind = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
    middle = _SIDE + _TOP / 2
    half = max(car.physics.front.track, car.physics.rear.track) / 2 + 0.12
    parts = [
        f'<rect class="body" x="{x(ahead + 0.8):.1f}" y="{middle - half * scale:.1f}" rx="22" '
        f'width="{(ahead + behind + 1.65) * scale:.1f}" height="{2 * half * scale:.1f}"/>'
    ]
    for axle, place in ((car.physics.front, ahead), (car.physics.rear, -behind)):
        reach = axle.track / 2 * scale
        at, radius = x(place), axle.unloaded_radius * scale
        parts.append(
            f'<line class="axle" x1="{at:.1f}" x2="{at:.1f}" y1="{middle - reach:.1f}" y2="{middle + reach:.1f}"/>'
        )
        parts += [
            f'<rect class="wheel" x="{at - radius:.1f}" y="{middle + side * reach - 8:.1f}" width="{2 * radius:.1f}" '
            'height="16" rx="4"/>'
            for side in (-1, 1)
        ]
        parts.append(f'<text x="{at:.1f}" y="{middle + reach + 24:.1f}" text-anchor="middle">{axle.track:.2f} m</text>')
    return [*parts, _cog(x(0), middle)]


def _sensors(car: Vehicle, x: object, z: object, scale: float, height: float) -> list[str]:
    """Sensors with a place on the car, in both views; left of the car is below, as x points to the left."""
    assert callable(x)
    assert callable(z)
    middle = _SIDE + _TOP / 2
    parts = []
    places = ((name, getattr(one, "position", None)) for name, one in car.sensors.items())
    placed: dict[tuple[float, float, float], list[str]] = {}  # names of the sensors in each place
    for name, place in places:
        if place is not None:
            placed.setdefault(tuple(place), []).append(name)
    legend = [(_COLOURS[i % len(_COLOURS)], ", ".join(names)) for i, names in enumerate(placed.values())]
    legend.append(("#d98e1f", "roll centre of each axle"))
    for (forward, left, up), (colour, name) in zip(placed, legend, strict=False):
        about = escape(f"{name}: {forward:+.2f}, {left:+.2f}, {up:+.2f} m from the centre of gravity")
        for px, py in ((x(forward), z(height + up)), (x(forward), middle + left * scale)):
            parts.append(
                f'<rect x="{px - 4:.1f}" y="{py - 4:.1f}" width="8" height="8" fill="{colour}">'
                f"<title>{about}</title></rect>"
            )
    for i, (colour, name) in enumerate(legend):
        left, row = 6 + (_WIDTH - 6) // 3 * (i % 3), _SIDE + _TOP + 12 + 18 * (i // 3)
        parts.append(f'<rect x="{left}" y="{row - 9}" width="8" height="8" fill="{colour}"/>')
        parts.append(f'<text x="{left + 13}" y="{row}">{escape(name)}</text>')
    return parts
