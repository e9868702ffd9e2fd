"""Recordings of any format, whole or a part of them, and what looks wrong in them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsense_ros.api.stretch import Stretch, distinct_names
from vsense_ros.bag.importers import import_recording
from vsense_ros.checks.inspect import Inspection, inspect
from vsense_ros.checks.mending import mends
from vsense_ros.checks.sentences import mend_in_words
from vsense_ros.errors import InputError
from vsense_ros.evaluate.printable import Printable
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import known_topics

if TYPE_CHECKING:
    from rich.console import Console

Source = str | Path | Stretch | Recording  # of a recording
Sources = Source | Sequence[Source]  # of one recording, or of several


def read(source: Source, **options: Any) -> Recording:
    """Read a recording of any format that `vsense import` understands: MCAP and bag folders, CAN logs, tables, MDF, …

    `source` is a path, or `lap.mcap@207:310` for what was measured between two times [s since the first stamp]. Signals
    are in SI units and axes of ISO 8855, whatever the format has. `options` go to the importer: `mapping` (which column
    or signal is what), `dbc` (database of a CAN log), … A `Recording` is returned as it is.

        recording = vs.read("drive.blf", dbc="car.dbc", mapping="car.yaml")
        recording["imu/data"].columns["angular_velocity"]  # (n, 3) rad/s
        recording.to_pandas()  # also to_polars(), to_xarray()

    Raises `InputError` if nothing knows the format, an option is not one of its importer, or nothing was recorded in
    the part.
    """
    if isinstance(source, Recording):
        return source
    part = source if isinstance(source, Stretch) else Stretch.parse(source)
    recording = import_recording(part.path, **options)
    if not part.limits:
        return recording
    selected = recording.between(part.begin, part.end)
    if not selected.channels:
        raise InputError(
            f"{recording.name}{part.limits}: nothing was recorded then; {part.path.name} lasts from 0 to "
            f"{recording.duration:.1f} s"
        )
    return replace(selected, name=recording.name + part.limits)


def read_each(sources: Sequence[Source]) -> Iterator[Recording]:
    """Read recordings one after the other, each when it is asked for; names begin with the folder where those of files
    are the same without it. Raises `InputError` as `read` does."""
    stretches = [stretch for stretch in map(_stretch, sources) if isinstance(stretch, Stretch)]
    names = distinct_names(stretches)
    return (_named(_stretch(source), names) for source in sources)


def read_all(*lists: Sources) -> list[list[Recording]]:
    """Read several lists of recordings, or single ones, whose names are distinct among all of them; see `read_each`."""
    source_lists = [[source] if isinstance(source, str | Path | Stretch | Recording) else source for source in lists]
    recordings = read_each([source for sources in source_lists for source in sources])
    return [[next(recordings) for _ in sources] for sources in source_lists]


def _stretch(source: Source) -> Stretch | Recording:
    return source if isinstance(source, Stretch | Recording) else Stretch.parse(source)


def _named(source: Recording | Stretch, names: Mapping[Path, str]) -> Recording:
    recording = read(source)
    if isinstance(source, Stretch) and source.path in names:
        return replace(recording, name=names[source.path] + source.limits)
    return recording


@dataclass(frozen=True, repr=False)
class Info(Printable):
    """What a recording holds (`inspection`: topics, rates, gaps, clocks) and looks wrong in it; `mends` says in words
    which corrections of signs, axes and units would make it agree with itself."""

    recording: Recording
    inspection: Inspection
    mends: tuple[str, ...]

    @property
    def problems(self) -> tuple[str, ...]:
        """All that cannot be right in the recording, a sentence each that begins with the topic."""
        return self.inspection.problems

    @property
    def title(self) -> str:
        """Name of the recording, and how much looks wrong in it."""
        return f"{self.recording.name}, {len(self.problems)} problems"

    def show(self, out: Console) -> None:
        """Print topics, rates, gaps and clocks, what looks wrong, and what would mend it."""
        from vsense_ros.evaluate.terminal import show_inspection

        show_inspection(self.inspection, out)
        for mend in self.mends:
            out.print(
                f"What would mend it: {mend} (`vsense run` and `vsense explain` do it with --mend).", soft_wrap=True
            )


def info(source: Source, **options: Any) -> Info:
    """Look through a recording for gaps, clocks, frozen signals, and units, signs and frames that cannot be right.

    `source` and `options` are those of `read`, which says what is raised.
    """
    recording = read(source, **options)
    inspection = inspect(recording, known_topics())
    return Info(recording, inspection, tuple(mend_in_words(mend) for mend in mends(recording)))
