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


def content(found: Identification) -> dict[str, Any]:
    """As JSON."""
    return {
        "model": found.model,
        "vehicle": found.before.name,
        "parameters": {
            name: {
                "before": found.start[name], "value": float(found.found.values[i]),
                "deviation": float(found.found.deviations[i]), "determined": name in found.determined,
            }
            for i, name in enumerate(found.found.names)
        },
        "cornering_stiffness": {
            p.axle: {"value": p.value, "deviation": p.deviation, "determined": p.is_determined, "halves": p.halves}
            for p in found.products
        },
        "refused": {refusal.name: str(refusal) for refusal in found.refused},
        "passes": len(found.rinsed.passes),
        "settled": found.rinsed.settled,
        "fits": found.fits,
        "side_slip_rmse_deg": {name: float(np.degrees(value)) for name, value in found.side_slip.items()},
        "sentences": found.sentences(),
    }  # fmt: skip


def write(found: Identification, folder: Path) -> Path:
    """Write identification.json and report.html into a folder; returns the page."""
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_write(folder / "identification.json") as file:
        file.write(json.dumps(content(found), indent=2) + "\n")
    return write_page(
        folder / "report.html", "vsense_ros.identification", "identification.html.j2",
        title=f"{found.before.name}: parameters identified", found=found, rows=found.rows(),
        degrees={name: f"{np.degrees(value):.3f}" for name, value in found.side_slip.items()},
        pictures=[(title, _encoded(figure)) for title, figure in pictures(found).items()],
    )  # fmt: skip


def pictures(found: Identification) -> Mapping[str, Figure]:
    """By title."""
    with matplotlib.rc_context(dict(STYLE)):
        return {
            "Force curves with one standard deviation": _curves(found),
            "Convergence: parameters by pass": _convergence(found),
            "Correlation of the parameters": _correlation(found),
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


def forces(found: Identification, values: Mapping[str, float]) -> Array:
    """Force curves (4, q) [N]; parameters that the model does not have are those of the file."""
    full = {name: values.get(name, found.start.get(name, PAPER[name])) for name in Best4Dof.parameters}
    return best_4dof.curves(full)


def curve_bands(found: Identification) -> tuple[Array, Array]:
    """Force curves (4, q) and their standard deviations [N], by the slopes along each parameter."""
    names, values = found.found.names, found.found.values
    known = found.start | dict(zip(names, values.tolist(), strict=True))
    middle, slopes = forces(found, known), []
    for i, name in enumerate(names):
        step = _STEP * found.found.prior[i]
        slopes.append((forces(found, known | {name: known[name] + step}) - middle) / step)
    by = np.array(slopes)
    variance = np.einsum("icq,ij,jcq->cq", by, found.found.covariance, by)
    return middle, np.sqrt(np.maximum(variance, 0.0))


def _curves(found: Identification) -> Figure:
    shown = [name for name in REACH if found.model == "best" or "lateral" in name]
    figure = _figure(3.4 * len(shown), 3.2)
    middle, band = curve_bands(found)
    before = forces(found, found.start)
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


def _convergence(found: Identification) -> Figure:
    names = found.found.names
    columns = 5
    figure = _figure(14, 2.1 * (-(-len(names) // columns)))
    panels = np.ravel(figure.subplots(-(-len(names) // columns), columns, squeeze=False))
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    for i, (axes, name) in enumerate(zip(panels, names, strict=False)):
        way = [found.start[name], *(made.values[i] for made in found.rinsed.passes)]
        axes.plot(range(len(way)), way, "o-", markersize=3, color=ESTIMATE)
        value, deviation = found.found.values[i], found.found.deviations[i]
        axes.axhspan(value - deviation, value + deviation, color=BAND, alpha=0.5, linewidth=0)
        axes.axhline(value, color=ESTIMATE, linewidth=0.7)
        unit = unit_of(name)
        axes.set_title(f"{name.replace('_', ' ')} [{unit}]", fontsize=8)
    return figure


def _correlation(found: Identification) -> Figure:
    names = [name.replace("_", " ") for name in found.found.names]
    figure = _figure(1.5 + 0.42 * len(names), 1.0 + 0.38 * len(names))
    axes = figure.subplots()
    image = axes.imshow(found.found.correlation, vmin=-1, vmax=1, cmap="RdBu_r")
    axes.set_xticks(range(len(names)), names, rotation=90)
    axes.set_yticks(range(len(names)), names)
    axes.grid(False)
    figure.colorbar(image, ax=axes, shrink=0.8)
    return figure
