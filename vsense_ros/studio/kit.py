"""Pieces that all stages are built of: panels, tables, bars, views of curves, jobs with progress and cancel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from html import escape
from pathlib import Path
from typing import Any

from nicegui import ui

from vsense_ros.errors import InputError
from vsense_ros.studio.actions import Action
from vsense_ros.studio.jobs import Job, Status
from vsense_ros.studio.workbench import Workbench

_LONG = 24  # [characters] of a cell, from which on it has several lines
_POLL = 0.25  # [s] between two looks at a job


class View(ui.element, component="static/view.js"):  # type: ignore[call-arg, misc, unused-ignore]
    """Curves (`Board`), a map (`Path`), a diagram (`GG`) or the car from above (`Car`), drawn in the browser."""

    def __init__(self, kind: str, spec: dict[str, Any]) -> None:
        super().__init__()
        self._props["kind"] = kind
        self._props["spec"] = spec

    def show(self, spec: dict[str, Any]) -> None:
        """Show something else in the same place."""
        self._props["spec"] = spec
        self.update()


def panel(title: str, note: str = "", classes: str = "") -> AbstractContextManager[ui.element]:
    """A panel with a heading; what is made inside of `with` stands in it."""
    box = ui.element("section").classes(f"vs-panel {classes}")
    with box, ui.element("header").classes("vs-panel-head"):
        ui.html(f"<h2>{escape(title)}</h2>", sanitize=False)
        if note:
            ui.html(f"<p>{escape(note)}</p>", sanitize=False)
    return box


def file_input(bench: Workbench, label: str, accept: str, uploaded: Callable[[list[Path]], None]) -> None:
    """A field that takes files by a click or by dropping them. Once all are there `uploaded` gets their paths,
    even if the stage was drawn anew in the meantime."""
    bench.uploaded = uploaded
    with ui.element("label").classes("vs-drop") as field:
        ui.html(f"<span>{escape(label)}</span>", sanitize=False)
        given = ui.element("input").props(f'type=file multiple accept="{accept}"')
    send = "VSense.upload(document.getElementById('%s'), event.%s)"
    given.on("change", js_handler=f"(event) => {send % (given.html_id, 'target.files')}")
    drop = send % (given.html_id, "dataTransfer.files")
    field.on("drop", js_handler=f"(event) => {{ event.preventDefault(); {drop}; }}")
    field.on("dragover", js_handler="(event) => event.preventDefault()")


def take_uploads(bench: Workbench) -> None:
    """Let the page hear of files that were sent, for the field of the present stage."""

    def heard(sent: dict[str, list[str]]) -> None:
        for sentence in sent["refused"]:
            _complain(sentence)
        if sent["paths"]:
            attempt(lambda: bench.uploaded([Path(path) for path in sent["paths"]]))

    ui.on("vs_uploaded", lambda event: heard(event.args))


def words(text: str, classes: str = "") -> ui.html:
    """A paragraph of plain text."""
    return ui.html(f"<p>{escape(text)}</p>", sanitize=False).classes(f"vs-words {classes}")


def sentences(lines: Sequence[str], classes: str = "") -> None:
    """A list of sentences."""
    if lines:
        items = "".join(f"<li>{escape(line)}</li>" for line in lines)
        ui.html(f"<ul>{items}</ul>", sanitize=False).classes(f"vs-list {classes}")


def table(heads: Sequence[str], rows: Sequence[Sequence[Any]], caption: str, *, texts: Sequence[int] = (0,)) -> None:
    """A table; the columns whose numbers are in `texts` hold words, the others numbers."""
    kind = ["t" if i in texts else "n" for i in range(len(heads))]
    head = "".join(f'<th scope="col" class="{k}">{escape(h)}</th>' for h, k in zip(heads, kind, strict=True))
    body = "".join(
        "<tr>"
        + "".join(f'<td class="{k}{_length(c)}">{_cell(c)}</td>' for c, k in zip(row, kind, strict=True))
        + "</tr>"
        for row in rows
    )
    ui.html(
        f'<div class="vs-wide" tabindex="0" role="region" aria-label="{escape(caption)}"><table><thead><tr>{head}</tr>'
        f"</thead><tbody>{body}</tbody></table></div>",
        sanitize=False,
    )


def _length(content: Any) -> str:
    """Class of a cell whose words need several lines, so that a narrow screen scrolls instead of wrapping each word."""
    return " long" if isinstance(content, str) and len(content) > _LONG else ""


def _cell(content: Any) -> str:
    return content.html if isinstance(content, Markup) else escape(str(content))


def number(value: float, digits: int) -> str:
    """A number with so many digits that count, without an exponent where people write none: 24900, not 2.49e+04."""
    return f"{float(f'{value:.{digits}g}'):.12g}"


class Markup:
    """Markup that was made by this package, for a cell of a table."""

    def __init__(self, html: str) -> None:
        self.html = html


def tag(text: str, kind: str) -> Markup:
    """A short word on a coloured ground: good, warn, bad or plain."""
    return Markup(f'<span class="vs-tag {kind}">{escape(text)}</span>')


def bar(share: float, words: str, kind: str = "") -> Markup:
    """A horizontal bar for a share between 0 and 1, with its meaning in words."""
    width = 100 * min(1.0, max(0.0, share if share == share else 0.0))
    return Markup(
        f'<span class="vs-bar {kind}" role="img" aria-label="{escape(words)}"><i style="width:{width:.1f}%"></i></span>'
    )


def range_bar(value: float, low: float, high: float, words: str, band: tuple[float, float] | None = None) -> Markup:
    """A value between the limits that real cars have; `band` is its interval."""
    width = high - low or 1.0

    def place(x: float) -> float:
        return 100 * min(1.0, max(0.0, (x - low + 0.25 * width) / (1.5 * width)))

    inside = "" if low <= value <= high else " off"
    interval = ""
    if band is not None:
        left, right = place(band[0]), place(band[1])
        interval = f'<u style="left:{left:.1f}%;width:{max(right - left, 0.5):.1f}%"></u>'
    return Markup(
        f'<span class="vs-range{inside}" role="img" aria-label="{escape(words)}"><em></em>{interval}'
        f'<b style="left:{place(value):.1f}%"></b></span>'
    )


def facts(items: Sequence[tuple[str, str]]) -> None:
    """Large figures in a row: what they are, below what they say."""
    inner = "".join(f"<div><b>{escape(value)}</b><span>{escape(name)}</span></div>" for name, value in items)
    ui.html(inner, sanitize=False).classes("vs-facts")


def show_action(action: Action) -> None:
    """The action as a command line and as Python, folded, with a button to copy each."""
    with ui.expansion("As command line and Python").classes("vs-action").props("dense"):
        for name, text in (("Command line", action.command), ("Python", action.python)):
            with ui.element("div").classes("vs-code"):
                ui.html(f"<pre tabindex=0 aria-label='{name}'>{escape(text)}</pre>", sanitize=False)
                copy = ui.button("Copy", on_click=lambda text=text: _copy(text)).props("flat dense no-caps size=sm")
                copy.props(f'aria-label="Copy {name}"')


def _copy(text: str) -> None:
    ui.clipboard.write(text)
    ui.notify("Copied", position="bottom-right", timeout=1500)


def attempt(action: Callable[[], Any]) -> Any:
    """Call something for the user; what cannot be done is said in a sentence."""
    try:
        return action()
    except (InputError, OSError) as error:
        _complain(str(error))
        return None


def _complain(sentence: str) -> None:
    ui.notify(sentence, type="negative", multi_line=True, timeout=10_000, close_button="Close", position="top")


def follow(
    bench: Workbench, job: Job, name: str, show: Callable[[Job], None], again: Callable[[], None] | None = None
) -> None:
    """Show a job: a bar with cancel while it runs, then what `show` makes of its result, or the sentence of its
    failure. When it ends, the page is drawn anew, as other stages may depend on it."""
    box = ui.element("div").classes("vs-job")
    drawn: list[tuple[Status, str]] = []
    moving: list[tuple[ui.linear_progress, ui.label]] = []

    def look() -> None:
        status = job.status
        if status is Status.RUNNING and drawn and drawn[-1][0] is status:
            meter, share = moving[-1]
            meter.set_value(job.share)
            share.set_text(f"{100 * job.share:.0f} %")
            return
        if drawn and drawn[-1] == (status, job.error):
            return
        if drawn:
            timer.deactivate()
            bench.refresh()
            return
        drawn.append((status, job.error))
        box.clear()
        with box:
            draw(status)
        if status is not Status.RUNNING:
            timer.deactivate()

    def draw(status: Status) -> None:
        if status is Status.RUNNING:
            with ui.element("div").classes("vs-progress").props("role=status"):
                ui.label(name)
                meter = ui.linear_progress(job.share, show_value=False).props('size=6px aria-label="progress"')
                share = ui.label(f"{100 * job.share:.0f} %").classes("vs-number")
                moving.append((meter, share))
                ui.button("Cancel", on_click=job.cancel).props("flat dense no-caps size=sm")
        elif status is Status.DONE:
            show(job)
        elif status is not Status.ABSENT:
            text = job.error or "This was interrupted, as its process was ended from outside. Nothing else was lost."
            with ui.element("div").classes("vs-failure").props("role=alert"):
                for line in text.splitlines():
                    ui.label(line)
                if again is not None:
                    ui.button("Run again", on_click=again).props("flat dense no-caps size=sm")

    timer = ui.timer(_POLL, look)
    look()
