"""What was found, in a terminal."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table
from rich.text import Text

from vsense_ros.mismatch.answer_schema import Answer
from vsense_ros.mismatch.tables import (
    OBSERVER_COLUMNS,
    changed,
    effect_rows,
    next_test_in_words,
    observer_rows,
    proven,
    reference_in_words,
    remainder_in_words,
    signal_rows,
)
from vsense_ros.mismatch.words import badge_of

PRINTED_SIGNALS = 6


def printed(answer: Answer, console: Console) -> None:
    """Print what was found."""
    console.print()
    console.print(Text(f"{answer.vehicle}: {badge_of(answer).badge}", style="bold"))
    console.print(Text(answer.sentence))
    if answer.observer is not None:
        console.print(Text(answer.observer.sentence, style="" if answer.observer.improved else "bold yellow"))
    if test := next_test_in_words(answer):
        console.print(Text(f"Next test: {test}.", style="bold"))
    if rest := remainder_in_words(answer):
        console.print(Text(f"Left over: {rest}.", style="yellow"))
    _print_effects(answer, console)
    _print_signals(answer, console)
    _print_observer(answer, console)
    for remark in answer.remarks:
        console.print(Text(f"Note: {remark}", style="yellow"))
    for reason in dict.fromkeys(one.reason for one in answer.out_of_reach):
        ids = ", ".join(one.id for one in answer.out_of_reach if one.reason == reason)
        console.print(Text(f"Nothing can be said of {ids}: {reason}", style="yellow"))
    console.print(Text(f"{answer.cpu_s:.0f} s of computing for {answer.driven_s:.0f} s of driving", style="dim"))


def _print_effects(answer: Answer, console: Console) -> None:
    rows = effect_rows(answer)
    if rows:
        table = _table("squared error explained by", *(f">{bar.name}" for bar in rows[0].bars), "")
        for row in rows:
            standing = "; ".join(filter(None, (row.standing, row.together)))
            _add(table, row.name, *(bar.figure for bar in row.bars), standing)
        console.print(table)
    for row in rows:
        if row.in_answer:
            console.print(Text(f"{row.name}: {', '.join(map(str, row.sizes))}"))


def _print_signals(answer: Answer, console: Console) -> None:
    rows = signal_rows(answer)
    if not rows:
        return
    headings = (">before", ">after", ">change") if changed(answer) else (">error",)
    proof = tuple(f"{words}, held out" for words in headings) if proven(answer) else ()
    table = _table("error", *headings, *proof)
    for row in rows[:PRINTED_SIGNALS]:
        cells = [cell for error in row.errors for cell in error.cells[: len(headings)]]
        _add(table, row.label, *cells)
    console.print(table)
    if len(rows) > PRINTED_SIGNALS:
        console.print(Text(f"The report shows {len(rows)} signals.", style="dim"))


def _print_observer(answer: Answer, console: Console) -> None:
    if answer.observer is None:
        return
    table = _table("observer", *(f">{heading}" for heading in OBSERVER_COLUMNS))
    for row in observer_rows(answer.observer):
        _add(table, row.what, *row.cells)
    console.print(table)
    if place := reference_in_words(answer.observer):
        console.print(Text(place))


def _table(*headings: str) -> Table:
    """A table with these headings; those that begin with > stand above figures."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 1))
    for words in headings:
        table.add_column(words.removeprefix(">"), justify="right" if words.startswith(">") else "left")
    return table


def _add(table: Table, *cells: str) -> None:
    table.add_row(*(Text(cell) for cell in cells))
