"""The lock file and the search for packages in it that advisories name (tools/audit.py)."""

import json
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tools"))

import audit

VERSIONS = st.builds("{}.{}".format, st.integers(0, 3), st.integers(0, 3))


def advisory(**entry: Any) -> dict[str, Any]:
    return {"id": "X-1", "affected": [{"package": {"ecosystem": "PyPI", "name": "Some.Package"}, **entry}]}


def hits(one: dict[str, Any], version: str) -> list[str]:
    return list(audit.affects(one, {"some-package": Version(version)}))


@given(VERSIONS, VERSIONS, VERSIONS, st.sampled_from(["fixed", "last_affected"]))
def test_a_version_is_affected_where_the_range_has_it(version: str, begin: str, end: str, kind: str) -> None:
    events = [{kind: end}, {"introduced": begin}]  # in any order
    inside = SpecifierSet(f">={begin},{'<' if kind == 'fixed' else '<='}{end}").contains(version)
    if Version(begin) < Version(end):
        assert bool(hits(advisory(ranges=[{"type": "ECOSYSTEM", "events": events}]), version)) == inside


def test_versions_may_be_listed_and_what_is_withdrawn_or_of_others_does_not_count() -> None:
    listed = advisory(versions=["1.0", "1.1"])
    assert hits(listed, "1.1.0") == ["Some.Package"]
    assert hits(listed, "1.2") == []
    assert hits(listed | {"withdrawn": "2026-01-01T00:00:00Z"}, "1.1") == []
    listed["affected"][0]["package"]["ecosystem"] = "npm"
    assert hits(listed, "1.1") == []


def test_an_archive_that_names_a_locked_version_ends_with_1_and_one_that_does_not_with_0(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    version = str(audit.locked(audit.LOCK.read_text(encoding="utf-8"))["numpy"])
    for listed, code in ((version, 1), ("0.1", 0)):
        one = advisory(versions=[listed])
        one["affected"][0]["package"]["name"] = "numpy"
        with zipfile.ZipFile(tmp_path / "all.zip", "w") as archive:
            archive.writestr("X-1.json", json.dumps(one))
        assert audit.main([str(tmp_path / "all.zip")]) == code
        assert ("numpy" in capsys.readouterr().out) == bool(code)


def test_the_lock_file_has_a_version_that_every_requirement_allows() -> None:
    packages = audit.locked(audit.LOCK.read_text(encoding="utf-8"))
    for requirement in audit.required():
        version = packages.get(canonicalize_name(requirement.name))
        assert version is None or requirement.specifier.contains(version), f"{requirement}: {version}; audit.py --lock"
    of_every_user = {
        canonicalize_name(r.name) for r in audit.required() if r.name in (ROOT / "requirements/core.txt").read_text()
    }
    assert of_every_user <= set(packages)
