"""Pictures of what Leung 2010 draws of vehicle models that nothing corrects: chapter 3 and section 5.2."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from studies import leung_models as leung
from vsense_ros.evaluate.handling_picture import bode
from vsense_ros.evaluate.picture import MUTED, STYLE, TRUTH
from vsense_ros.evaluate.tyre_rig import TyreRig
from vsense_ros.files.names import drawn as printable_title
from vsense_ros.model.coordinates import ROLL, SPEED_X, SPEED_Y, SPIN, STEERING, WHEEL_OUTPUTS, YAW_RATE
from vsense_ros.model.handling.base import slopes, static_loads
from vsense_ros.model.handling.response import Response

Array = NDArray[np.float64]
Progress = Callable[[float], None]

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
KEYS = {"side_slip": "side slip", "yaw_rate": "yaw rate", "heading": "heading"}
CHANGES = np.arange(0.5, 1.501, 0.01)  # of mass and inertia: ±50 % in steps of 1 %
STIFFNESSES = np.concatenate([np.arange(0.1, 1.0, 0.1), np.arange(1.0, 6.01, 0.25)])  # -90 … +500 %
LARGEST = 30.0  # [%] at the end of the maps' scale, as in the thesis
BIASES = np.radians(np.arange(-10, 10.1, 1.0))  # at the steering wheel
NOISES = np.radians(np.array([0.0, 0.5, 1.0, 2.0, 4.0]))
SWEEP_SPEEDS = (20, 50)  # [km/h]


def draw_all(folder: Path, store: Path, progress: Progress = lambda share: None) -> list[Path]:
    """Every picture of this file; what the plant did is kept in `store`."""
    folder.mkdir(parents=True, exist_ok=True)
    jobs: tuple[Callable[[Path, Path], list[Path]], ...] = (
        parameter_tests,
        lambda folder, store: frequency_responses(folder),
        transients,
        parameter_errors,
        stiffness_maps,
        steering_errors,
        side_slip_and_roll,
    )
    paths = []
    for i, job in enumerate(jobs):
        paths += job(folder, store)
        progress((i + 1) / len(jobs))
    return paths


def parameter_tests(folder: Path, store: Path) -> list[Path]:
    """Figures 3.7 to 3.10: the single-track model beside the plant, rolling radii, lateral velocity, tyre forces."""
    car, (front, rear) = leung.plant(), static_loads(leung.plant())
    slow, oval = leung.driven("double_oval_15", store), leung.driven("double_oval_25", store)
    with page("Parameter tests", (12, 6.6)) as (figure, save):
        panels = figure.subplots(2, 3)
        ours = leung.open_loop(leung.MODELS[0], oval)
        pair = ((ours["yaw_rate"], COLOURS[0], "2DoF bicycle"), (oval.u[:, YAW_RATE], TRUTH, "plant"))
        for value, colour, label in pair:
            panels[0][0].plot(oval.t, np.degrees(value), color=colour, lw=1.0, label=label)
        labelled(panels[0][0], "Yaw rate, double oval at 25 km/h", "time [s]", "[°/s]")
        panels[0][0].legend()
        ours = leung.open_loop(leung.MODELS[0], slow)
        panels[0][1].plot(slow.t, ours["lateral"], color=COLOURS[0], lw=1.0)
        panels[0][1].plot(slow.t, slow.u[:, SPEED_Y], color=TRUTH, lw=1.0)
        labelled(panels[0][1], "Lateral velocity, double oval at 15 km/h", "time [s]", "[m/s]")
        for kph, line in ((15, "-"), (50, "--")):
            drive = leung.driven(f"double_oval_{kph}", store)
            straight = drive.t < 20.0 * 15 / kph
            for wheel, (name, colour) in enumerate(zip(("FL", "FR", "RL", "RR"), COLOURS, strict=False)):
                if wheel % 2 == 0:
                    radius = drive.u[straight, SPEED_X] / drive.u[straight, SPIN][:, wheel]
                    label = f"{name}, {kph} km/h"
                    panels[0][2].plot(drive.t[straight], 1e3 * radius, color=colour, ls=line, lw=1.0, label=label)
        labelled(panels[0][2], "Speed over spin on the straight", "time [s]", "[mm]")
        panels[0][2].legend(fontsize=7)
        for panel, slip, force, sign, words, x in (
            (panels[1][0], "slip", "force_x", 1.0, "Longitudinal force, double oval at 15 km/h", "slip [-]"),
            (
                panels[1][1],
                "slip_angle",
                "force_y",
                -1.0,
                "Lateral force, double oval at 15 km/h",
                "minus slip angle [rad]",
            ),
        ):
            x_row, y_row = (WHEEL_OUTPUTS.index(name) for name in (slip, force))
            for wheel, (name, colour) in enumerate(zip(("FL", "FR", "RL", "RR"), COLOURS, strict=False)):
                values = sign * slow.wheels[::10, x_row, wheel], slow.wheels[::10, y_row, wheel]
                panel.plot(*values, ".", ms=2, color=colour, label=name)
            labelled(panel, words, x, "[N]")
        panels[1][1].legend(markerscale=4)
        axles = ((car.physics.front, front, "front"), (car.physics.rear, rear, "rear"))
        angles = np.linspace(-0.2, 0.2, 201)
        for (axle, load, name), colour in zip(axles, COLOURS, strict=False):
            settled = TyreRig(axle.tyre, load).settled(-angles)
            panels[1][2].plot(angles, settled / 1e3, color=colour, label=name)
            panels[1][2].plot(angles, angles * slopes(axle, load)[1] / 1e3, color=colour, ls=":", lw=0.9)
        panels[1][2].set_ylim(-6, 6)
        labelled(panels[1][2], "Tyres under static load, and their slopes", "minus slip angle [rad]", "[kN]")
        panels[1][2].legend()
        return [save(folder / "figures_3_7_to_3_10_parameter_tests.png")]


def frequency_responses(folder: Path) -> list[Path]:
    """Figures 3.11, 3.12 and D.1 to D.5: all five models from 10 to 100 km/h, and all in one at 20, 50, 80."""
    models = {name: response for name, (_, response) in leung.handling_models(leung.plant()).items()}
    title = "Lateral velocity over road-wheel angle, both front wheels steered"
    every = draw_bode(models, title, folder / "figures_d1_to_d5_bode.png")
    with page("The five models coincide in straight running", (10, 4.4)) as (figure, save):
        size, phase = figure.subplots(1, 2)
        bode(models, size, phase, (20, 50, 80))
        return [every, save(folder / "figures_3_11_3_12_bode.png")]


def transients(folder: Path, store: Path) -> list[Path]:
    """Figures 3.13 to 3.16: the models driven with the inputs of the plant, without noise."""
    paths = []
    for row in ("DO25", "LC25"):
        drive = leung.driven(leung.MANOEUVRE_ROWS[row], store)
        with page(f"Models driven as the plant, {row}", (11, 6.4)) as (figure, save):
            panels = figure.subplots(2, 2, sharex=True)
            panels[0][0].plot(drive.t, drive.u[:, SPEED_X], color=TRUTH, lw=1.6, label="plant")
            panels[0][1].plot(drive.t, drive.u[:, SPEED_Y], color=TRUTH, lw=1.6, label="plant")
            for name, colour in zip(leung.MODELS, COLOURS, strict=True):
                ours = leung.open_loop(name, drive)
                panels[0][0].plot(drive.t, ours["forward"], color=colour, lw=0.9, label=name)
                panels[0][1].plot(drive.t, ours["lateral"], color=colour, lw=0.9)
                panels[1][0].plot(drive.t, np.degrees(ours["yaw_rate"] - drive.u[:, YAW_RATE]), color=colour, lw=0.8)
                panels[1][1].plot(drive.t, ours["lateral"] - drive.u[:, SPEED_Y], color=colour, lw=0.8)
            labelled(panels[0][0], "Forward velocity", "", "[m/s]")
            labelled(panels[0][1], "Lateral velocity", "", "[m/s]")
            labelled(panels[1][0], "Error of the yaw rate", "time [s]", "[°/s]")
            labelled(panels[1][1], "Error of the lateral velocity", "time [s]", "[m/s]")
            panels[0][0].legend(fontsize=7)
            paths.append(save(folder / f"figures_3_13_to_3_16_{row.lower()}.png"))
    return paths


def parameter_errors(folder: Path, store: Path) -> list[Path]:
    """Figures 5.1, 5.2, 5.6 and 5.7: a wrong mass, a wrong inertia; dashed against the model itself as the plant."""
    with page("Errors of the single-track model over those of its parameters", (11, 6.6)) as (figure, save):
        panels = figure.subplots(2, 2, sharex=True)
        for i, kph in enumerate(SWEEP_SPEEDS):
            drive = leung.driven(f"double_oval_{kph}", store)
            for k, (name, words) in enumerate((("mass", "mass"), ("yaw_inertia", "yaw inertia"))):
                for consistent, line in ((False, "-"), (True, "--")):
                    ours = leung.sweep(drive, {name: CHANGES}, consistent=consistent)
                    for (key, label), colour in zip(KEYS.items(), COLOURS, strict=False):
                        label = label if not consistent else ""
                        panels[i][k].plot(100 * (CHANGES - 1), ours[key], color=colour, ls=line, label=label)
                x = f"error of the {words} [%]" if i else ""
                labelled(panels[i][k], f"Double oval at {kph} km/h, {words}", x, "NRMSD [%]")
                panels[i][k].set_ylim(bottom=0)
        panels[0][0].legend(title="dashed: the model itself as plant", title_fontsize=8)
        return [save(folder / "figures_5_1_5_2_5_6_5_7_parameters.png")]


def stiffness_maps(folder: Path, store: Path) -> list[Path]:
    """Figures 5.3 to 5.5, 5.8 and 5.9: wrong stiffnesses of both axles."""
    with page("Errors of the single-track model over its axle stiffnesses", (12, 7.2)) as (figure, save):
        panels = figure.subplots(2, 3, sharex=True, sharey=True)
        for i, kph in enumerate(SWEEP_SPEEDS):
            maps = leung.stiffness_map(leung.driven(f"double_oval_{kph}", store), STIFFNESSES)
            for k, (key, words) in enumerate(KEYS.items()):
                percent = 100 * (STIFFNESSES - 1)
                drawn = _map(panels[i][k], percent, percent, maps[key])
                labelled(
                    panels[i][k], f"{words.capitalize()}, {kph} km/h", "rear stiffness [%]" if i else "",
                    "front stiffness [%]" if k == 0 else "",
                )  # fmt: skip
        figure.colorbar(drawn, ax=panels, shrink=0.6, label="NRMSD [%], cut off at 30", extend="max")
        return [save(folder / "figures_5_3_to_5_5_5_8_5_9_stiffness.png")]


def steering_errors(folder: Path, store: Path) -> list[Path]:
    """Bias and noise of the steering sensor, which table 5.3 has at one point each."""
    with page("Errors of the single-track model over those of the steering sensor", (11, 4.2)) as (figure, save):
        panels = figure.subplots(1, 3)
        drive = leung.driven("double_oval_25", store)
        maps = leung.bias_map(drive, BIASES, NOISES)
        for panel, (key, words) in zip(panels, KEYS.items(), strict=True):
            for k, noise in enumerate(NOISES):
                label = f"{np.degrees(noise):g}°"
                panel.plot(np.degrees(BIASES), maps[key][:, k], color=COLOURS[k], lw=1.0, label=label)
            expected = 100 * np.abs(BIASES) / leung.plant().physics.steering.ratio / np.ptp(drive.inputs[:, STEERING])
            if key != "heading":
                panel.plot(np.degrees(BIASES), expected, color=MUTED, ls=":", lw=2.0, label="bias over range")
            labelled(
                panel, f"{words.capitalize()}, double oval at 25 km/h", "bias of the steering wheel [°]", "NRMSD [%]"
            )
        panels[0].legend(title="noise", title_fontsize=8, fontsize=7)
        return [save(folder / "steering_bias_and_noise.png")]


def side_slip_and_roll(folder: Path, store: Path) -> list[Path]:
    """Figure 5.10: side slip with clean and noisy inputs at 45 km/h; figure 5.11: roll in the lane changes."""
    with page("Side slip of the single-track model, and the roll that it does not know", (11, 4.2)) as (
        figure,
        save,
    ):
        left, right = figure.subplots(1, 2)
        drive, car = leung.driven("double_oval_45", store), leung.plant()
        steering, speed = leung.noisy_inputs(car, drive, 1)
        true_speed = np.hypot(drive.u[:, SPEED_X], drive.u[:, SPEED_Y])
        clean = leung.model_truth(leung.numbers_of(car), drive.inputs[:, STEERING], true_speed)
        noisy = leung.model_truth(leung.numbers_of(car), steering[:, 0], speed[:, 0])
        for value, colour, label in (
            (noisy["side_slip"], COLOURS[4], "sensors of table B.1"), (clean["side_slip"], COLOURS[0], "clean inputs"),
            (drive.side_slip, TRUTH, "plant"),
        ):  # fmt: skip
            left.plot(drive.t, np.degrees(value), color=colour, lw=0.9, label=label)
        labelled(left, "Side slip, double oval at 45 km/h", "time [s]", "[°]")
        left.legend()
        for row, colour in zip(("LC15", "LC25", "LC35", "LC45", "LC55"), COLOURS, strict=True):
            drive = leung.driven(leung.MANOEUVRE_ROWS[row], store)
            away = np.concatenate([[0.0], np.cumsum(drive.u[1:, SPEED_X] * leung.STEP)])
            right.plot(away, np.degrees(drive.q[:, ROLL]), color=colour, lw=1.0, label=row)
        labelled(right, "Roll in the lane changes", "way [m]", "[°]")
        right.set_xlim(380, 625)
        right.legend()
        return [save(folder / "figures_5_10_5_11_side_slip_and_roll.png")]


@contextmanager
def page(title: str, size: tuple[float, float]) -> Iterator[tuple[Figure, Callable[[Path], Path]]]:
    """A figure in the style of the project, and what saves it."""
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")

        def save(path: Path) -> Path:
            figure.savefig(path, dpi=90)
            return path

        yield figure, save


def labelled(panel: Any, title: str, x: str, y: str) -> None:
    panel.set_title(title)
    panel.set_xlabel(x)
    panel.set_ylabel(y)


def _map(panel: Any, x: Sequence[float] | Array, y: Sequence[float] | Array, value: Array) -> Any:
    drawn = panel.contourf(x, y, np.minimum(value, LARGEST), levels=np.arange(0, LARGEST + 0.1, 2.0), cmap="viridis")
    panel.plot(0, 0, "+", color="white", ms=9)
    panel.grid(False)
    return drawn


def draw_bode(responses: Mapping[str, Response], title: str, path: Path) -> Path:
    """Draw the Bode plot of each model by itself, magnitude above and phase below."""
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(3.1 * len(responses) + 1, 7), layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(printable_title(title), x=0.01, ha="left", fontsize=12, fontweight="bold")
        panels = figure.subplots(2, len(responses), sharex=True, sharey="row", squeeze=False)
        for i, (name, response) in enumerate(responses.items()):
            bode({"": response}, panels[0][i], panels[1][i])
            panels[0][i].set_title(name)
            panels[0][i].set_xlabel("")
            panels[1][i].set_title("")
            if i:
                panels[0][i].get_legend().remove()
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=90)
    return path
