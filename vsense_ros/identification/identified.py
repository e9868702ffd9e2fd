"""What an identification of a handling model came to: values, standard deviations, and what is not determined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.text import Text

from vsense_ros.evaluate.printable import Printable
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.identification.information import Information, Refusal
from vsense_ros.identification.prediction import Comparison
from vsense_ros.identification.rinsing import Drive, Rinsed
from vsense_ros.model.handling import best_4dof
from vsense_ros.model.vehicle import Vehicle

ADVICE = {
    "yaw_inertia": "steer quickly, as in a lane change or a sine of 1 Hz",
    "stiffness": "drive bends with more than 2 m/s² of lateral acceleration",
    "peak": "drive bends up to where the car slides, as on a proving ground",
    "shape": "drive bends beyond the largest lateral force",
    "curvature": "drive bends up to the largest lateral force and beyond",
    "longitudinal_ratio": "accelerate and brake hard, straight ahead",
    "relaxation_length": "steer quickly, slow and fast",
    "roll_gradient": "drive long bends, on a road without bank",
    "roll": "change from left to right quickly, as in a slalom",
    "cog_height": "change from left to right quickly, and brake hard",
}


UNITS = {
    "height": "m", "inertia": "kg m²", "roll_stiffness": "N m/rad", "roll_damping": "N m s/rad", "stiffness": "N/rad",
    "offset": "rad", "delay": "s", "length": "m", "gradient": "rad s²/m",
    "weight": "N", "wheelbase": "m", "half_track": "m", "radius": "m", "lag": "s",
}  # fmt: skip


@dataclass(frozen=True)
class Product:
    """The cornering stiffness of an axle's tyre, D C_α [N/rad], often determined where its factors are not. `halves`
    has it by the first and by the second half of the drives, each with its standard deviation."""

    axle: str
    value: float
    deviation: float
    halves: tuple[tuple[float, float], tuple[float, float]]
    is_determined: bool

    @property
    def apart(self) -> float:
        """How many standard deviations the halves differ by."""
        (a, s), (b, t) = self.halves
        return abs(a - b) / float(np.hypot(s, t))


@dataclass(frozen=True, repr=False)
class Identification(Printable):
    """What came out. `information` is about the free parameters of the model, then the errors of the sensors."""

    model: str
    before: Vehicle
    vehicle: Vehicle
    start: dict[str, float]
    free: tuple[str, ...]
    information: Information
    rinsed: Rinsed
    refused: tuple[Refusal, ...]
    products: tuple[Product, ...]
    drives: tuple[Drive, ...]
    fits: dict[
        str, dict[str, tuple[float, float]]
    ]  # by recording and output: 1 - RMS/σ of the model alone, before, after
    side_slip: dict[str, float]  # RMSE of the model alone [rad], of recordings with a reference
    held_out: tuple[str, ...]
    verdict: Comparison | None = None  # of the observer's prediction with both files, None where it was not judged

    @property
    def is_kept(self) -> bool:
        """True if the vehicle stays as it was, because the observer predicts worse with the identified parameters."""
        return self.verdict is not None and self.verdict.is_worse

    @property
    def title(self) -> str:
        """Name of the vehicle, the model, and how many of its parameters are refused."""
        return f"{self.vehicle.name}, {self.model}, {len(self.refused)} of {len(self.free)} parameters refused"

    def show(self, out: Console) -> None:
        """Print the identified values with their standard deviations, and what could not be determined."""
        table = plain_table("parameter", "before", "estimate", "±", "unit", "", right=("before", "estimate", "±"))
        for row in self.rows():
            table.add_row(*(Text(cell, style="dim" if row[-1] == "refused" else "") for cell in row))
        out.print(table)
        out.print(f"{len(self.rinsed.passes)} passes. ± is one standard deviation, of prior and drives together.")
        table = plain_table("model alone, 1 - error/σ", "before", "after", right=("before", "after"))
        for name, outputs in self.fits.items():
            mark = " (held out)" if name in self.held_out else ""
            for output, (before, after) in outputs.items():
                table.add_row(f"{name}{mark}: {output.replace('_', ' ')}", f"{before:.3f}", f"{after:.3f}")
        out.print(table)
        for name, error in self.side_slip.items():
            mark = " (held out)" if name in self.held_out else ""
            out.print(f"{name}{mark}: side slip of the model alone, RMSE {np.degrees(error):.3f}°.")
        for sentence in self.sentences():
            out.print(Text(sentence))

    def rows(self) -> list[tuple[str, str, str, str, str, str]]:
        """Rows for the free parameters and the errors of the sensors: name, before, after, standard deviation, unit,
        verdict."""
        refused = {refusal.name: refusal for refusal in self.refused}
        rows = []
        for name, value, deviation in zip(
            self.information.names, self.information.values, self.information.deviations, strict=True
        ):
            verdict = "refused" if name in refused else "determined" if name in self.free else "sensor"
            rows.append((name, f"{self.start[name]:.4g}", f"{value:.4g}", f"{deviation:.2g}", unit_of(name), verdict))
        for product in self.products:
            before = self.start[f"{product.axle}_stiffness"] * self.start[f"{product.axle}_peak"]
            verdict = "determined" if product.is_determined else "refused"
            name = f"{product.axle} cornering stiffness, D C_α"
            rows.append((name, f"{before:.4g}", f"{product.value:.4g}", f"{product.deviation:.2g}", "N/rad", verdict))
        return rows

    @property
    def values(self) -> dict[str, float]:
        """All parameters of the model: those that are determined as identified, the rest as in the file."""
        identified = self.start | dict(zip(self.information.names, self.information.values.tolist(), strict=True))
        replaced = {refusal.name: self.start[refusal.name] for refusal in self.refused}
        for product in self.products:
            if product.is_determined:
                replaced[f"{product.axle}_stiffness"] = product.value / (identified | replaced)[f"{product.axle}_peak"]
        return identified | replaced

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of the parameters that the drives determine."""
        refused = {refusal.name for refusal in self.refused}
        products = [f"{product.axle}_stiffness" for product in self.products if product.is_determined]
        return tuple(dict.fromkeys([*(name for name in self.free if name not in refused), *products]))

    @property
    def file_deviations(self) -> dict[str, float]:
        """Standard deviations of the numbers of the vehicle file that are identified, by dotted path. The cornering
        stiffness and the largest force of an axle stand in its tyre, so those of its scales are relative [-]."""
        deviation_by_name = {
            name: self.information.deviations[self.information.names.index(name)] for name in self.free
        }
        by_path = {
            f"physics.chassis.{name}": float(deviation_by_name[name])
            for name in ("cog_height", "yaw_inertia")
            if name in self.determined
        }
        for product in self.products:
            if product.is_determined:
                by_path[f"physics.{product.axle}.cornering_scale"] = product.deviation / product.value
            if (peak := f"{product.axle}_peak") in self.determined:
                by_path[f"physics.{product.axle}.grip_scale"] = float(deviation_by_name[peak]) / self.values[peak]
        return by_path

    def sentences(self) -> list[str]:
        """Parameters that are not determined, why, and what would help; those that can hardly be separated."""
        by_product = {f"{product.axle}_stiffness": product for product in self.products if product.is_determined}
        lines = [] if self.verdict is None else [self.verdict.sentence]
        if self.is_kept:
            lines.append(
                "The observer predicts worse with the identified parameters than with those of the vehicle file, which "
                "therefore keeps its values. The model may miss what these drives do, or sensors err."
            )
        for refusal in self.refused:
            outcome, alone = f"It stays {self.start[refusal.name]:.4g}", ""
            if (product := by_product.get(refusal.name)) is not None:
                alone = " alone"
                outcome = (
                    f"It gets the value with which its product with {product.axle}_peak, the cornering stiffness of a "
                    f"{product.axle} tyre, is as the drives determine it: {product.value:.4g} ± "
                    f"{product.deviation:.2g} N/rad"
                )
            lines.append(f"{refusal}. {outcome}. To determine it{alone}, {advice(refusal.name)}.")
        weakest = self.information.weakest(
            best_4dof.JUDGED_BY_CURVE + tuple(n for n in self.information.names if n not in self.free)
        )
        lines.append(f"The combination of parameters that is determined least, relative to each alone, is {weakest}.")
        lines += [
            f"{first} and {second} are hard to separate (correlation {correlation:+.2f})."
            for first, second, correlation in self.information.pairs()
            if first in self.free and second in self.free
        ]
        if not self.rinsed.settled:
            lines.append(
                f"After {len(self.rinsed.passes)} passes the curves still moved by "
                f"{100 * self.rinsed.passes[-1].moved:.2g} % of their peak: the combination that is determined "
                "least has not settled."
            )
        for product in self.products:
            if product.apart > 3.0:
                lines.append(
                    f"The two halves of the drives differ in the cornering stiffness of the {product.axle} tyres by "
                    f"{product.apart:.1f} standard deviations: tyres, load or road may have changed."
                )
        return lines


def advice(name: str) -> str:
    """Driving that would determine a parameter."""
    return next((words for key, words in ADVICE.items() if key in name), "drive with more steering and braking")


def unit_of(name: str) -> str:
    """Unit of a parameter of a handling model."""
    return next((unit for key, unit in UNITS.items() if key in name), "-")
