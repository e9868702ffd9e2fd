"""An observer, or the car itself, as a functional mock-up unit (FMI 2.0 and 3.0, co-simulation), with sources.

The unit is the C of `export.c` with the functions of the standard around it: no Python, no library but libm, no global
state. Measurements are inputs, of which a count says that they are new: what is set before a step was measured at its
beginning. As a plant the same model moves without any measurement, driven by steering and wheel torques. Outputs are
those at the end of the last step. None depends on an input of the same time: directional derivatives, which the
standard means at one point in time, would all be zero, and are not declared.

Headers of the standard and the list of its functions come from FMPy (BSD-2, as the standard's headers themselves).
"""

from __future__ import annotations

import hashlib
import platform
import re
import shutil
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import jinja2

from vsense_ros.codegen.forms import number
from vsense_ros.errors import InputError
from vsense_ros.export import c, terminals
from vsense_ros.export.c import Contents, Observer
from vsense_ros.export.entries import INPUT_ENTRIES, Entry, Sensor, Variable
from vsense_ros.export.sources import compile_library, identifier, templates, write_all
from vsense_ros.extras import explained
from vsense_ros.files.names import harmless
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.vehicle import Vehicle

VERSIONS = (2, 3)
FIRST_INTEGER = 900000
ELEMENTS = 1000  # value references of scalars: this times the place of the variable, and that of the element
START_SPEED = 20.0  # [m/s] where nothing else is set
PLANT_STEP = 0.002  # [s] longest step of a plant
OPTIMISED = "-O3"
# Only the functions of FMI are visible: with the others, too, a second car in the same process would compute with the
# functions of the first, where the master loads libraries globally (RTLD_GLOBAL).
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-fvisibility=hidden")
_WHEEL_ROWS = (
    ("force_x", "N", "force of the road on the tyre along the wheel's x axis"),
    ("force_y", "N", "force of the road on the tyre along the wheel's y axis, to the left"),
    ("force_z", "N", "force of the road on the tyre, upwards"),
    ("moment", "N m", "aligning moment of the tyre"),
    ("slip", "-", "longitudinal slip"),
    ("angle", "rad", "slip angle"),
    ("camber", "rad", "inclination of the wheel against the road"),
)
_VELOCITIES = {
    **{axis: f"the velocity of cog along the body's {axis} axis, in these axes" for axis in "xyz"},
    **{
        name: f"the rate about the body's {axis} axis"
        for name, axis in zip(("roll", "pitch", "yaw"), "xyz", strict=True)
    },
    **{f"travel_{w}": f"the compression rate of the suspension {w}" for w in WHEELS},
    **{f"spin_{w}": f"the angular velocity of the wheel {w}" for w in WHEELS},
}
# Base units of SI by unit, as the standard has them.
_UNITS = {
    "rad": {"rad": 1}, "m": {"m": 1}, "s": {"s": 1}, "m/s": {"m": 1, "s": -1}, "rad/s": {"rad": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2}, "rad/s2": {"rad": 1, "s": -2}, "N": {"kg": 1, "m": 1, "s": -2},
    "N m": {"kg": 1, "m": 2, "s": -2}, "rad/m": {"rad": 1, "m": -1},
}  # fmt: skip


