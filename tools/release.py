"""Release files in out/release: wheel, source archive, Debian source package; each is installed and tried. Beside them
a bill of materials (SBOM) of the environment into which the wheel was installed, with the versions that were tried.

The Debian files come from the templates by which ROS releases its packages (bloom). bloom itself resolves dependencies
over the network; here they follow from package.xml by the naming rule of ROS, so that the result is reproducible.

Run by `make release`. Needs dpkg-source; where debhelper and dh-python are installed, the binary package is built, too.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import venv
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RELEASE = ROOT / "out" / "release"
DISTRIBUTION, UBUNTU = "jazzy", "noble"
PREFIX = f"/opt/ros/{DISTRIBUTION}"
DEBHELPER = 9  # compatibility level of bloom
MANOEUVRE = ROOT / "bags" / "step_steer"


def run(*command: str | Path, cwd: Path = ROOT) -> str:
    """Standard output of a command. A command that fails ends the release with its output."""
    # Without PYTHONPATH: an empty environment must not see the checkout, whose package would count as installed.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([str(word) for word in command], cwd=cwd, env=environment, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout


def distributions() -> tuple[Path, Path]:
    """Build wheel and source archive."""
    run(sys.executable, "setup.py", "-q", "sdist", "-d", RELEASE, "bdist_wheel", "-d", RELEASE)
    (wheel,), (archive,) = RELEASE.glob("*.whl"), RELEASE.glob("vsense_ros-*.tar.gz")
    names = [name for name in run(sys.executable, "-m", "zipfile", "-l", wheel).splitlines() if "studies/" in name]
    if names:
        sys.exit(f"{wheel.name} contains studies: {names[0]}")
    return wheel, archive


def try_installed(what: Path, materials: Path | None = None) -> None:
    """Install a wheel or an archive into an empty environment and estimate a manoeuvre, away from the checkout.

    All that the environment then consists of is written to `materials`, as a bill of materials of CycloneDX.
    """
    with TemporaryDirectory() as folder:
        place = Path(folder)
        venv.create(place / "venv", with_pip=True)
        python = place / "venv" / "bin" / "python"
        run(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", what, cwd=place)
        vsense = place / "venv" / "bin" / "vsense"
        run(vsense, "--help", cwd=place)
        run(vsense, "run", MANOEUVRE, "--vehicle", "prototype_model", "--out", place / "estimate", cwd=place)
        if not (place / "estimate" / "summary.json").is_file():
            sys.exit(f"{what.name}: the installed command made no estimate")
        if materials is not None:
            options = ("--output-reproducible", "--output-file", materials)
            run(sys.executable, "-m", "cyclonedx_py", "environment", *options, python)
    print(f"{what.name}: installed into an empty environment, {MANOEUVRE.name} estimated")


def debian_name(dependency: str) -> str:
    """Debian package of a dependency in package.xml: `python3-…` are Ubuntu's own, all others are of ROS."""
    if dependency.startswith("python3-"):
        return dependency
    return f"ros-{DISTRIBUTION}-{dependency.replace('_', '-')}"


def substitutions(package: Any) -> dict[str, Any]:
    """What bloom's templates need, from the parsed package.xml."""
    maintainer = package.maintainers[0]
    author = f"{maintainer.name} <{maintainer.email}>"
    date = datetime.now(UTC).strftime("%a, %d %b %Y %T %z")
    change = f"  * Release {package.version}; see CHANGELOG.md"
    return {
        "Name": package.name,
        "Package": debian_name(package.name),
        "Version": package.version,
        "Description": " ".join(package.description.split()),
        "Homepage": f"https://index.ros.org/p/{package.name}/#{DISTRIBUTION}",
        "Source": "",
        "BugTracker": "",
        "Maintainer": author,
        "Maintainers": author,
        "DebianInc": "-0",
        "Distribution": UBUNTU,
        "format": "quilt",
        "InstallationPrefix": PREFIX,
        "debhelper_version": DEBHELPER,
        "pass_install_scripts": False,  # setup.cfg says where they go
        "Depends": sorted(debian_name(d.name) for d in package.run_depends),
        "BuildDepends": sorted(f"{debian_name(d.name)} <!nocheck>" for d in package.test_depends),
        "Replaces": [],
        "Conflicts": [],
        "Licenses": [(str(license_), "see the file LICENSE") for license_ in package.licenses],
        "changelogs": [(package.version, date, change, maintainer.name, maintainer.email)],
        "release_tag": f"v{package.version}",
    }


