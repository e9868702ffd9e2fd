"""Work that is cut into tasks, done by several processes, with its progress; what was done is kept."""

from __future__ import annotations

import hashlib
import pickle
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from vsense_ros.cache import digest_of
from vsense_ros.files.atomic import in_place_of
from vsense_ros.files.installed import vehicle_path
from vsense_ros.fleet.fleet import workers

if TYPE_CHECKING:
    from distributed import Client


class Task(NamedTuple):
    """A function with its arguments, and about how long it takes [s]."""

    seconds: float
    function: Callable[..., Any]
    arguments: tuple[Any, ...]


# Tasks, and a function that gets the share that is done → their results, in the same order.
DoTasks = Callable[[Sequence[Task], Callable[[float], None]], list[Any]]


class Failed(NamedTuple):
    """In place of a result: the error that ended its task, in words."""

    error: str


def kept(tasks: Mapping[str, Task], folder: Path) -> list[Task]:
    """The named tasks so that each keeps its result in `folder`, and takes it from there unless code or vehicle files
    have changed since: what was stopped goes on where it was. One that fails gives `Failed`, and is done again."""
    folder.mkdir(parents=True, exist_ok=True)
    code = [digest_of(Path(str(resources.files(package)))) for package in ("vsense_ros", "studies")]
    cars = sorted(path.read_text(encoding="utf-8") for path in vehicle_path("genesis").parent.glob("*.yaml"))
    made = []
    for name, task in tasks.items():
        key = hashlib.sha256("\n".join([name, *code, *cars]).encode()).hexdigest()[:20]
        made.append(Task(task.seconds, _kept, (folder / f"{key}.pickle", task.function, task.arguments)))
    return made


def _kept(file: Path, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    if file.exists():
        return pickle.loads(file.read_bytes())
    try:
        result = function(*arguments)
    except Exception as error:  # whatever it is: the other tasks shall be done
        traceback.print_exc()
        return Failed(f"{type(error).__name__}: {error}")
    with in_place_of(file) as fresh:
        fresh.write_bytes(pickle.dumps(result))
    return result


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
