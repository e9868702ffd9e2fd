"""What an identification came to: a table for the terminal, a page that opens without a network, and JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from vsense_ros.estimation.filter import Array
from vsense_ros.evaluate.html_page import embedded, write_page
from vsense_ros.evaluate.picture import BAND, ESTIMATE, MUTED, STYLE
from vsense_ros.files.atomic import atomic_write
from vsense_ros.identification.identified import Identification, unit_of
from vsense_ros.model.handling import best_4dof
from vsense_ros.model.handling.best_4dof import PAPER, REACH, Best4Dof

_STEP = 1e-4  # of a prior deviation, for slopes of curves


def content(identification: Identification) -> dict[str, Any]:
    """An identification as what is written to identification.json."""
    return {
        "model": identification.model,
        "vehicle": identification.before.name,
        "parameters": {
            name: {
                "before": identification.start[name], "value": float(identification.information.values[i]),
                "deviation": float(identification.information.deviations[i]),
                "determined": name in identification.determined,
            }
            for i, name in enumerate(identification.information.names)
        },
        "cornering_stiffness": {
            p.axle: {"value": p.value, "deviation": p.deviation, "determined": p.is_determined, "halves": p.halves}
            for p in identification.products
        },
        "refused": {refusal.name: str(refusal) for refusal in identification.refused},
        "passes": len(identification.rinsed.passes),
        "settled": identification.rinsed.settled,
        "fits": identification.fits,
        "side_slip_rmse_deg": {name: float(np.degrees(value)) for name, value in identification.side_slip.items()},
        "sentences": identification.sentences(),
    }  # fmt: skip


def write(identification: Identification, folder: Path) -> Path:
    """Write identification.json and report.html into a folder; returns the page."""
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_write(folder / "identification.json") as file:
        file.write(json.dumps(content(identification), indent=2) + "\n")
    return write_page(
        folder / "report.html", "vsense_ros.identification", "identification.html.j2",
        title=f"{identification.before.name}: parameters identified", identification=identification,
        rows=identification.rows(),
        degrees={name: f"{np.degrees(value):.3f}" for name, value in identification.side_slip.items()},
        pictures=[(title, _encoded(figure)) for title, figure in pictures(identification).items()],
    )  # fmt: skip


def pictures(identification: Identification) -> Mapping[str, Figure]:
    """Figures of an identification by their titles."""
    with matplotlib.rc_context(dict(STYLE)):
        return {
            "Force curves with one standard deviation": _curves(identification),
            "Convergence: parameters by pass": _convergence(identification),
            "Correlation of the parameters": _correlation(identification),
        }


def _encoded(figure: Figure) -> str:
    buffer = BytesIO()
    with matplotlib.rc_context(dict(STYLE)):
        figure.savefig(buffer, dpi=110, format="png")
    return embedded(buffer.getvalue())


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def forces(identification: Identification, values: Mapping[str, float]) -> Array:
    """Force curves (4, q) [N]; parameters that the model does not have are those of the file."""
    full = {name: values.get(name, identification.start.get(name, PAPER[name])) for name in Best4Dof.parameters}
    return best_4dof.curves(full)


def curve_bands(identification: Identification) -> tuple[Array, Array]:
    """Force curves (4, q) and their standard deviations [N], by the slopes along each parameter."""
    names, values = identification.information.names, identification.information.values
    values_by_name = identification.start | dict(zip(names, values.tolist(), strict=True))
    middle, slopes = forces(identification, values_by_name), []
    for i, name in enumerate(names):
        step = _STEP * identification.information.prior[i]
        slopes.append((forces(identification, values_by_name | {name: values_by_name[name] + step}) - middle) / step)
    by_parameter = np.array(slopes)
    variance = np.einsum("icq,ij,jcq->cq", by_parameter, identification.information.covariance, by_parameter)
    return middle, np.sqrt(np.maximum(variance, 0.0))


def _curves(identification: Identification) -> Figure:
    shown = [name for name in REACH if identification.model == "best" or "lateral" in name]
    figure = _figure(3.4 * len(shown), 3.2)
    middle, band = curve_bands(identification)
    before = forces(identification, identification.start)
    for axes, name in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
        i, slips = list(REACH).index(name), best_4dof.curve_slips(name)
        low, high = (middle[i] - band[i]) / 1e3, (middle[i] + band[i]) / 1e3
        axes.fill_between(slips, low, high, color=BAND, alpha=0.6, linewidth=0)
        axes.plot(slips, before[i] / 1e3, color=MUTED, linestyle=":", label="before")
        axes.plot(slips, middle[i] / 1e3, color=ESTIMATE, label="identified")
        axes.set_title(f"{name} force [kN]")
        axes.set_xlabel("slip [-]" if "long" in name else "tangent of the slip angle [-]")
        axes.legend()
    return figure


def _convergence(identification: Identification) -> Figure:
    names = identification.information.names
    columns = 5
    figure = _figure(14, 2.1 * (-(-len(names) // columns)))
    panels = np.ravel(figure.subplots(-(-len(names) // columns), columns, squeeze=False))
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    for i, (axes, name) in enumerate(zip(panels, names, strict=False)):
        course = [identification.start[name], *(filter_pass.values[i] for filter_pass in identification.rinsed.passes)]
        axes.plot(range(len(course)), course, "o-", markersize=3, color=ESTIMATE)
        value, deviation = identification.information.values[i], identification.information.deviations[i]
        axes.axhspan(value - deviation, value + deviation, color=BAND, alpha=0.5, linewidth=0)
        axes.axhline(value, color=ESTIMATE, linewidth=0.7)
        unit = unit_of(name)
        axes.set_title(f"{name.replace('_', ' ')} [{unit}]", fontsize=8)
    return figure


def _correlation(identification: Identification) -> Figure:
    names = [name.replace("_", " ") for name in identification.information.names]
    figure = _figure(1.5 + 0.42 * len(names), 1.0 + 0.38 * len(names))
    axes = figure.subplots()
    image = axes.imshow(identification.information.correlation, vmin=-1, vmax=1, cmap="RdBu_r")
    axes.set_xticks(range(len(names)), names, rotation=90)
    axes.set_yticks(range(len(names)), names)
    axes.grid(False)
    figure.colorbar(image, ax=axes, shrink=0.8)
    return figure
