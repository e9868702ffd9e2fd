"""What MkDocs does beyond its configuration in mkdocs.yml: pages made from code, pages of other folders, and links.

A page of docs/ may link to any file of the repository, as a reader on a code host expects. On the site such a link
leads to the page that stands for the file, or becomes plain text if there is none. A link to a file that does not exist
is a warning, on which the strict build fails.
"""

from __future__ import annotations

import logging
import os
import re
import sys
from pathlib import Path, PurePosixPath
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]

import commands_page  # noqa: E402

LOG = logging.getLogger("mkdocs.hooks.links")

# Pages of the site, by the file of the repository that each shows.
BROUGHT = {
    "BENCHMARKS.md": "project/benchmarks.md",
    "CHANGELOG.md": "project/changelog.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "SECURITY.md": "project/security.md",
    "bags/README.md": "project/bags.md",
    "hw/README.md": "project/hardware.md",
    "test/blind/README.md": "project/blind.md",
    "README.md": "index.md",
}
SOURCES = {page: source for source, page in BROUGHT.items() if source != "README.md"}
NOTEBOOKS = ROOT / "out" / "notebooks"  # executed by tools/notebooks.py; without them the site has the sources
MADE = {"reference/commands.md": commands_page.page}
WIDE = ("nodes.md", "vehicle_parameters.md", "project/benchmarks.md")  # tables that need the whole width
LINK = re.compile(r"(!?)\[((?:[^\]\[]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
BLOCK = re.compile(r"(^```.*?^```\s*?$|^(?: {4}|\t)[^\n]*$)", re.MULTILINE | re.DOTALL)
ELSEWHERE = ("http://", "https://", "mailto:", "#")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made from code and those that show a file of another folder."""
    for page, source in SOURCES.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
        for picture in _pictures(ROOT / source):
            if not picture.is_relative_to(ROOT / "docs"):
                name = f"project/{picture.name}"
                files.append(File.generated(config, name, content=picture.read_bytes()))
    for page, make in MADE.items():
        files.append(File.generated(config, page, content=make()))
    for picture in sorted(NOTEBOOKS.glob("*.svg")):
        files.append(File.generated(config, f"notebooks/{picture.name}", content=picture.read_bytes()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """The page with its links to files of the repository replaced by links of the site."""
    own = page.file.src_uri
    if own.startswith("notebooks/") and (made := NOTEBOOKS / Path(own).name).exists():
        markdown = made.read_text(encoding="utf-8")
    if own in WIDE:
        page.meta["hide"] = ["toc"]
    folder = (ROOT / SOURCES[own]).parent if own in SOURCES else (ROOT / "docs" / own).parent

    def replaced(match: re.Match[str]) -> str:
        return _link(match, folder, own)

    parts = BLOCK.split(markdown)
    return "".join(part if i % 2 else LINK.sub(replaced, part) for i, part in enumerate(parts))


def _link(match: re.Match[str], folder: Path, own: str) -> str:
    """A link of the page `own`, whose text stands in `folder`, as it has to be on the site."""
    mark, text, target = match.groups()
    if target.startswith(ELSEWHERE):
        return match[0]
    name, hash_sign, anchor = target.partition("#")
    path = Path(os.path.normpath(folder / name))
    if path.parent == ROOT / "docs/notebooks" and (NOTEBOOKS / path.name).exists():
        return match[0]  # the picture of a block
    if not path.exists() and _site_page(path) not in MADE:
        LOG.warning("%s links to %s, which does not exist", own, target)
        return match[0]
    site = _site_page(path)
    if site is None:
        return match[0] if mark else text
    relative = os.path.relpath(site, PurePosixPath(own).parent)
    return f"{mark}[{text}]({relative}{hash_sign}{anchor})"


def _site_page(path: Path) -> str | None:
    """Where a file of the repository stands on the site; None if it does not."""
    if not path.is_relative_to(ROOT):
        return None
    source = path.relative_to(ROOT).as_posix()
    if source in BROUGHT:
        return BROUGHT[source]
    if path.is_relative_to(ROOT / "docs"):
        return None if path.is_dir() else path.relative_to(ROOT / "docs").as_posix()
    if path.suffix in (".png", ".svg"):
        return f"project/{path.name}"
    return None


def _pictures(page: Path) -> list[Path]:
    """The pictures that a page shows."""
    links: list[Any] = LINK.findall(page.read_text(encoding="utf-8"))
    return [page.parent / target for mark, _, target in links if mark and not target.startswith(ELSEWHERE)]
