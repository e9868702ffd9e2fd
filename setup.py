"""Build by colcon (ament_python) and by pip alike."""

import re
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "vsense_ros"
ROOT = Path(__file__).parent


# Each is a file in requirements/.
EXTRAS = ("explain", "fleet", "fmu", "formats", "foxglove", "reports", "studio", "tables", "all")


def requirement_names(file: str) -> list[str]:
    """Names without versions: those are pinned in requirements/ for environments of our own, while a vehicle PC keeps
    the versions its distribution brings. Includes the names of the files that this one refers to, except the core's."""
    names: list[str] = []
    for line in (ROOT / "requirements" / f"{file}.txt").read_text(encoding="utf-8").splitlines():
        if match := re.match(r"-r (\w+)\.txt", line):
            names += requirement_names(match.group(1)) if match.group(1) != "core" else []
        elif match := re.match(r"[A-Za-z0-9._-]+(\[\w+\])?", line):
            names.append(match.group())
    return list(dict.fromkeys(names))


def nodes() -> list[str]:
    """Modules of the node folder that a process begins with: those with a function `main`. Each becomes an executable
    of its name."""
    files = sorted((ROOT / PACKAGE / "node").glob("*.py"))
    return [path.stem for path in files if re.search(r"^def main\(", path.read_text(encoding="utf-8"), re.MULTILINE)]


def shared_files(folder: str) -> list[tuple[str, list[str]]]:
    """Every file below `folder`, to be installed at the same place below share/vsense_ros."""
    directories = [path for path in sorted((ROOT / folder).rglob("*")) if path.is_dir()]
    found = []
    for directory in [ROOT / folder, *directories]:
        files = [str(path.relative_to(ROOT)) for path in sorted(directory.glob("*")) if path.is_file()]
        if files and directory.name != "__pycache__":
            found.append((f"share/{PACKAGE}/{directory.relative_to(ROOT)}", files))
    return found


setup(
    name=PACKAGE,
    version="0.1.0",
    description="On-vehicle virtual sensing with multibody state observers",
    long_description=(ROOT / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    keywords="vehicle dynamics, state estimation, Kalman filter, multibody dynamics, side slip, tyre force, ROS 2",
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Topic :: Scientific/Engineering",
    ],
    license="Apache-2.0",
    maintainer="vsense_ros maintainers",
    maintainer_email="maintainers@vsense-ros.example.com",
    python_requires=">=3.11",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={
        "": ["py.typed", "*.c", "*.cpp", "*.html", "templates/*.j2", "*.yaml", "*.xml", "*.json", "*.csv"],
        f"{PACKAGE}.export": ["icons/*"],
        f"{PACKAGE}.studio": ["static/*.js", "static/*.css"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *shared_files("config"),
        *shared_files("deploy"),
        *shared_files("launch"),
        *shared_files("bags"),
        *shared_files("hw/rtl"),
    ],
    install_requires=requirement_names("core"),
    extras_require={extra: requirement_names(extra) for extra in EXTRAS},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            f"vsense = {PACKAGE}.cli:main",
            *(f"{node} = {PACKAGE}.node.{node}:main" for node in nodes()),
        ],
        "vsense_ros.observer": [
            f"accelerator = {PACKAGE}.node.observer_accelerator:Accelerator",
            f"identification = {PACKAGE}.node.observer_identification:Identification",
            f"mass = {PACKAGE}.node.observer_mass:Mass",
            f"trailer = {PACKAGE}.node.observer_trailer:TrailerBehind",
            f"tyres = {PACKAGE}.node.observer_tyres:Tyres",
        ],
    },
)
