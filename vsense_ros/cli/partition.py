"""Which kernels of an observer are worth a device."""

from __future__ import annotations

import click

from vsense_ros.cli.common import load_car


@click.command()
@click.argument("vehicle")
@click.option("--device", required=True, metavar="FILE", help="Device file, or the name of one in config/devices.")
@click.option("--full", is_flag=True, help="Use the observer with all bodies and linkages, in steps of 4 ms.")
@click.option(
    "--iterations", type=click.FloatRange(1, 100), help="Iterations per step; default: measured on a short drive."
)
def partition(vehicle: str, device: str, full: bool, iterations: float | None) -> None:
    """Decide which kernels an accelerator should compute.

    \b
    Examples:
      vsense partition prototype_model --device xc7z020
      vsense partition prototype_model --device xc7z020 --full
      vsense partition prototype_model --device xczu7ev --full
      vsense partition prototype_model --device my_board.yaml --iterations 5

    Predicts the gain from the operations of the observer with implicit steps, the number of iterations and how single
    precision changes it, clock cycles and resources of the kernels, and the cost of the link. If nothing is gained,
    nothing is recommended.
    """
    from vsense_ros.assess import partition as job
    from vsense_ros.evaluate.terminal import console, plain_table, say

    car, board = load_car(vehicle), job.load_device(device)
    iteration_ratio = 1.0
    if iterations is None:
        from vsense_ros.assess.iterations import count_iterations

        iterations, iteration_ratio = count_iterations(car, full)
        changed = f"single precision makes them {iteration_ratio:.3f} times as many"
        effect = "single precision leaves them" if abs(iteration_ratio - 1) < 5e-4 else changed
        say(f"A step takes {iterations:.2f} iterations; {effect}.")
    profile = job.profile(car, full, iterations, iteration_ratio)
    step_us = board.processor_us(profile.flop)
    result = job.partition(board, step_us, profile.uses(), iteration_ratio)
    say(f"A step takes about {step_us:.0f} µs on the processor of {board.name}, by counted operations.")
    table = plain_table("kernel", "calls", "processor saves", "accelerator", "variant", "gain a step", right=("calls",))
    for name, choice in result.best.items():
        use = choice.use
        accelerator_us = 1e6 * board.link.seconds(choice.cycles + board.link.cycles(use.kernel))
        table.add_row(
            name, f"{use.calls:g}", f"{board.processor_us(use.flop):.2f} µs", f"{accelerator_us:.2f} µs",
            choice.variant, f"{choice.gain_us:+.1f} µs",
        )  # fmt: skip
    console().print(table)
    if not full:
        from vsense_ros.assess.covariance_kernel import accelerated

        with_it = accelerated(car, board, iterations)
        say(
            f"The kernel of the covariance ({with_it.lanes} lanes), which no observer uses yet, would take "
            f"{with_it.clocks} clocks a step in {with_it.requests} requests, {with_it.accelerator_us:.0f} µs, for "
            f"{with_it.covariance_us:.0f} µs of the processor: a step of {with_it.step_us:.0f} µs in place of "
            f"{with_it.alone_us:.0f} µs."
        )
    if not result.chosen:
        say("Nothing is recommended: no kernel that fits gains more than its link costs.")
        return
    names = ", ".join(f"{choice.use.kernel.name} ({choice.variant})" for choice in result.chosen)
    resources = ", ".join(
        f"{sum(c.resources[r] for c in result.chosen)} of {getattr(board, r)} {r.upper()}" for r in job.RESOURCES
    )
    say(f"Recommended: {names}. The whole gains {result.gain_us:.0f} µs a step: {result.speed_up:.3f} times as fast.")
    say(f"Needed: {resources}.")


COMMANDS = (partition,)
