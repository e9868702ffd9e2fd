"""Pictures of the README and of the first page of the documentation: `python tools/pictures.py` writes all anew.

`estimate.png` shows the observer on the committed bag `bags/double_lane_change`, and `explain.svg` is the first picture
of the committed report on a real car, `docs/examples/genesis/report.html`. `trailer.png` shows the sway of a trailer
that is loaded a little behind its axle, beside that of the same one with a usual load.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from vsense_ros.bag.importers import import_recording
from vsense_ros.evaluate.picture import BAND, ESTIMATE, STYLE, TRUTH, WHEEL_COLOURS
from vsense_ros.evaluate.signals import Series, read_signals
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.combination import SingleTrack, critical_speed, damping_ratio
from vsense_ros.identification.towing import Towing
from vsense_ros.manoeuvre import generate
from vsense_ros.messages.recording import Recording
from vsense_ros.model.trailer import Trailer
from vsense_ros.runner import run

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs/pictures"
BAG, VEHICLE = "bags/double_lane_change", "prototype_model"
REPORT = ROOT / "docs/examples/genesis/report.html"
WHEEL_NAMES = {"fl": "front left", "fr": "front right", "rl": "rear left", "rr": "rear right"}
EMBEDDED = re.compile(r"data:image/svg\+xml;base64,([^\"]+)")


def estimate(recording: Recording, output: Recording) -> Figure:
    """Side slip with its standard deviation, and the lateral force of each tyre, beside the true values."""
    estimates, truths = read_signals(output, "vsense"), read_signals(recording, "reference")
    start = min(int(series.stamp[0]) for series in truths.values())
    figure = Figure(figsize=(10.0, 5.6), facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1, sharex=True)
    _side_slip(upper, estimates["side_slip"], truths["side_slip"], start)
    _lateral_forces(lower, estimates, truths, start)
    lower.set_xlabel("time [s]")
    lower.margins(x=0.005)
    return figure


def _side_slip(axes: Axes, series: Series, truth: Series, start: int) -> None:
    band = series.band()
    assert band is not None, "the observer states a standard deviation for its side slip"
    seconds, value = _curve(series, start)
    axes.set_title("Side-slip angle [°]: which way the car moves compared with where it points")
    axes.fill_between(
        seconds, value - band, value + band, color=BAND, alpha=0.55, lw=0.0, label="±2 standard deviations"
    )
    axes.plot(seconds, value, color=ESTIMATE, label="estimate")
    axes.plot(*_curve(truth, start), color=TRUTH, lw=1.0, ls=(0, (4, 3)), label="truth")
    axes.set_ylim(-2.2, 2.2)
    axes.legend(loc="upper left", ncols=3)


def _lateral_forces(axes: Axes, estimates: Mapping[str, Series], truths: Mapping[str, Series], start: int) -> None:
    axes.set_title("Lateral force of each tyre [kN]")
    for wheel, name in WHEEL_NAMES.items():
        key = f"wheel_force_{wheel}_y"
        axes.plot(*_curve(estimates[key], start), color=WHEEL_COLOURS[wheel], label=name)
        axes.plot(*_curve(truths[key], start), color=TRUTH, lw=0.8, ls=(0, (4, 3)))
    axes.legend(loc="upper left", ncols=4)
    axes.set_ylim(-1.3, 1.9)


def trailer() -> Figure:
    """Articulation of two trailers after the same steering, by the filter of the trailer without a sensor of it, and
    damping ratios over speed."""
    figure = Figure(figsize=(10.0, 5.6), facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1)
    upper.set_title("Articulation angle [°] after a turn of the steering wheel at 90 km/h")
    lower.set_title("Damping ratio of the sway: none where it begins to grow")
    speeds = np.arange(40, 161, 2) / 3.6
    car = load_vehicle(vehicle_path("rav4"))
    for nose_load, colour in ((70.0, ESTIMATE), (-30.0, WHEEL_COLOURS["rr"])):
        towed, label = Trailer(mass=1400, nose_load=nose_load), f"1400 kg, {nose_load:.0f} kg on the hitch"
        towing_car = car.model_copy(update={"physics": car.physics.model_copy(update={"trailer": towed})})
        recording = generate("trailer_sway", towing_car)
        samples, truth = Towing(towing_car).take(recording), recording["reference/articulation"]
        begin = truth.stamp[0]
        t = np.array([(sample.stamp - begin) * 1e-9 for sample in samples])
        angle, deviation = (np.degrees([s.values[k][0] for s in samples]) for k in ("position", "velocity"))
        upper.fill_between(t, angle - 2 * deviation, angle + 2 * deviation, color=colour, alpha=0.2, lw=0.0)
        upper.plot(t, angle, color=colour, label=label)
        upper.plot((truth.stamp - begin) * 1e-9, np.degrees(truth.columns["position"]), color=TRUTH, ls=(0, (4, 3)))
        single_track = SingleTrack.of(car)
        lower.plot(speeds * 3.6, [damping_ratio(single_track, towed, v) for v in speeds], color=colour, label=label)
        print(f"{label}: critical speed {critical_speed(single_track, towed) or np.nan:.1f} m/s")
    upper.set_xlim(1.5, 12.0)
    upper.set_ylim(-6, 6)
    upper.set_xlabel("time [s]; dashed: truth, without a sensor of the angle; bands: ±2 standard deviations")
    lower.axhline(0.0, color=TRUTH, lw=0.8)
    lower.set_xlabel("speed [km/h]")
    upper.legend(loc="upper right", ncols=2)
    return figure


def _curve(series: Series, start: int) -> tuple[object, object]:
    return (series.stamp - start) * 1e-9, series.shown()


def _save_compact(figure: Figure, path: Path) -> None:
    """Write a PNG of 64 colours, which is a quarter of the size and looks the same."""
    buffer = BytesIO()
    figure.savefig(buffer, dpi=110)
    Image.open(buffer).convert("P", palette=Image.Palette.ADAPTIVE, colors=64).save(path, optimize=True)


def main() -> None:
    recording = import_recording(ROOT / BAG)
    result = run(recording, load_vehicle(vehicle_path(VEHICLE)))
    PICTURES.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(dict(STYLE)):
        _save_compact(estimate(recording, result.output), PICTURES / "estimate.png")
        _save_compact(trailer(), PICTURES / "trailer.png")
    embedded = EMBEDDED.search(REPORT.read_text(encoding="utf-8"))
    if embedded is None:
        raise SystemExit(f"{REPORT} has no picture: vsense explain writes one")
    (PICTURES / "explain.svg").write_bytes(base64.b64decode(embedded[1]))


if __name__ == "__main__":
    main()
