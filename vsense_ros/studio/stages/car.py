"""Car: the vehicle file as a form, a drawing that follows its numbers, and figures beside those of real cars."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nicegui import ui

from vsense_ros.errors import InputError
from vsense_ros.files.names import harmless
from vsense_ros.studio import actions, kit
from vsense_ros.studio.stages.stage import Stage
from vsense_ros.studio.workbench import Workbench

if TYPE_CHECKING:  # the page is shown before it could be imported
    from vsense_ros.prepare.features import Feature

# Paths that the form shows, by heading: those that people measure, look up or identify. The file has all others.
_CHASSIS = (
    "mass",
    "cog_to_front_axle",
    "cog_to_rear_axle",
    "cog_height",
    "roll_inertia",
    "pitch_inertia",
    "yaw_inertia",
)
_AXLE = (
    "track",
    "unloaded_radius",
    "suspension_stiffness",
    "suspension_damping",
    "antiroll_stiffness",
    "roll_centre_height",
    "cornering_scale",
    "tyre_stiffness",
    "hub_mass",
    "wheel_mass",
)
_OTHERS = ("physics.steering.ratio", "physics.aerodynamics.drag_area", "physics.road.friction")
GROUPS: dict[str, tuple[str, ...]] = {
    "Body": (*(f"physics.chassis.{name}" for name in _CHASSIS), *_OTHERS),
    "Front axle": tuple(f"physics.front.{name}" for name in _AXLE),
    "Rear axle": tuple(f"physics.rear.{name}" for name in _AXLE),
}
_CATALOGUE = (
    ("name", "Name", "", "My car"),
    ("mass", "Mass as it is driven", "kg", "1395"),
    ("wheelbase", "Wheelbase", "m", "2.63"),
    ("track", "Track, front", "m", "1.54"),
    ("tyre", "Tyre size", "", "205/55R16 91V"),
    ("axle_load_front", "Mass on the front axle", "kg", "by a rule"),
    ("steering_ratio", "Steering ratio", "-", "by a rule"),
    ("height", "Height of the car", "m", "by a rule"),
)
_TEXTS = ("name", "tyre")
# Figures that are shown at once: those that an engineer would compare with a car that he knows.
MAIN = (
    "understeer_gradient",
    "roll_gradient",
    "front_roll_share",
    "front_share",
    "cog_height_over_track",
    "yaw_inertia_over_arms",
    "bounce_frequency",
    "damping_ratio",
    "wheel_hop_frequency",
    "cornering_per_load",
    "steering_ratio",
)


@lru_cache(maxsize=1)
def allowed_values() -> dict[str, tuple[str, str]]:
    """Meaning and allowed values of the keys of a vehicle file."""
    from vsense_ros.files.schema import parameter_rows

    rows = {}
    for row in parameter_rows():
        for axle in ("front", "rear"):
            rows[row.key.replace("{front, rear}", axle)] = (row.description, row.allowed)
    return rows


def build(bench: Workbench) -> None:
    """Draw the stage."""
    cars = bench.project.cars()
    if bench.vehicle and bench.vehicle not in cars:
        cars[bench.vehicle] = Path(bench.vehicle).stem
    with ui.element("div").classes("vs-row"):
        ui.button("New vehicle", on_click=lambda: _new_vehicle(bench)).props("unelevated no-caps").classes("vs-primary")
        chosen = ui.select(cars, value=bench.vehicle or None, label="Vehicle file", with_input=True)
        chosen.props("dense outlined").classes("vs-select")
        chosen.on_value_change(lambda event: _choose(bench, event.value))
        words = "Drop a vehicle file (.yaml) here, or choose one"
        kit.file_input(bench, words, ".yaml,.yml", lambda paths: _choose(bench, str(paths[0])))
    if not bench.vehicle:
        kit.words("No car yet. Write one from the numbers of a catalogue, or choose a file.")
        return
    _show(bench)


def _choose(bench: Workbench, path: str | None) -> None:
    if path:
        bench.project.state.vehicle = path
        bench.project.save()
        bench.refresh()


def _new_vehicle(bench: Workbench) -> None:
    import vsense_ros as vs

    with ui.dialog() as dialog, ui.card().classes("vs-dialog"):
        ui.html("<h2>New vehicle from catalogue values</h2>", sanitize=False)
        kit.words("All other numbers follow from rules that were derived from public cars, each with a deviation.")
        inputs = {}
        with ui.element("div").classes("vs-form2"):
            for name, label, unit, example in _CATALOGUE:
                field = ui.input(label, placeholder=example).props("dense outlined stack-label")
                inputs[name] = field.props(f'suffix="{unit}"' if unit else "")
            driven = ui.select({"front": "front", "rear": "rear", "all": "all"}, value="front", label="Driven wheels")
            driven.props("dense outlined")

        def values() -> dict[str, Any]:
            content: dict[str, Any] = {"name": "My car", "driven": driven.value}
            for name, label, _, _ in _CATALOGUE:
                text = (inputs[name].value or "").strip()
                if text:
                    content[name] = text if name in _TEXTS else _number(label, text)
            return content

        def write() -> None:
            given = values()
            known: dict[str, Any] = dict.fromkeys(("mass", "wheelbase", "track", "tyre"))
            new = vs.new_vehicle(**known | given)
            path = bench.project.folder / "cars" / f"{harmless(given['name']).replace(' ', '_')}.yaml"
            if path.exists():
                raise InputError(f"{path.name} exists in this project; give the car another name")
            new.write(path)
            bench.page["new_vehicle"] = actions.new_vehicle(str(path), given)
            dialog.close()
            _choose(bench, str(path))

        with ui.element("div").classes("vs-row end"):
            ui.button("Cancel", on_click=dialog.close).props("flat no-caps")
            ui.button("Write the file", on_click=lambda: kit.attempt(write)).props("unelevated no-caps")
    dialog.open()


def _number(label: str, text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        raise InputError(f"{label}: expected a number, found {text!r}") from None


def _show(bench: Workbench) -> None:
    import vsense_ros as vs
    from vsense_ros.prepare.car_check import features, in_words
    from vsense_ros.studio.drawing import drawing

    path = bench.project.inside(bench.vehicle)
    checked = vs.check(path)
    car = checked.vehicle
    if car is None:
        with ui.element("div").classes("vs-failure").props("role=alert"):
            for line in checked.refused.splitlines():
                ui.label(line)
            for finding in checked.findings:
                ui.label(in_words(finding))
        return
    changes: dict[str, float] = {}
    with ui.element("div").classes("vs-columns car"):
        with ui.element("div"), kit.panel(car.name, car.source):
            with ui.element("div").classes("vs-row"):
                ui.button("Save changes", on_click=lambda: kit.attempt(lambda: _save(bench, changes))).props(
                    "unelevated no-caps dense"
                )
                own = path.is_relative_to(bench.project.folder / "cars")
                kit.words(
                    "Changes are written to this file." if own else "Changes are written to a copy in the project."
                )
            for heading, paths in GROUPS.items():
                _group(car, heading, paths, changes)
        with ui.element("div"):
            with kit.panel("Drawing", "to scale, in the design position"):
                ui.html(drawing(car), sanitize=False).classes("vs-drawing")
            with kit.panel("Figures beside those of real cars"):
                every = list(features(car))
                main = [one for one in every if one.name in MAIN or one.off]
                _figures(main, "Main figures of the car")
                with ui.expansion(f"All {len(every)} figures, of body, axles, tyres, sensors and observer").props(
                    "dense"
                ):
                    _figures(every, "All figures of the car")
            if checked.findings:
                with kit.panel("What looks wrong"):
                    kit.sentences([in_words(finding) for finding in checked.findings], "warn")
    if "new_vehicle" in bench.page:
        kit.show_action(bench.page["new_vehicle"])
    kit.show_action(actions.check_vehicle(bench.vehicle))


def _figures(figures: Sequence[Feature], caption: str) -> None:
    rows = []
    for one in figures:
        low, high = one.limits.range
        unit = "" if one.limits.unit == "-" else one.limits.unit
        words = f"{one.limits.meaning}: {one.value:.3g} {unit}, real cars {low:g} to {high:g}"
        name = f"{one.limits.meaning}{f' ({one.place})' if one.place else ''}"
        bar = kit.range_bar(one.value, low, high, words)
        rows.append((name, f"{one.value:.3g}", unit, bar, f"{low:g} … {high:g}"))
    kit.table(("figure", "value", "unit", "", "real cars"), rows, caption, texts=(0, 2, 3))


def _group(car: Any, heading: str, paths: tuple[str, ...], changes: dict[str, float]) -> None:
    with ui.element("fieldset").classes("vs-fields"):
        ui.html(f"<legend>{heading}</legend>", sanitize=False)
        for path in paths:
            value = car.number(path)
            if value is None:
                continue
            unit = car.unit(path)
            stated = car.uncertainty.get(path)
            meaning, allowed = allowed_values().get(path, ("", ""))
            key = path.removeprefix("physics.")
            with ui.element("div").classes("vs-field"):
                label = "steering ratio" if key == "steering.ratio" else key.split(".")[-1].replace("_", " ")
                ui.html(f"<label>{label}</label>", sanitize=False).tooltip(f"{key}: {meaning} ({allowed})")
                field = ui.number(value=float(f"{value:.6g}"), format="%.6g").props(
                    f'dense outlined aria-label="{key}"'
                )
                field.on_value_change(lambda event, path=path: _changed(changes, path, event.value))
                ui.label("" if unit == "-" else unit).classes("unit")
                ui.label(f"± {stated.deviation:.2g}" if stated else "").classes("deviation")
                ui.label(stated.source if stated else allowed).classes("source")


def _changed(changes: dict[str, float], path: str, value: float | None) -> None:
    if value is not None:
        changes[path] = float(value)


def _save(bench: Workbench, changes: dict[str, float]) -> None:
    from pydantic import ValidationError

    from vsense_ros.files.vehicle import load_vehicle, save_changes
    from vsense_ros.model.vehicle import Vehicle

    source = bench.project.inside(bench.vehicle)
    if not changes:
        raise InputError("nothing was changed")
    document = load_vehicle(source).model_dump(mode="json")
    for path, value in changes.items():
        node = document
        *parents, last = path.split(".")
        for part in parents:
            node = node[part]
        node[last] = value
    try:
        car = Vehicle.model_validate(document)
    except ValidationError as error:
        fault = error.errors()[0]
        raise InputError(f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}, found {fault['input']}") from None
    cars = bench.project.folder / "cars"
    target = source if source.is_relative_to(cars) else cars / f"{source.stem}_changed.yaml"
    save_changes(source, target, car, changes)
    ui.notify(f"Written to {target}", position="bottom-right")
    bench.project.state.vehicle = str(target)
    bench.project.save()
    bench.refresh()


STAGE = Stage(
    "car",
    "Car",
    "The vehicle file: numbers with units, deviations and sources, beside those of real cars.",
    build,
    lambda bench: "done" if bench.vehicle else "ready",
)
