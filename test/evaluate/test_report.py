"""Pictures and pages: what stands on them, and that they stand alone."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from synthetic_drives import channel, odometry, recording, slalom
from vsense_ros.evaluate.drive import Drive
from vsense_ros.evaluate.metrics import SignalScore
from vsense_ros.evaluate.picture import compose, draw
from vsense_ros.evaluate.report import outline, write_report
from vsense_ros.evaluate.signals import SIGNALS, thin
from vsense_ros.evaluate.terminal import PIPE_WIDTH, PlainConsole, show_drive
from vsense_ros.evaluate.wording import named, score_cells
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Recording


def drive(output: Recording, input: Recording, **more) -> Drive:
    diagnostics = [Diagnostic("gps", Level.WARN, "jump of 20 m <refused>", {"at": "12.3 s"})]
    run = SimpleNamespace(
        output=output, step_us_median=41.2, realtime_factor=83.1, messages_lost=2, diagnostics=diagnostics
    )
    return Drive.of("slalom", "Slalom", input, run, **more)


@pytest.fixture
def whole() -> Drive:
    seconds = np.arange(0.0, 20.0, 0.1)
    speeds = channel(
        "gps/velocity",
        "geometry_msgs/msg/TwistWithCovarianceStamped",
        seconds,
        {"linear": np.zeros((200, 3)), "angular": np.zeros((200, 3)), "covariance": np.zeros((200, 36))},
    )
    late = replace(speeds, received=speeds.stamp + 40_000_000)
    reference = slalom("reference")
    input = recording(late, *reference.channels.values(), notes=("frame 17 lost",))
    return drive(slalom("vsense", late=0.02, noise=1.0), input, notes=("no network",))


@pytest.fixture
def still(tmp_path) -> dict[str, Path]:
    """A picture that need not be drawn."""
    path = tmp_path / "still.png"
    path.write_bytes(b"\x89PNG")
    return {"slalom": path, "again": path}


class Outside(HTMLParser):
    """Collects what a page would load from elsewhere, and its visible text."""

    def __init__(self) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.text = ""
        self.skip = False

    def handle_starttag(self, tag, attrs):
        self.skip = tag in ("script", "style")
        for key, value in attrs:
            if key in ("src", "href") and not value.startswith(("data:", "#")):
                self.loads.append(value)

    def handle_endtag(self, tag):
        self.skip = False

    def handle_data(self, data):
        if not self.skip:
            self.text += data


def test_the_page_stands_alone_and_says_everything(whole, tmp_path):
    page = write_report([whole], tmp_path / "new" / "report.html", title="Drives of today").read_text()
    reader = Outside()
    reader.feed(page)
    assert reader.loads == []
    for words in ("Drives of today", "side slip", "41 µs", "83.1 ×", "frame 17 lost", "no network", "gps/velocity"):
        assert words in reader.text
    assert "jump of 20 m <refused>" in reader.text
    assert "40.0 ms" in reader.text
    assert "10 Hz" in reader.text


def test_provenance_stands_on_top_of_the_page(whole, still, tmp_path):
    origin = {"software": "vsense_ros 1, commit abc", "recording": "lap.mcap, SHA-256 0123"}
    page = write_report([whole], tmp_path / "r.html", title="r", pictures=still, provenance=origin).read_text()
    for words in ("vsense_ros 1, commit abc", "lap.mcap, SHA-256 0123"):
        assert page.index("<h1>") < page.index(words) < page.index("<h2>")


def test_every_plot_has_a_legend_of_its_own_and_the_cursor_goes_through_all(whole, still, tmp_path):
    page = write_report([whole], tmp_path / "r.html", title="r", pictures=still).read_text()
    legends = set(re.findall(r'"legend":"(legend\d*)"', page))
    plots = len(set(re.findall(r'"yaxis":"(y\d*)"', page)))
    assert len(legends) == plots > 1
    assert len(set(re.findall(r'"xaxis":"(x\d*)"', page))) == 1


def test_the_curves_offer_no_upload(whole, still, tmp_path):
    page = write_report([whole], tmp_path / "report.html", title="private", pictures=still).read_text()
    assert '"showSendToCloud": false' in page


@pytest.mark.exam
def test_the_script_of_the_curves_is_on_the_page_once_for_all_drives(whole, still, tmp_path):
    one = write_report([whole], tmp_path / "one.html", title="one", pictures=still).stat().st_size
    two = write_report([whole, replace(whole, name="again")], tmp_path / "two.html", title="two", pictures=still)
    assert two.stat().st_size - one < one - 3_000_000
    assert set(re.findall(r'<section id="(\w+)"', two.read_text())) == {"slalom", "again"}


def test_baselines_stand_below_the_signal_they_are_compared_with(whole, still, tmp_path):
    raw = SignalScore(0.16, 1.0, 0.1, 0.05, "m/s", 100)
    page = write_report(
        [replace(whole, baselines={"raw wheel speeds": {"speed": raw}})], tmp_path / "r.html", title="r", pictures=still
    ).read_text()
    assert re.search(r"<td>speed</td>.*?raw wheel speeds</td><td>0\.160 m/s</td>", page, re.S)


def test_the_picture_is_written_as_png_and_svg(whole, tmp_path):
    png, svg = draw(whole, tmp_path / "picture")
    assert png.read_bytes().startswith(b"\x89PNG")
    assert "<svg" in svg.read_text()[:1000]


@pytest.mark.exam
def test_the_same_drive_gives_the_same_picture_to_the_byte(whole, tmp_path):
    assert draw(whole, tmp_path / "a")[1].read_bytes() == draw(whole, tmp_path / "b")[1].read_bytes()


def test_every_axis_of_the_picture_has_a_unit(whole):
    for axes in compose(whole).axes:
        labels = [axes.get_ylabel(), axes.get_xlabel()]
        assert any("[" in label for label in labels), axes.get_title()


@pytest.mark.parametrize(
    ("output", "reference"),
    [
        pytest.param(lambda s: [odometry("vsense/odometry", s)], lambda s: [], marks=pytest.mark.exam),
        (lambda s: [odometry("vsense/odometry", s)], lambda s: [odometry("reference/odometry", s + 100.0)]),
        (lambda s: [], lambda s: [odometry("reference/odometry", s)]),
        pytest.param(lambda s: [], lambda s: [], marks=pytest.mark.exam),
    ],
    ids=["no reference", "reference at another time", "no estimate", "nothing"],
)
def test_a_drive_with_parts_missing_still_has_a_picture_and_a_page(output, reference, tmp_path):
    seconds = np.arange(0.0, 5.0, 0.1)
    one = drive(recording(*output(seconds)), recording(*reference(seconds)))
    page = write_report([one], tmp_path / "report.html", title="parts").read_text()
    assert "no reference for anything" in page


def rows(found: Recording, chosen: slice) -> Recording:
    return replace(found, channels={topic: each.select(chosen) for topic, each in found.channels.items()})


def standing(found: Recording, place: float) -> Recording:
    """A recording with one position throughout; with NaN, with none."""
    channels = {
        topic: replace(each, columns={**each.columns, "position": np.full((len(each), 3), place)})
        if topic.endswith("odometry")
        else each
        for topic, each in found.channels.items()
    }
    return replace(found, channels=channels)


@pytest.mark.parametrize(
    ("output", "reference", "axis"),
    [
        (lambda o: rows(o, slice(1)), lambda r: r, "east of the start [m]"),
        pytest.param(lambda o: o, lambda r: rows(r, slice(50, 51)), "along the drive [m]", marks=pytest.mark.exam),
        pytest.param(
            lambda o: standing(o, np.nan),
            lambda r: rows(r, slice(50, 51)),
            "east of the start [m]",
            marks=pytest.mark.exam,
        ),
        pytest.param(lambda o: standing(o, np.nan), lambda r: standing(r, np.nan), "", marks=pytest.mark.exam),
        pytest.param(
            lambda o: standing(o, 7.0),
            lambda r: standing(r, 7.0),
            "east of the start [m]",
            marks=pytest.mark.exam,
        ),
    ],
    ids=["one estimate", "one reference", "one position", "no position", "one place"],
)
def test_a_drive_of_a_single_place_or_instant_has_a_picture_and_a_page(output, reference, axis, tmp_path):
    estimates, truth = slalom("vsense", noise=1.0, duration=3.0), slalom("reference", duration=3.0)
    one = drive(output(estimates), reference(truth))
    path = next(axes for axes in compose(one).axes if axes.get_title().startswith("Path"))
    assert path.get_xlabel() == axis
    assert write_report([one], tmp_path / "report.html", title="few").exists()


def test_friction_is_not_shown_of_tyres_whose_forces_are_never_known_at_once(whole):
    channels = dict(whole.output.channels)
    for topic, each in whole.output.channels.items():
        if "wheel_force" in topic:
            force = each.columns["force"].copy()
            force[::2, 0], force[1::2, 2] = np.nan, np.nan
            channels[topic] = replace(each, columns={**each.columns, "force": force})
    panel = next(
        axes
        for axes in compose(replace(whole, output=replace(whole.output, channels=channels))).axes
        if axes.get_title() == "Friction in use"
    )
    assert [text.get_text() for text in panel.texts] == ["not estimated"]


@pytest.mark.exam
def test_a_car_that_comes_to_rest_has_a_picture_and_a_page(whole, tmp_path):
    slip = whole.output["vsense/sideslip"]
    vector = slip.columns["vector"].copy()
    vector[-100:] = (0.0, np.inf, 0.0)  # at rest there is no side slip to know
    channels = {**whole.output.channels, "vsense/sideslip": replace(slip, columns={"vector": vector})}
    one = drive(replace(whole.output, channels=channels), whole.input)
    panel, moving = (next(a for a in compose(d).axes if a.get_title() == "Side slip") for d in (one, whole))
    assert panel.get_ylim() == pytest.approx(moving.get_ylim(), rel=0.05)
    assert write_report([one], tmp_path / "report.html", title="rest").exists()


def test_the_summary_is_plain_json_with_null_where_there_is_no_value(whole):
    found = json.loads(json.dumps(replace(whole, step_us_median=float("nan")).summary(), allow_nan=False))
    assert set(found) == {"signals", "balance_percent", "step_us_median", "realtime_factor", "messages_lost"}
    assert set(found["signals"]["side_slip"]) == {
        *("rmse", "nrmsd_percent", "bias", "lag_s", "unit"),
        *("within_2s", "nees", "known", "trivial"),
    }
    assert found["signals"]["side_slip"]["unit"] == "rad"
    assert found["step_us_median"] is None
    assert found["messages_lost"] == 2


def test_what_was_learnt_stands_on_the_page_as_of_the_end(whole, still, tmp_path):
    learnt = channel(
        "vsense/parameters",
        "sensor_msgs/msg/JointState",
        np.array([0.0, 1.0]),
        {"position": np.array([[0.5], [0.0271]]), "velocity": np.array([[1.0], [0.01]]), "effort": np.zeros((2, 0))},
        names=("imu.gyro_bias_x",),
    )
    one = replace(whole, output=recording(*whole.output.channels.values(), learnt))
    assert one.parameters() == [("imu.gyro_bias_x", 0.0271, 0.01, 1.0)]
    page = write_report([one], tmp_path / "report.html", title="learnt", pictures=still).read_text()
    assert re.search(r"imu: gyro bias x</td><td>\+0\.0271</td><td>0\.01</td><td>1</td>", page)


def test_a_path_of_unknown_heading_is_not_said_to_go_north(whole):
    odometry = whole.output["vsense/odometry"]
    turn = np.linspace(0.0, 2 * np.pi, len(odometry.stamp))
    circle = np.column_stack([np.sin(turn), np.cos(turn), np.zeros_like(turn)])
    labels = []
    for deviation in (0.1, 3.2):  # [rad] of the heading
        covariance = odometry.columns["pose_covariance"].copy()
        covariance[:, 35] = deviation**2
        columns = {**odometry.columns, "position": 50 * circle, "pose_covariance": covariance}
        channels = {**whole.output.channels, "vsense/odometry": replace(odometry, columns=columns)}
        axes = compose(replace(whole, output=replace(whole.output, channels=channels))).axes
        labels.append(next(one.get_ylabel() for one in axes if one.get_title().startswith("Path")))
    assert labels == ["north of the start [m]", "y from the start [m]"]


def test_references_and_estimates_are_no_sensors(whole):
    assert [(row.topic, row.count) for row in whole.sensors()] == [("gps/velocity", 200)]


def test_scores_are_shown_in_the_units_people_read():
    found = SignalScore(np.radians(0.157), 3.456, np.radians(-0.01234), -0.0123, "rad", 10)
    assert score_cells("side_slip", found) == (
        *("0.157°", "–", "–", "–"),
        *("3.46", "-0.012°", "-12.3"),
    )
    sure = replace(found, within_2s=0.42, nees=7.31, known_share=0.5)
    assert score_cells("side_slip", sure, ("zero", replace(found, rmse=np.radians(1.23))))[:4] == (
        *("0.157° in 50 %", "42 %", "7.31", "1.23° (zero)"),
    )
    assert score_cells("yaw", found)[4] == "–"  # a range of headings is that of the drive
    assert score_cells("wheel_force_fl_z", SignalScore(123.4, None, 1.0, None, "N", 1)) == (
        *("0.123 kN", "–", "–", "–"),
        *("–", "+0.001 kN", "–"),
    )


def test_in_a_pipe_no_number_of_the_widest_table_is_cut(whole):
    """Names and figures of simpler ways as long as the longest of those that drives are compared with."""
    worst = SignalScore(0.0382, 182.26, -0.0079, -0.0427, "m/s", 10, within_2s=1.0, nees=20.99)
    wide = {
        "longitudinal_velocity": (worst, ("GNSS", worst), {"kinematic, rear axle without slip": worst}),
        "side_slip": (replace(worst, rmse=0.0027, unit="rad"), ("zero", worst), {}),
    }
    shown = replace(
        whole,
        scores={name: score for name, (score, _, _) in wide.items()},
        trivial={name: one for name, (_, one, _) in wide.items()},
        baselines={label: {name: s} for name, (_, _, more) in wide.items() for label, s in more.items()},
    )
    console = PlainConsole(width=PIPE_WIDTH)
    with console.capture() as captured:
        show_drive(shown, console)
    assert "…" not in captured.get()
    assert "182.26" in captured.get()
    assert "-42.7" in captured.get()


def test_twelve_forces_are_one_word():
    forces = [name for name in SIGNALS if name.startswith("wheel_force_")]
    assert named(["roll", *forces, "wheel_slip_fl"]) == "roll, tyre forces (12 components), slips of 1 tyres"


def test_thinning_keeps_a_peak_of_a_single_sample():
    value = np.zeros(100_000)
    value[54_321] = 1.0
    rows = thin(value)
    assert len(rows) <= 1600
    assert 54_321 in rows


def test_where_no_estimate_came_no_curve_is_drawn_and_the_seconds_are_said(whole, tmp_path, still):
    def interrupted(one):
        time = (one.stamp - one.stamp[0]) * 1e-9
        return one.select((time < 5.0) | (time > 8.0))

    output = Recording({topic: interrupted(one) for topic, one in whole.output.channels.items()})
    gappy = drive(output, whole.input)
    assert "3.0 s without an estimate" in gappy.facts()
    assert not any("without an estimate" in fact for fact in whole.facts())
    curves = [line for axes in compose(gappy).axes for line in axes.lines if line.get_color() == "#0072B2"]
    assert len(curves) >= 8
    for line in curves:
        time, value = line.get_data()
        assert not np.any((time > 5.01) & (time < 7.99) & np.isfinite(value))
        assert np.isnan(value).any()


def test_a_band_encloses_what_is_known_and_nothing_between():
    """The area within the outline is that of the stretches alone (shoelace formula)."""
    times = np.array([0.0, 1.0, 2.0, 5.0, 8.0, 9.0])
    centre = np.array([1.0, 1.0, 1.0, np.nan, 5.0, 5.0])
    x, y = outline(times, centre - 0.5, centre + 0.5)
    ends = np.flatnonzero(np.isnan(x))
    pieces = [(x[a:b], y[a:b]) for a, b in zip((0, *(ends[:-1] + 1)), ends, strict=True)]
    areas = [abs(px @ np.roll(py, 1) - py @ np.roll(px, 1)) / 2 for px, py in pieces]
    assert areas == pytest.approx([2.0, 1.0])
    assert [len(part) for part in outline(times, np.full(6, np.nan), centre)] == [0, 0]
