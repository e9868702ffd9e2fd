"""What all HTML reports share: their templates, embedded pictures, and how a page is written."""

from __future__ import annotations

import base64
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import jinja2

from vsense_ros.files.atomic import atomic_write


@cache
def page_template(package: str, name: str) -> jinja2.Template:
    """A template in a package's folder `templates`; it escapes texts, and refuses variables that are not given."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(package, "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name)


def write_page(path: Path, package: str, template: str, **values: Any) -> Path:
    """Render a template with these values, and `written` for the present time (UTC), to `path`; returns `path`."""
    written = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    page = page_template(package, template).render(written=written, **values)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        file.write(page)
    return path


def embedded(picture: bytes | None) -> str:
    """The bytes of a picture as base64, for a `data:` URL; empty where there is no picture."""
    return "" if picture is None else base64.b64encode(picture).decode("ascii")
