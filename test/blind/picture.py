"""The reliability diagram: how often an effect is there that is stated with a confidence."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure


def reliability(bins: list[dict], file: Path) -> Path:
    """Draw what `score.reliability` has found."""
    figure = Figure(figsize=(5.2, 4.6), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1, label="as stated")
    stated = [each["stated"] for each in bins]
    right = [each["right"] for each in bins]
    middle = [one["value"] for one in right]
    spread = [[m - one["low"] for m, one in zip(middle, right, strict=True)],
              [one["high"] - m for m, one in zip(middle, right, strict=True)]]  # fmt: skip
    axes.errorbar(stated, middle, yerr=spread, fmt="o-", capsize=3, label="found, 95 % (Wilson)")
    for x, y, one in zip(stated, middle, right, strict=True):
        axes.annotate(f"n = {one['n']}", (x, y), textcoords="offset points", xytext=(7, -12), fontsize=8)
    axes.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), xlabel="confidence that is stated", ylabel="share that is there")
    axes.set_title("How reliable a confidence of vsense explain is")
    axes.legend(loc="upper left", frameon=False)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file)
    return file
