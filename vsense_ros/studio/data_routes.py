"""The curves that a page asks for: parts of curves by level of detail, as arrays of numbers.

The answer to `/data/curves` is binary: the length of a head (4 bytes, little endian), the head as JSON, which says for
each curve where its arrays begin and how long they are, then all numbers as float64. Curves with one time share it.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import orjson
from fastapi import APIRouter, HTTPException, Request, Response
from pydantic import BaseModel, Field

from vsense_ros.errors import InputError
from vsense_ros.studio.curves import DISTANCE, Array, CurveSet, open_curves
from vsense_ros.studio.project import Project

MOST_TRACES = 200  # of one request
MOST_BINS = 4000  # pixels of a wide screen
NOTHING: Array = np.zeros(0)


class Trace(BaseModel):
    """One curve: a signal of a set, between `begin` and `end` [s] if it is a lap, whose start lies at `shift`."""

    set: str
    name: str
    begin: float | None = None
    end: float | None = None
    minus: Trace | None = None  # a curve that is subtracted from this one


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


def part_of(project: Project, trace: Trace, request: CurvesRequest) -> dict[str, Array]:
    """One curve between two places of the axis: places `x`, extremes `low` and `high`, and, over distance, times `t`.
    A lap begins at 0."""
    curves = curve_set(project, trace.set)
    if trace.name not in curves.signals:
        return {"x": NOTHING, "low": NOTHING, "high": NOTHING}
    if trace.minus is not None:
        return _difference(project, trace, trace.minus, request)
    far = request.axis == DISTANCE
    start, begin, end = _window(curves, trace, request)
    view = curves.view(trace.name, begin, end, request.bins)
    x = curves.to_distance(view.time) if far else view.time
    x = x - start if start else x
    return {"x": x, "low": view.low, "high": view.high} | ({"t": view.time} if far else {})


def _window(curves: CurveSet, trace: Trace, request: CurvesRequest) -> tuple[float, float, float]:
    """Place of the axis where a trace begins, and the times [s] between which it is shown."""
    far = request.axis == DISTANCE
    first = trace.begin or 0.0
    start = float(curves.to_distance(np.array([first]))[0]) if far else first
    limits = np.array([request.begin, request.end]) + start
    begin, end = map(float, curves.to_time(limits) if far else limits)
    begin = begin if trace.begin is None else max(begin, trace.begin)
    return start, begin, end if trace.end is None else min(end, trace.end)


def _difference(project: Project, trace: Trace, other: Trace, request: CurvesRequest) -> dict[str, Array]:
    """One curve less another one at the same places, both interpolated at as many places as the screen has pixels."""
    x = np.linspace(request.begin, request.end, 2 * request.bins)
    values = []
    for one in (trace, other):
        curves = curve_set(project, one.set)
        start, begin, end = _window(curves, one, request)
        time = curves.to_time(x + start) if request.axis == DISTANCE else x + start
        value = curves.sampled(one.name, time) if one.name in curves.signals else np.full(len(x), np.nan)
        values.append(np.where((time >= begin) & (time <= end), value, np.nan))
    difference = values[0] - values[1]
    return {"x": x, "low": difference, "high": difference}


def packed(curves: Sequence[Mapping[str, Array]]) -> bytes:
    """Curves as the bytes that the page reads; arrays that are one object are sent once."""
    places: dict[int, list[int]] = {}
    arrays: list[Array] = []
    head = []
    count = 0
    for curve in curves:
        entry = {}
        for name, array in curve.items():
            if id(array) not in places:
                places[id(array)] = [count, len(array)]
                arrays.append(np.ascontiguousarray(array, dtype="<f8"))
                count += len(array)
            entry[name] = places[id(array)]
        head.append(entry)
    words = orjson.dumps(head)
    words += b" " * (-(len(words) + 4) % 8)  # numbers begin at a multiple of their size
    return b"".join([struct.pack("<I", len(words)), words, *(array.tobytes() for array in arrays)])


def routes(project: Project) -> APIRouter:
    """Routes below `/data` that read the curves of a project, and take uploaded files."""
    router = APIRouter(prefix="/data")

    @router.post("/curves")
    def curves(request: CurvesRequest) -> Response:
        try:
            content = packed([part_of(project, one, request) for one in request.traces])
        except InputError as error:
            raise HTTPException(404, str(error)) from None
        return Response(content, media_type="application/octet-stream")

    @router.post("/pairs")
    def pairs(request: PairsRequest) -> Response:
        def content() -> dict[str, Any]:
            time, x, y = curve_set(project, request.set).pairs(request.x, request.y, request.most)
            return {"t": time, "x": x, "y": y}

        return _answer(content)

    @router.post("/at")
    def at(request: AtRequest) -> Response:
        def content() -> dict[str, float]:
            curves = curve_set(project, request.set)
            return {name: curves.at(name, request.time) for name in curves.signals if ":" not in name}

        return _answer(content)

    @router.put("/uploads/{name}")
    async def upload(name: str, request: Request) -> dict[str, str]:
        path = project.upload_path(name)
        part = path.with_name(f".{path.name}.part")
        try:
            with part.open("wb") as file:
                async for block in request.stream():
                    file.write(block)
            part.replace(path)
        except OSError as error:
            raise HTTPException(507, f"{path.name} cannot be written ({error.strerror})") from None
        finally:
            part.unlink(missing_ok=True)
        return {"path": str(path)}

    return router


def _answer(read: Any) -> Response:
    try:
        content = read()
    except InputError as error:
        raise HTTPException(404, str(error)) from None
    return Response(orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY), media_type="application/json")