class Unit:
    """What a unit of a vehicle consists of. With `scalars` FMI 3 has no arrays: some tools read none. FMI 2 never has
    any. Raises `InputError` as `export.c.Observer`, and for a plant with rear steering."""

    def __init__(self, vehicle: Vehicle, *, plant: bool = False, scalars: bool = False) -> None:
        if plant and vehicle.physics.steering.rear:
            raise InputError(f"{vehicle.name}: a plant has no rear steering; set physics.steering.rear to false")
        self.vehicle, self.plant, self.scalars = vehicle, plant, scalars
        self.contents = Contents(Observer.of(vehicle))
        self.observer = self.contents.observer
        self.sensors: list[Sensor] = []
        first = 0
        if not plant:
            for name, sensor in self.observer.correcting.items():
                elements = tuple(Entry(q.path, q.unit, q.meaning) for q in sensor.quantities)
                self.sensors.append(Sensor(identifier(name), elements, first))
                first += self.sensors[-1].size
        self.measured = first
        self.variables = self._variables()

    def _variables(self) -> list[Variable]:
        states = self.contents.states()
        given = [
            Variable("time", "time", "TIME", (Entry("time", "s", "time"),)),
            Variable("start_speed", "speed", "PARAMETER", (Entry("", "m/s", "speed at the start"),), START_SPEED),
            Variable("start_x", "start_x", "PARAMETER", (Entry("", "m", "position at the start, east"),), 0.0),
            Variable("start_y", "start_y", "PARAMETER", (Entry("", "m", "position at the start, north"),), 0.0),
            Variable("start_yaw", "start_yaw", "PARAMETER", (Entry("", "rad", "heading at the start"),), 0.0),
        ]
        steering, *torques, rear_steering = [Entry(e.name.lower(), e.unit, e.meaning) for e in INPUT_ENTRIES]
        if self.plant:
            slopes = tuple(
                Entry(n, "rad", f"slope of the road, {how}")
                for n, how in (("grade", "positive uphill"), ("bank", "positive where the left side is higher"))
            )
            given += [
                Variable("steering", "steering", "INPUT", (steering,), 0.0),
                Variable("torque", "torques", "INPUT", tuple(torques), 0.0),
                Variable("slope", "slopes", "INPUT", slopes, 0.0),
            ]
        else:
            given.append(Variable("input", "v.inputs", "INPUT", (steering, *torques, rear_steering), 0.0))
            for sensor in self.sensors:
                place = f"measured[{sensor.first}]"
                given.append(Variable(sensor.name, place, "INPUT", sensor.elements, 0.0, may_miss=True))
        outputs = states[:28] if self.plant else states
        given.append(
            Variable(
                "state", "v.state", "OUTPUT", tuple(Entry(s.name.lower(), _ascii(s.unit), s.meaning) for s in outputs)
            )
        )
        accelerations = tuple(
            Entry(name, "m/s2" if i < 3 or 6 <= i < 10 else "rad/s2", f"rate of change of {whose}")
            for i, (name, whose) in enumerate(_VELOCITIES.items())
        )
        given.append(Variable("acceleration", "acceleration", "OUTPUT", accelerations))
        for row, (name, unit, meaning) in enumerate(_WHEEL_ROWS):
            elements = tuple(Entry(wheel, unit, f"{meaning}, wheel {wheel}") for wheel in WHEELS)
            given.append(Variable(f"wheel_{name}", f"wheels[{4 * row}]", "OUTPUT", elements))
        if self.observer.estimated and not self.plant:
            known = self.contents.estimates()
            assert known is not None
            given.append(Variable("estimate", "v.estimates", "OUTPUT", tuple(known["entries"])))
        return given

    @property
    def identifier(self) -> str:
        """Name of the model and its binary, with which names begin that a linker sees, but for those of FMI."""
        kind = "plant" if self.plant else "observer"
        return f"vsense_{kind}_{identifier(self.vehicle.name)}"

    def compiled(self, version: int) -> tuple[str, str]:
        """Names of the sources that a compiler is given; the others are included by them."""
        return f"fmi{version}.c", f"{self.identifier}.c"

    def sources(self, version: int, folder: Path) -> None:
        """Write the C of the unit into `folder`."""
        headers = _headers()
        c.write(self.vehicle, folder, prefix=self.identifier)
        for name in ("example.c", "Makefile", "README.md"):
            (folder / name).unlink()
        environment = templates()
        values = {
            "title": f"{'The car' if self.plant else 'Observer of'} {harmless(self.vehicle.name)}",
            "token": self.token(version),
            "longest_step": number(PLANT_STEP if self.plant else self.vehicle.observer.longest_step),
            "start_speed": number(START_SPEED),
            "plant": self.plant,
            "sensors": self.sensors,
            "measured": max(self.measured, 1),
            "survey": self.observer.map_origin is not None,
            "variables": [
                {"name": v.name, "place": v.place, "size": v.size, "kind": v.kind, "may_miss": int(v.may_miss)}
                for v in self.variables
            ],
            "scalars": self.scalars,
            "rest": _rest_of_fmi3(environment) if version == 3 else "",
        }
        names = ("fmu.c", f"fmi{version}.c")
        write_all(folder, {n: environment.get_template(f"{n}.j2").render(values) for n in names}, self.identifier)
        for header in headers.glob(f"fmi{version}*.h"):
            shutil.copy(header, folder)

    def token(self, version: int) -> str:
        """What only this vehicle, with these variables, has."""
        text = [str(version), str(self.plant), str(self.scalars), repr(self.variables), self.contents.model()]
        text += [repr(sorted(self.vehicle.values().items()))]
        return "{" + hashlib.sha256("\n".join(text).encode()).hexdigest()[:32] + "}"

    def description(self, version: int) -> str:
        """modelDescription.xml."""
        return _description_2(self) if version == 2 else _description_3(self)


