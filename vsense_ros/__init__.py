"""On-vehicle virtual sensing: multibody state observers, their sensors and their recordings.

    import vsense_ros as vs

    recording = vs.read("lap.mcap")  # bags, CAN logs, tables, MDF, MATLAB
    result = vs.estimate(recording, "genesis", filter="error_ekf")
    result["side_slip"].value  # (n,) rad, with .sigma, .unit, .reference, .coverage
    result.save("lap.csv")  # .parquet, .mat, .mf4, .mcap

Each name is imported when it is first used: the import itself loads nothing else.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vsense_ros.api.can import survey_can
    from vsense_ros.api.estimation import RecordingWarning, Smoothed, estimate, smooth
    from vsense_ros.api.explanation import explain
    from vsense_ros.api.filter import Filter
    from vsense_ros.api.identification import identify
    from vsense_ros.api.preparation import calibrate, check, new_vehicle
    from vsense_ros.api.recording import Info, info, read
    from vsense_ros.api.result import EstimatedSignal, Result, export_results
    from vsense_ros.api.vehicle import load_vehicle
    from vsense_ros.errors import InputError
    from vsense_ros.messages.recording import Recording
    from vsense_ros.model.vehicle import Vehicle

__all__ = [
    "EstimatedSignal",
    "Filter",
    "Info",
    "InputError",
    "Recording",
    "RecordingWarning",
    "Result",
    "Smoothed",
    "Vehicle",
    "calibrate",
    "check",
    "estimate",
    "explain",
    "export_results",
    "identify",
    "info",
    "load_vehicle",
    "new_vehicle",
    "read",
    "smooth",
    "survey_can",
]

# The module of each name, relative to this package.
_PLACES = {
    "EstimatedSignal": "api.result",
    "Filter": "api.filter",
    "Info": "api.recording",
    "InputError": "errors",
    "Recording": "messages.recording",
    "RecordingWarning": "api.estimation",
    "Result": "api.result",
    "Smoothed": "api.estimation",
    "Vehicle": "model.vehicle",
    "calibrate": "api.preparation",
    "check": "api.preparation",
    "estimate": "api.estimation",
    "explain": "api.explanation",
    "export_results": "api.result",
    "identify": "api.identification",
    "info": "api.recording",
    "load_vehicle": "api.vehicle",
    "new_vehicle": "api.preparation",
    "read": "api.recording",
    "smooth": "api.estimation",
    "survey_can": "api.can",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
