"""The workbench in a browser."""

from __future__ import annotations

from pathlib import Path

import click

from vsense_ros.cli.common import EXISTING, NEW_FOLDER


@click.command()
@click.argument("files", nargs=-1, type=EXISTING)
@click.option(
    "--project", "folder", type=NEW_FOLDER, default=Path("out/studio"), show_default=True,
    help="Folder that keeps state and results.",
)  # fmt: skip
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port on this machine; default: a free one.")
@click.option("--browser/--no-browser", default=True, help="Open the page in the default browser.")
@click.option(
    "--upload-limit", type=click.IntRange(min=1), default=500, show_default=True, metavar="MB",
    help="Largest file that may be uploaded; larger ones are opened from their folder.",
)  # fmt: skip
def studio(files: tuple[Path, ...], folder: Path, port: int, browser: bool, upload_limit: int) -> None:
    """Open the workbench in a browser: car, data, check, estimate, identify, explain, compare.

    \b
    Examples:
      vsense studio
      vsense studio my_car.yaml drive_1.mcap drive_2.mcap
      vsense studio laps/ --project my_project

    FILES are vehicle files, recordings, or folders whose recordings are offered. The page can read the folders of FILES
    and the project, and no others. It is served to this machine alone, at an address with a token. Results are kept in
    the project by the content of their files: closing the page or ending the command loses nothing.
    """
    from vsense_ros.studio.app import open_files, serve
    from vsense_ros.studio.project import Project

    bags = [path for path in files if path.is_file() or (path / "metadata.yaml").exists()]
    folders = [path if path not in bags else path.resolve().parent for path in files]
    project = Project(folder, folders)
    open_files(project, bags)
    say = click.echo  # of click, as ours imports what the page would wait for
    serve(project, port=port, most_megabytes=upload_limit, browser=browser, say=say)


COMMANDS = (studio,)