def write(
    vehicle: Vehicle,
    path: Path,
    version: int,
    *,
    plant: bool = False,
    scalars: bool = False,
    targets: Sequence[str] = ("",),
    optimised: str = OPTIMISED,
) -> None:
    """Write a unit with a binary for each of `targets`: names of `TARGETS`, or "" for this machine; none of them writes
    sources alone. Raises `InputError` without a compiler for one of them."""
    if version not in VERSIONS:
        raise InputError(f"FMI {version} is not known; there are {', '.join(map(str, VERSIONS))}")
    unit = Unit(vehicle, plant=plant, scalars=scalars)
    chosen = [target_of(name, version) for name in targets]
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        sources = folder / "sources"
        unit.sources(version, sources)
        (folder / "modelDescription.xml").write_text(unit.description(version), encoding="utf-8")
        terminals.write(unit, version, folder)
        if version == 3:
            (sources / "buildDescription.xml").write_text(_build_description(unit), encoding="utf-8")
        for target in chosen:
            binary = folder / "binaries" / target.folder(version) / f"{unit.identifier}{target.suffix}"
            binary.parent.mkdir(parents=True, exist_ok=True)
            flags = (optimised, *FLAGS, *target.flags, f"-I{sources}")
            parts = [sources / name for name in unit.compiled(version)]
            compile_library(parts, binary, flags, "; --no-binary writes sources alone", target.compiler or None)
        (folder / "documentation").mkdir()
        (folder / "documentation" / "index.html").write_text(_documentation(unit), encoding="utf-8")
        path.parent.mkdir(parents=True, exist_ok=True)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(folder.rglob("*")):
                if file.is_file():
                    archive.write(file, file.relative_to(folder))


def _ascii(unit: str) -> str:
    """A unit as the table of units has it."""
    return unit.replace("²", "2")


def _headers() -> Path:
    with explained():
        import fmpy
    return Path(fmpy.__file__).parent / "c-code"


@dataclass(frozen=True)
class Target:
    """A machine and system that binaries are made for: folders of FMI 2 (none for some) and 3, and its compiler."""

    folder_2: str
    folder_3: str
    compiler: str = ""  # "": that of this machine
    suffix: str = ".so"
    flags: tuple[str, ...] = ("-fPIC",)

    def folder(self, version: int) -> str:
        return self.folder_2 if version == 2 else self.folder_3


# Compilers of Debian and Ubuntu: gcc, gcc-aarch64-linux-gnu, gcc-mingw-w64-x86-64. A library for Windows needs none of
# the compiler's own at run time.
TARGETS = {
    "x86_64-linux": Target("linux64", "x86_64-linux", "x86_64-linux-gnu-gcc"),
    "aarch64-linux": Target("", "aarch64-linux", "aarch64-linux-gnu-gcc"),
    "x86_64-windows": Target("win64", "x86_64-windows", "x86_64-w64-mingw32-gcc", ".dll", ("-static-libgcc",)),
}


def target_of(name: str, version: int) -> Target:
    """A target by its name, or that of this machine for "". Raises `InputError` where there is none or its compiler is
    not installed."""
    machine, system = platform.machine(), platform.system()
    own = f"{machine}-{system.lower()}"
    if (name or own) not in TARGETS:
        raise InputError(
            f"binaries are made for {', '.join(TARGETS)}, not for {name or own}: name another, or use --no-binary"
        )
    target = TARGETS[name or own]
    if not target.folder(version):
        raise InputError(f"FMI {version} has no folder for binaries of {name or own}: use --no-binary, or FMI 3")
    if (name or own) == own:
        return replace(target, compiler="")
    if shutil.which(target.compiler) is None:
        raise InputError(f"binaries for {name} need {target.compiler}, which is not installed here")
    return target


