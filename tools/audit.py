"""Known vulnerabilities of the packages in requirements/tested.lock: python tools/audit.py ADVISORIES

ADVISORIES is a folder or an archive of advisories in the format of OSV (ossf.github.io/osv-schema), as the one of all
packages of PyPI: https://osv-vulnerabilities.storage.googleapis.com/PyPI/all.zip. It can be brought to a machine
without a network. With one, `pip-audit --no-deps --disable-pip -r requirements/tested.lock` asks for the same.

`python tools/audit.py --lock` writes the lock file: versions of all that the requirement files need, and of what these
need in turn, as far as it is installed where this runs.
"""

from __future__ import annotations

import json
import re
import sys
import zipfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion, Version

REQUIREMENTS = Path(__file__).parents[1] / "requirements"
LOCK = REQUIREMENTS / "tested.lock"
HEADER = "# Every package that the tests ran with, and the version that it had: python tools/audit.py --lock\n"


def required() -> Iterator[Requirement]:
    """What the requirement files name."""
    for file in sorted(REQUIREMENTS.glob("*.txt")):
        for line in file.read_text(encoding="utf-8").splitlines():
            text = line.partition("#")[0].strip()
            if text and not text.startswith("-"):
                yield Requirement(text)


def installed() -> dict[str, str]:
    """Versions of what is required, and of what that requires, by name."""
    found: dict[str, str] = {}
    seen: set[tuple[str, str]] = set()
    waiting = [(r, "") for r in required()]
    while waiting:
        requirement, extra = waiting.pop()
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        name = canonicalize_name(requirement.name)
        try:
            distribution = metadata.distribution(name)
        except metadata.PackageNotFoundError:
            continue
        found[name] = distribution.version
        for more in ("", *requirement.extras):
            if (name, more) not in seen:
                seen.add((name, more))
                waiting += [(Requirement(text), more) for text in distribution.requires or []]
    return found


def locked(text: str) -> dict[str, Version]:
    """Versions by name, as a lock file has them."""
    lines = (line.partition("#")[0].strip() for line in text.splitlines())
    pairs = (line.split("==") for line in lines if line)
    return {canonicalize_name(name): Version(version) for name, version in pairs}


def advisories(place: Path) -> Iterator[dict[str, Any]]:
    """Advisories of a folder or an archive."""
    if place.is_dir():
        yield from (json.loads(file.read_text(encoding="utf-8")) for file in sorted(place.glob("**/*.json")))
        return
    with zipfile.ZipFile(place) as archive:
        yield from (json.loads(archive.read(name)) for name in archive.namelist() if name.endswith(".json"))


def _bound(event: dict[str, str]) -> Version:
    (text,) = event.values()
    return Version("0.dev0" if text == "0" else text)


def _within(events: list[dict[str, str]], version: Version) -> bool:
    """True if a version lies in a range of OSV: affected from `introduced` on, to before `fixed` or with
    `last_affected`."""
    inside = False
    for event in sorted(events, key=_bound):
        if version < _bound(event):
            break
        inside = "introduced" in event or ("last_affected" in event and inside and version == _bound(event))
    return inside


def affects(advisory: dict[str, Any], packages: dict[str, Version]) -> Iterator[str]:
    """Names of the packages whose version an advisory names. One that was withdrawn names none."""
    if advisory.get("withdrawn"):
        return
    for entry in advisory.get("affected", []):
        package = entry.get("package", {})
        version = packages.get(canonicalize_name(package.get("name", "")))
        if package.get("ecosystem") != "PyPI" or version is None:
            continue
        ranges = [r["events"] for r in entry.get("ranges", []) if r.get("type") == "ECOSYSTEM"]
        try:
            hit = any(_within(events, version) for events in ranges)
            hit |= any(Version(text) == version for text in entry.get("versions", []) if re.match(r"v?\d", text))
        except InvalidVersion:
            hit = True  # what cannot be read is to be looked at
        if hit:
            yield package["name"]


def main(arguments: list[str]) -> int:
    if arguments == ["--lock"]:
        lines = [f"{name}=={version}\n" for name, version in sorted(installed().items())]
        LOCK.write_text(HEADER + "".join(lines), encoding="utf-8")
        print(f"{LOCK.name}: {len(lines)} packages")
        return 0
    if len(arguments) != 1 or arguments[0].startswith("-"):
        sys.exit(__doc__)
    packages = locked(LOCK.read_text(encoding="utf-8"))
    try:
        known = list(advisories(Path(arguments[0])))
    except (OSError, zipfile.BadZipFile, ValueError) as error:
        print(f"{arguments[0]}: no folder or archive of advisories in the format of OSV: {error}", file=sys.stderr)
        return 2
    hits = [f"{n} {packages[canonicalize_name(n)]}: {one['id']}" for one in known for n in affects(one, packages)]
    print(f"{len(packages)} packages, {len(known)} advisories, {len(hits)} that name one of them", *hits, sep="\n")
    return 1 if hits or not known else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
