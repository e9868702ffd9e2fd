"""The curves that a page asks for: parts of curves as JSON, by level of detail."""

from __future__ import annotations

from typing import Any

import numpy as np
import orjson
from fastapi import APIRouter, HTTPException, Response
from pydantic import BaseModel, Field

from vsense_ros.errors import InputError
from vsense_ros.studio.curves import DISTANCE, CurveSet, open_curves
from vsense_ros.studio.project import Project

MOST_TRACES = 200  # of one request
MOST_BINS = 4000  # pixels of a wide screen


class Trace(BaseModel):
    """One curve: a signal of a set, between `begin` and `end` [s] if it is a lap, whose start lies at `shift`."""

    set: str
    name: str
    begin: float | None = None
    end: float | None = None


class CurvesRequest(BaseModel):
    """Parts of curves between two places of the axis, `time` [s] or `distance` [m]."""

    axis: str = Field(default="time", pattern="^(time|distance)$")
    begin: float
    end: float
    bins: int = Field(gt=0, le=MOST_BINS)
    traces: list[Trace] = Field(max_length=MOST_TRACES)


class PairsRequest(BaseModel):
    """Two signals of a set against each other."""

    set: str
    x: str
    y: str
    most: int = Field(default=3000, gt=0, le=20_000)


class AtRequest(BaseModel):
    """The values of all signals of a set at a time [s]."""

    set: str
    time: float


def curve_set(project: Project, name: str) -> CurveSet:
    """The set `KEY/FOLDER` of a project. Raises `InputError` for anything else."""
    key, _, folder = name.partition("/")
    if not folder.isalnum():
        raise InputError(f"{name!r} is not a set of curves")
    return open_curves(project.result_folder(key) / folder)


def part_of(curves: CurveSet, trace: Trace, request: CurvesRequest) -> dict[str, Any]:
    """One curve between two places of the axis: places `x`, extremes `low` and `high`, and, over distance, times `t`.
    A lap begins at 0."""
    if trace.name not in curves.signals:
        return {"x": [], "low": [], "high": []}
    far = request.axis == DISTANCE
    first = trace.begin or 0.0
    start = float(curves.to_distance(np.array([first]))[0]) if far else first
    limits = np.array([request.begin, request.end]) + start
    begin, end = curves.to_time(limits) if far else limits
    if trace.begin is not None:
        begin = max(begin, trace.begin)
    if trace.end is not None:
        end = min(end, trace.end)
    view = curves.view(trace.name, float(begin), float(end), request.bins)
    if far:
        return {"x": curves.to_distance(view.time) - start, "low": view.low, "high": view.high, "t": view.time}
    return {"x": view.time - start, "low": view.low, "high": view.high}


def routes(project: Project) -> APIRouter:
    """Routes below `/data` that read the curves of a project."""
    router = APIRouter(prefix="/data")

    @router.post("/curves")
    def curves(request: CurvesRequest) -> Response:
        return _answer(lambda: [part_of(curve_set(project, one.set), one, request) for one in request.traces])

    @router.post("/pairs")
    def pairs(request: PairsRequest) -> Response:
        def found() -> dict[str, Any]:
            time, x, y = curve_set(project, request.set).pairs(request.x, request.y, request.most)
            return {"t": time, "x": x, "y": y}

        return _answer(found)

    @router.post("/at")
    def at(request: AtRequest) -> Response:
        def found() -> dict[str, float]:
            curves = curve_set(project, request.set)
            return {name: curves.at(name, request.time) for name in curves.signals if ":" not in name}

        return _answer(found)

    return router


def _answer(found: Any) -> Response:
    try:
        content = found()
    except InputError as error:
        raise HTTPException(404, str(error)) from None
    return Response(orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY), media_type="application/json")