def _rest_of_fmi3(environment: jinja2.Environment) -> str:
    """The functions of the standard that the unit has no use for, each of which refuses."""
    source = environment.loader.get_source(environment, "fmi3.c.j2")[0]  # type: ignore[union-attr]
    there = set(re.findall(r"\b(fmi3[A-Z]\w+)\(", source))
    types = (_headers() / "fmi3FunctionTypes.h").read_text(encoding="utf-8")
    lines = []
    for name, arguments in re.findall(r"typedef fmi3Status (fmi3\w+)TYPE\s*\((.*?)\);", types, re.DOTALL):
        if name in there:
            continue
        text = " ".join(arguments.split())
        names = [re.findall(r"(\w+)\s*(?:\[\])?$", part.strip())[0] for part in text.split(",")]
        lines.append(f"fmi3Status {name}({text}) {{ {' '.join(f'UNUSED({n});' for n in names)} return fmi3Error; }}")
    return "\n".join(lines) + "\n"


def _xml(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _unit_definitions(root: ElementTree.Element) -> None:
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for name, base in _UNITS.items():
        unit = ElementTree.SubElement(definitions, "Unit", name=name)
        ElementTree.SubElement(unit, "BaseUnit", {key: str(power) for key, power in base.items()})


def _known_unit(entry: Entry) -> dict[str, str]:
    return {"unit": entry.unit} if entry.unit in _UNITS else {}


def _scalars(unit: Unit) -> Iterator[tuple[str, int, Variable, Entry]]:
    """Each element of each variable by itself: its name, value reference, variable and meaning."""
    for place, variable in enumerate(unit.variables):
        for k, entry in enumerate(variable.elements):
            inner = f".{entry.name.lower()}" if entry.name and variable.kind != "TIME" else ""
            yield variable.name + inner, ELEMENTS * place + k, variable, entry


_CAUSALITY = {"PARAMETER": "parameter", "INPUT": "input", "OUTPUT": "output", "TIME": "independent"}


def _description_2(unit: Unit) -> str:
    """XML of FMI 2, with scalars: `imu.angular_velocity.z`, `state.velocity_x`, `wheel_force_x.fl`."""
    sub = ElementTree.SubElement
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=unit.identifier,
        guid=unit.token(2),
        description=_summary(unit),
        generationTool="vsense export fmu",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    simulation = sub(
        root, "CoSimulation", modelIdentifier=unit.identifier, canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUstate="true", canSerializeFMUstate="true", canNotUseMemoryManagementFunctions="true",
    )  # fmt: skip
    files = sub(simulation, "SourceFiles")
    for name in unit.compiled(2):
        sub(files, "File", name=name)
    _unit_definitions(root)
    sub(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize="0.004")
    variables = sub(root, "ModelVariables")
    outputs = []

    def add(name: str, reference: int, kind: str, entry: Entry, start: float | None, type_name: str = "Real") -> None:
        attributes = {"name": name, "valueReference": str(reference), "description": entry.meaning}
        attributes |= {"causality": _CAUSALITY[kind]}
        attributes["variability"] = "fixed" if kind == "PARAMETER" else "continuous"
        if type_name == "Integer":
            attributes["variability"] = "discrete"
        if kind == "PARAMETER":
            attributes["initial"] = "exact"
        if kind == "OUTPUT":
            attributes["initial"] = "calculated"
        element = sub(variables, "ScalarVariable", attributes)
        typed = {} if start is None else {"start": f"{start:g}"}
        sub(element, type_name, typed | (_known_unit(entry) if type_name == "Real" else {}))
        if kind == "OUTPUT":
            outputs.append(len(variables))

    for name, reference, variable, entry in _scalars(unit):
        if variable.kind != "TIME":
            add(name, reference, variable.kind, entry, variable.start)
    for k, sensor in enumerate(unit.sensors):
        entry = Entry("", "-", "changes with each new measurement")
        add(f"{sensor.name}_count", FIRST_INTEGER + k, "INPUT", entry, 0.0, "Integer")
    structure = sub(root, "ModelStructure")
    for part, known in (("Outputs", {"dependencies": ""}), ("InitialUnknowns", {})):
        element = sub(structure, part)
        for index in outputs:
            sub(element, "Unknown", known, index=str(index))
    return _xml(root)


def _description_3(unit: Unit) -> str:
    """XML of FMI 3, with scalars as FMI 2 or with arrays, whose elements the description names."""
    sub = ElementTree.SubElement
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=unit.identifier,
        instantiationToken=unit.token(3),
        description=_summary(unit),
        generationTool="vsense export fmu",
        variableNamingConvention="structured",
    )
    sub(
        root, "CoSimulation", modelIdentifier=unit.identifier, canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUState="true", canSerializeFMUState="true",
    )  # fmt: skip
    _unit_definitions(root)
    sub(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize="0.004")
    variables = sub(root, "ModelVariables")
    outputs = []

    def add(name: str, reference: int, variable: Variable, meaning: str, unit_of: dict[str, str], size: int) -> None:
        attributes = {"name": name, "valueReference": str(reference), "causality": _CAUSALITY[variable.kind]}
        attributes |= {"variability": "fixed" if variable.kind == "PARAMETER" else "continuous"}
        attributes |= {"description": meaning} | unit_of
        if variable.kind == "OUTPUT":
            attributes["initial"] = "calculated"
            outputs.append(reference)
        if variable.start is not None:
            attributes["start"] = " ".join([f"{variable.start:g}"] * size)
        element = sub(variables, "Float64", attributes)
        if size > 1:
            sub(element, "Dimension", start=str(size))

    if unit.scalars:
        for name, reference, variable, entry in _scalars(unit):
            add(name, reference, variable, entry.meaning, _known_unit(entry), 1)
    else:
        for place, variable in enumerate(unit.variables):
            first = variable.elements[0]
            same = len({entry.unit for entry in variable.elements}) == 1
            names = ", ".join(entry.name.lower() for entry in variable.elements if entry.name)
            meaning = first.meaning if variable.size == 1 else f"{names}" + ("" if same else "; SI units")
            add(variable.name, place, variable, meaning, _known_unit(first) if same else {}, variable.size)
    for k, sensor in enumerate(unit.sensors):
        sub(
            variables, "Int32", name=f"{sensor.name}_count", valueReference=str(FIRST_INTEGER + k), causality="input",
            variability="discrete", start="0", description="changes with each new measurement",
        )  # fmt: skip
    structure = sub(root, "ModelStructure")
    for part, known in (("Output", {"dependencies": ""}), ("InitialUnknown", {})):
        for place in outputs:
            sub(structure, part, known, valueReference=str(place))
    return _xml(root)