def debian_templates() -> Path:
    """Folder of bloom's templates for ament_python; bloom is not imported, as it asks the network when it is."""
    package = find_spec("bloom")
    if package is None or package.origin is None:
        sys.exit("bloom is not installed: pip install -r requirements/release.txt")
    return Path(package.origin).parent / "generators" / "debian" / "templates" / "ament_python"


def debian_source(archive: Path) -> Path:
    """Build the Debian source package from the source archive; returns the description (.dsc)."""
    import em
    from catkin_pkg.package import parse_package

    package = parse_package(str(ROOT))
    values = substitutions(package)
    with TemporaryDirectory() as folder:
        place = Path(folder)
        upstream = f"{values['Package']}_{package.version}"
        with tarfile.open(archive) as packed:
            packed.extractall(place, filter="data")
        (unpacked,) = (path for path in place.iterdir() if path.is_dir())
        sources = unpacked.rename(place / upstream.replace("_", "-"))
        shutil.copy(archive, place / f"{upstream}.orig.tar.gz")
        templates = debian_templates()
        for template in templates.rglob("*.em"):
            if template.name == "gbp.conf.em":  # of a release repository, which this is not
                continue
            target = sources / "debian" / template.relative_to(templates).with_suffix("")
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(em.expand(template.read_text(encoding="utf-8"), dict(values)), encoding="utf-8")
        (sources / "debian" / "rules").chmod(0o755)
        run("dpkg-source", "--build", sources, cwd=place)
        for file in place.glob(f"{values['Package']}_*"):
            if file.is_file():
                shutil.copy(file, RELEASE)
    (description,) = RELEASE.glob("*.dsc")
    return description


def try_debian(description: Path) -> None:
    """Unpack the source package as a build machine does, build the binary package if the tools are here, and try it."""
    with TemporaryDirectory() as folder:
        place = Path(folder)
        run("dpkg-source", "--extract", description, place / "source", cwd=place)
        if not (shutil.which("dh") and shutil.which("pybuild")):
            try_installed(place / "source")
            print(f"{description.name}: the binary package is not built, debhelper and dh-python are not installed")
            return
        run("dpkg-buildpackage", "--build=binary", "--no-check-builddeps", "--no-sign", cwd=place / "source")
        (binary,) = place.glob("*.deb")
        run("dpkg-deb", "--extract", binary, place / "installed")
        (site,) = (place / "installed" / PREFIX.lstrip("/")).glob("lib/python3*/site-packages")
        code = f"import sys; sys.path.insert(0, {str(site)!r}); from vsense_ros.cli import main; main(['--help'])"
        run(sys.executable, "-c", code, cwd=place)
        shutil.copy(binary, RELEASE)
    print(f"{description.name}: built as {binary.name}")


def main() -> None:
    """Build everything anew, and try everything that was built."""
    shutil.rmtree(RELEASE, ignore_errors=True)
    RELEASE.mkdir(parents=True)
    wheel, archive = distributions()
    try_installed(wheel, RELEASE / f"{wheel.stem}.cdx.json")
    try_installed(archive)
    if shutil.which("dpkg-source") is None:
        sys.exit("dpkg-source is not installed: the Debian source package is not made (apt install dpkg-dev)")
    try_debian(debian_source(archive))
    print(f"Released files are in {RELEASE.relative_to(ROOT)}.")


if __name__ == "__main__":
    main()
