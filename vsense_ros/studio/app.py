"""The page of the workbench and its server: `vsense studio` starts it on this machine alone."""

from __future__ import annotations

import asyncio
import secrets
import socket
import webbrowser
from collections.abc import Callable
from html import escape
from importlib import import_module
from pathlib import Path
from threading import Event, Thread

from fastapi import Request
from nicegui import app, background_tasks, ui

from vsense_ros.errors import InputError
from vsense_ros.studio import kit
from vsense_ros.studio.data_routes import routes
from vsense_ros.studio.guard import Guard
from vsense_ros.studio.jobs import Jobs
from vsense_ros.studio.project import Drive, Project
from vsense_ros.studio.stages import STAGES, Stage
from vsense_ros.studio.workbench import Workbench

STATIC = Path(__file__).with_name("static")
SCRIPTS = ("source.js", "board.js", "scenes.js")
# What stages that are not light need: imported in the background while the first page is shown.
_MODELS = ("prepare.vehicle_check", "prepare.car_check", "files.schema", "studio.drawing", "runner.catalogue",
           "navigation.catalogue", "evaluate.wording", "mismatch.answer_schema")  # fmt: skip
_LOOK_AGAIN = 2.0  # [s] between two looks whether another tab has changed the project
_WAIT = 0.1  # [s] between two looks whether the models have been imported
_KNOCK = 0.02  # [s] between two looks whether the server listens
models_are_there = Event()


def serve(project: Project, *, port: int, most_megabytes: int, browser: bool, say: Callable[[str], None]) -> None:
    """Serve the workbench until it is ended. `port` 0 takes a free one; `say` gets the address with its token.

    Raises `InputError` where the port is taken.
    """
    port = _free_port(port)
    token = secrets.token_urlsafe(24)
    jobs = Jobs(project)
    app.add_middleware(Guard, token=token, port=port, most_megabytes=most_megabytes)
    app.include_router(routes(project))
    app.add_static_files("/static", STATIC)
    address = f"http://127.0.0.1:{port}/?token={token}"

    @ui.page("/", title="vsense studio")
    def first(request: Request) -> None:
        build(project, jobs, request.query_params.get("stage", ""))

    async def ready() -> None:
        jobs.prepare()
        background_tasks.create(announce())

    async def announce() -> None:
        while not await _listens(port):
            await asyncio.sleep(_KNOCK)
        say(f"The workbench is at {address}")
        if browser:
            webbrowser.open(address)
        Thread(target=_import_models, daemon=True).start()

    app.on_startup(ready)
    app.on_shutdown(jobs.close)
    ui.run(
        host="127.0.0.1", port=port, show=False, reload=False, title="vsense studio", show_welcome_message=False,
        favicon="📈", uvicorn_logging_level="error", reconnect_timeout=30.0,
        gzip_middleware_factory=None,  # on one machine it costs more than it saves
    )  # fmt: skip


async def _listens(port: int) -> bool:
    """True once the server answers: an address that is opened earlier shows an error."""
    try:
        _, writer = await asyncio.open_connection("127.0.0.1", port)
    except OSError:
        return False
    writer.close()
    return True


def _import_models() -> None:
    for name in _MODELS:
        import_module(f"vsense_ros.{name}")
    models_are_there.set()


def _free_port(port: int) -> int:
    with socket.socket() as one:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            one.bind(("127.0.0.1", port))
        except OSError as error:
            raise InputError(f"port {port} cannot be used ({error.strerror}); give another one with --port") from None
        return int(one.getsockname()[1])


def open_files(project: Project, files: list[Path]) -> None:
    """Put files of the command line into the project: vehicle files and recordings."""
    for path in files:
        inside = project.inside(path)
        if inside.suffix in (".yaml", ".yml") and inside.is_file():
            project.state.vehicle = str(inside)
        elif str(inside) not in {drive.path for drive in project.state.drives}:
            project.state.drives.append(Drive(str(inside)))
    project.save()


def build(project: Project, jobs: Jobs, wanted: str) -> None:
    """Build one page: the rail of stages, and the stage that is wanted."""
    ui.add_head_html('<meta name="viewport" content="width=device-width, initial-scale=1">')
    ui.add_head_html('<link rel="stylesheet" href="/static/style.css">')
    for script in SCRIPTS:
        ui.add_head_html(f'<script src="/static/{script}"></script>')
    ui.run_javascript('document.documentElement.lang = "en"')
    ui.colors(primary="#0b57a4", negative="#b3261e")
    bench = Workbench(project, jobs)
    names = [stage.name for stage in STAGES]
    bench.page["stage"] = wanted if wanted in names else names[0]
    seen = [project.version]

    with ui.element("header").classes("vs-top"):
        ui.html("<b>vsense</b> studio", sanitize=False).classes("vs-brand")
        chips = ui.element("div").classes("vs-chips")
    with ui.element("div").classes("vs-body"):
        rail = ui.element("nav").classes("vs-rail").props('aria-label="Stages"')
        main = ui.element("main").classes("vs-main")

    with rail:  # made once: a click on an element that is made anew at this moment would be lost
        entries = [_entry(bench, stage, number) for number, stage in enumerate(STAGES, start=1)]

    def draw_frame() -> None:
        chips.clear()
        with chips:
            _chips(bench)
        for update in entries:
            update()

    def refresh() -> None:
        seen[0] = project.version
        draw_frame()
        main.clear()
        stage = next(one for one in STAGES if one.name == bench.page["stage"])
        with main:
            ui.html(f"<h1>{escape(stage.title)}</h1><p>{escape(stage.purpose)}</p>", sanitize=False).classes("vs-title")
            if not (stage.light or models_are_there.is_set()):
                kit.words("Loading the models of cars …")
                ui.timer(_WAIT, lambda: refresh() if models_are_there.is_set() else None)
                return
            try:
                stage.build(bench)
            except InputError as error:
                with ui.element("div").classes("vs-failure").props("role=alert"):
                    ui.label(str(error))

    def go(name: str) -> None:
        bench.page["stage"] = name
        ui.run_javascript(f'history.replaceState(null, "", "/?stage={name}"); window.scrollTo(0, 0)')
        refresh()

    def look() -> None:
        if project.version != seen[0]:
            refresh()

    bench.go, bench.refresh = go, refresh
    kit.take_uploads(bench)
    refresh()
    ui.timer(_LOOK_AGAIN, look)


def _chips(bench: Workbench) -> None:
    car = Path(bench.vehicle).stem if bench.vehicle else "no car"
    count = len(bench.drives)
    ui.label(f"Car: {car}").classes("vs-chip")
    ui.label(f"{count} recording{'' if count == 1 else 's'}").classes("vs-chip")
    ui.label(f"Project: {bench.project.folder.name}").classes("vs-chip vs-wide-only").tooltip(str(bench.project.folder))


def _entry(bench: Workbench, stage: Stage, number: int) -> Callable[[], None]:
    """The button of a stage in the rail; returns what shows its present state."""
    button = ui.element("button").classes("vs-stage").props(f'type="button" data-stage="{stage.name}"')
    button.on("click", lambda: bench.go(stage.name))
    with button:
        content = ui.html("", sanitize=False)

    def update() -> None:
        state = stage.state(bench)
        if bench.page["stage"] == stage.name:
            button.classes(add="current").props('aria-current="page"')
        else:
            button.classes(remove="current").props(remove="aria-current")
        content.set_content(
            f'<span class="n">{number}</span><span class="t">{escape(stage.title)}</span>'
            f'<span class="s {state}" role="img" aria-label="{state}" title="{state}"></span>'
        )

    return update