def _build_description(unit: Unit) -> str:
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=unit.identifier)
    files = ElementTree.SubElement(build, "SourceFileSet", language="C99")
    for name in unit.compiled(3):
        ElementTree.SubElement(files, "SourceFile", name=name)
    ElementTree.SubElement(build, "Library", name="m", external="true")
    return _xml(root)


def _summary(unit: Unit) -> str:
    if unit.plant:
        return f"Multibody model of the car {unit.vehicle.name}: motion and tyre forces from steering and wheel torques"
    return f"Observer of the car {unit.vehicle.name}: motion and tyre forces from its sensors"


def _documentation(unit: Unit) -> str:
    rows = []
    for variable in unit.variables:
        for entry in variable.elements:
            name = f"{variable.name} {entry.name.lower()}".strip()
            rows.append(
                f"<tr><td>{name}</td><td>{_CAUSALITY[variable.kind]}</td><td>{entry.unit}</td><td>{entry.meaning}</td></tr>"
            )
    order = (
        "Steering is the mean angle of the front wheels. What is set before a step holds during it."
        if unit.plant
        else "Steering is the mean angle of the front wheels. Before each step set what was measured at its beginning, "
        "and change the count of each sensor that measured; NaN marks what is absent."
    )
    return (
        f"<!DOCTYPE html><html><head><meta charset='utf-8'><title>{unit.identifier}</title></head><body>"
        f"<h1>{unit.identifier}</h1><p>{_summary(unit)}. SI units; axes ISO 8855 (x forward, y left, z up). {order}</p>"
        f"<table><tr><th>variable</th><th>causality</th><th>unit</th><th>meaning</th></tr>{''.join(rows)}</table>"
        "</body></html>\n"
    )
