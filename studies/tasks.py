"""Work that is cut into tasks, done by several processes, with its progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

from vsense_ros.mismatch.fleet import workers

if TYPE_CHECKING:
    from distributed import Client


class Task(NamedTuple):
    """A function with its arguments, and about how long it takes [s]."""

    seconds: float
    function: Callable[..., Any]
    arguments: tuple[Any, ...]


# Tasks, and a function that gets the share that is done → their results, in the same order.
DoTasks = Callable[[Sequence[Task], Callable[[float], None]], list[Any]]


@contextmanager
def pool(processes: int | None = None) -> Iterator[DoTasks]:
    """Yield a function that does tasks, the longest first, in `processes`: by default one for each core; 1 is this
    one."""
    if processes == 1:
        yield in_turn
        return
    with workers(None, processes) as client:
        yield lambda tasks, progress: _side_by_side(tasks, progress, client)


def in_turn(tasks: Sequence[Task], progress: Callable[[float], None]) -> list[Any]:
    """Do tasks one after the other in this process."""
    results, whole, done = [], sum(task.seconds for task in tasks), 0.0
    for task in tasks:
        results.append(task.function(*task.arguments))
        done += task.seconds
        progress(done / whole)
    return results


def _side_by_side(tasks: Sequence[Task], progress: Callable[[float], None], client: Client) -> list[Any]:
    from distributed import as_completed

    whole, done = sum(task.seconds for task in tasks), 0.0
    longest_first = sorted(range(len(tasks)), key=lambda i: -tasks[i].seconds)
    places = {client.submit(tasks[i].function, *tasks[i].arguments, pure=False): i for i in longest_first}
    results: dict[int, Any] = {}
    for future in as_completed(list(places)):
        place = places[future]
        results[place] = future.result()
        done += tasks[place].seconds
        progress(done / whole)
    return [results[i] for i in range(len(tasks))]
