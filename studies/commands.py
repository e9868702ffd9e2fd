"""The commands `python -m studies NAME`: one for each paper's tables or examination."""

from __future__ import annotations

from pathlib import Path

import click

from studies.healthy import healthy
from studies.leung_command import leung
from studies.literature.command import literature
from vsense_ros.cli.common import NEW_FILE, NEW_FOLDER, Commands, load_car, warn


class StudyCommands(Commands):
    """Group of the studies' commands."""

    program = "studies"


@click.group(cls=StudyCommands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
def main() -> None:
    """Tables of the papers that the project follows, and examinations of the observers by its authors."""


main.add_command(healthy)
main.add_command(leung)
main.add_command(literature)


@main.command()
@click.option("--out", type=NEW_FILE, default=Path("out/genesis.json"), show_default=True, help="File.")
@click.option("--vehicle", metavar="FILE", default="genesis", show_default=True, help="Vehicle file, or its name.")
@click.option("--identify", metavar="FILE", type=NEW_FILE, help="Identify the car instead, and write FILE.")
@click.option("--start", metavar="FILE", default="genesis_start", show_default=True, help="Where that search begins.")
@click.option(
    "--reference", metavar="FILE", help="Vehicle file from which to take place and mounting of the reference."
)
def genesis(out: Path, vehicle: str, identify: Path | None, start: str, reference: str | None) -> None:
    """Examine the observer on the third Genesis lap, or identify the car from the two others.

    Identification takes a quarter of an hour and gives the same values every time. It does not look at the third lap,
    so that nothing is chosen by what comes out there.

    \b
    Examples:
      python -m studies genesis
      python -m studies genesis --identify out/genesis.yaml
      python -m studies genesis --vehicle out/genesis.yaml
      python -m studies genesis --vehicle genesis_start --reference genesis_identified
    """
    from studies import genesis as job
    from studies import genesis_tables as tables
    from vsense_ros.demo import dataset
    from vsense_ros.evaluate.terminal import console, progress, say
    from vsense_ros.files.vehicle import save_vehicle
    from vsense_ros.model.vehicle import left_out_of_observer

    folder = dataset("genesis_oxts_can")
    folder = folder if folder.is_dir() else folder.parent
    if identify is None:
        car = load_car(vehicle)
        warn(left_out_of_observer(car))
        if reference is not None:
            car = car.model_copy(update={"reference": load_car(reference).reference})
        with progress("estimating the third lap") as done:
            found = job.examine(folder, car, done)
        job.write_results(found.figures(), out)
        tables.show_examination(found, console())
        return
    if reference is not None:
        raise click.UsageError("--identify finds place and mounting of the reference itself")
    before = load_car(start)
    warn(left_out_of_observer(before))
    with progress("identifying from the slow and the fast lap") as done:
        fit = job.identify(before, job.identification_laps(folder), done)
    identify.parent.mkdir(parents=True, exist_ok=True)
    save_vehicle(identify, fit.vehicle)
    tables.show_identification(before, fit, console())
    say(f"Written to {identify}.")


@main.command()
@click.option("--out", type=NEW_FILE, default=Path("out/thesis.json"), show_default=True, help="File.")
@click.option("--causes", is_flag=True, help="Instead, why the errorEKF leaves its place.")
def thesis(out: Path, causes: bool) -> None:
    """Repeat the tables of Rodríguez 2020: a full car of 600 kg, observers that believe in 700 kg and more grip.

    \b
    Examples:
      python -m studies thesis
      python -m studies thesis --causes
    """
    from studies import thesis as job
    from studies import thesis_causes
    from vsense_ros.evaluate.terminal import console, progress

    plant, model = (load_car(name) for name in ("prototype_real", "prototype_model"))
    if causes:
        thesis_causes.show(thesis_causes.causes(plant, model), console())
        return
    with progress("driving and estimating") as done:
        results = job.repeat(plant, model, progress=done)
    job.write(results, out)
    job.show(results, console())


@main.command()
@click.option(
    "--vehicle", default="prototype_real", show_default=True, metavar="FILE", help="With linkages and tables."
)
@click.option("--out", type=NEW_FOLDER, default=Path("docs"), show_default=True, help="Folder.")
def simplification(vehicle: str, out: Path) -> None:
    """Compare the simplified car with the one that has all its bodies, on each generated manoeuvre.

    Writes simplification.md with tables and pictures: on suspension tables, and on straight guides.

    \b
    Examples:
      python -m studies simplification
      python -m studies simplification --vehicle my_car_with_tables.yaml --out out
    """
    from studies import simplification as job
    from vsense_ros.evaluate.terminal import progress

    car = load_car(vehicle)
    if ids := [effect.id for effect in car.physics.effects.present()]:
        warn(f"the comparison leaves out {', '.join(ids)} (physics.effects), which the full car cannot have")
    with progress("driving") as done:
        document = job.write(car, out, done)
    click.echo(document)


@main.command()
@click.option(
    "--vehicle", metavar="FILE", default="prototype_model", show_default=True, help="Vehicle file, or its name."
)
@click.option("--out", type=NEW_FOLDER, default=Path("out/sampling"), show_default=True, help="Folder.")
def sampling(vehicle: str, out: Path) -> None:
    """Compare a continuous filter with discrete ones where sensors are slow.

    Takes some minutes. Writes sampling_rates.json and sampling_rates.png.

    \b
    Examples:
      python -m studies sampling
      python -m studies sampling --vehicle rav4 --out out/rav4
    """
    from studies import sampling_rates as job
    from vsense_ros.evaluate.terminal import console, progress, say

    car = load_car(vehicle)
    with progress("filters at several rates") as done:
        results = job.measure(car, done)
    out.mkdir(parents=True, exist_ok=True)
    job.write(results, out / "sampling_rates.json")
    picture = job.draw(results, out / "sampling_rates.png")
    console().print(job.table(results))
    say(f"Picture in {picture}.")


@main.command("moving-horizon")
@click.option("--out", type=NEW_FILE, default=Path("out/moving_horizon.json"), show_default=True, help="File.")
@click.option("--seconds", type=click.FloatRange(1.0), default=6.0, show_default=True, help="Length of the drive.")
def moving_horizon(out: Path, seconds: float) -> None:
    """Compare a moving-horizon estimator with the extended Kalman filter, on the model of Best & Bogdanski 2016.

    \b
    Examples:
      python -m studies moving-horizon
      python -m studies moving-horizon --seconds 20
    """
    from studies import moving_horizon as job
    from vsense_ros.evaluate.terminal import console, progress, say

    with progress("estimating") as done:
        rows = job.compare(job.Study(seconds=seconds), done)
    job.write(rows, out)
    console().print(job.table(rows))
    say(f"Written to {out}.")


@main.command()
@click.option("--out", type=NEW_FILE, default=Path("out/road.json"), show_default=True, help="File.")
@click.option(
    "--extended", type=click.Path(path_type=Path), default=Path("docs/examples/genesis/vehicle.extended.yaml"),
    show_default=True, help="What `vsense explain` wrote of the Genesis.",
)  # fmt: skip
def road(out: Path, extended: Path) -> None:
    """Examine forces and attitudes on roads that are not flat.

    The RAV4's drive against Newton's law and the recorded pose, the Genesis's third lap with typical values and with
    what explain found on the two others, and the car with all its bodies on generated hills and banks. Takes some
    minutes.

    \b
    Examples:
      python -m studies road
      python -m studies road --out /tmp/road.json
    """
    from studies import road as job
    from studies.coverage import coverage_table
    from vsense_ros.errors import InputError
    from vsense_ros.evaluate.terminal import console, progress, say

    rav4, genesis = None, None
    try:
        with progress("the RAV4's drive") as done:
            rav4 = job.rav4(done)
    except InputError as error:
        say(f"Without the RAV4's drive: {error}")
    try:
        with progress("the Genesis's third lap") as done:
            genesis = job.on_genesis(extended, done)
    except InputError as error:
        say(f"Without the Genesis: {error}")
    with progress("hills and banks") as done:
        plants = job.on_plants(done)
    results = job.Results(plants, rav4, genesis)
    job.write(results, out)
    console().print(job.table(results))
    console().print(coverage_table({name: one.compared for name, one in results.drives().items()}))
    say(f"Written to {out}.")


@main.command()
@click.option("--out", type=NEW_FILE, default=Path("out/best.json"), show_default=True, help="File.")
@click.option("--study", is_flag=True, help="Instead: many starts, everyday drives and twins.")
def best(out: Path, study: bool) -> None:
    """Repeat Best & Bogdanski 2016 on a twin: a car identified from its CAN bus by Kalman filters.

    Takes some two minutes. Prints table 1 beside what was found, writes it as JSON and the figures as PNG beside it.
    With --study, half an hour: how often the identification ends in a wrong minimum, beside plain least squares, and
    how often 90 % intervals hold: of everyday drives, and of a hundred twins at their limits. What was stopped goes on
    where it was.

    \b
    Examples:
      python -m studies best
      python -m studies best --study --out out/best_study.json
    """
    from studies import best as job
    from studies import best_intervals, best_picture, best_study
    from vsense_ros.evaluate.terminal import console, progress, say

    if study:
        store = out.with_name("best_twins")
        with progress("identifying from many starts and drives") as done:
            outcome = best_study.study(store, progress=done)
        with progress("identifying twins") as done:
            intervals = best_intervals.intervals(store, progress=done)
        best_study.write(best_study.content(outcome) | {"limits": best_intervals.content(intervals)}, out)
        best_study.show(outcome, console())
        best_intervals.show(intervals, console())
        return
    with progress("driving and identifying") as done:
        results = job.repeat(progress=done)
    job.write(results, out)
    job.show(results, console())
    pictures = best_picture.draw(results, out.with_suffix(""))
    say(f"Written to {out}; figures 1 to {len(pictures)} in {out.with_suffix('')}.")


@main.command()
@click.option("--filter", "filters", multiple=True, metavar="NAME", help="Only this filter; may be given again.")
@click.option("--quick", is_flag=True, help="Of the ten simulated manoeuvres four.")
@click.option("--processes", type=click.IntRange(1), metavar="N", help="Default: as many as there are cores.")
@click.option("--out", type=NEW_FILE, default=Path("out/consistency.json"), show_default=True, help="File.")
def consistency(filters: tuple[str, ...], quick: bool, processes: int | None, out: Path) -> None:
    """Compare errors of GNSS/INS filters with the standard deviations that they state.

    Prints and writes for each filter and output the share of errors within three standard deviations, and the mean
    square of errors over them (NEES), on the drives of `leung` and on recordings of real cars.

    \b
    Examples:
      python -m studies consistency --quick
      python -m studies consistency --filter strapdown --filter inertial
    """
    from studies import navigation_consistency as job
    from vsense_ros.evaluate.terminal import console, progress, say
    from vsense_ros.navigation.catalogue import FILTERS, RECOMMENDED

    for name in filters:
        FILTERS[name]
    with progress("driving and estimating") as done:
        results, failed = job.by_drive(
            out.parent / "leung", out.with_suffix(""), filters or tuple(RECOMMENDED), done,
            quick=quick, processes=processes,
        )  # fmt: skip
    job.write(results, out)
    job.show(results, console())
    for title, error in failed.items():
        say(f"{title} failed: {error}")
    if missing := job.left_out(results):
        say(f"Left out, as they are not here or lack sensors: {', '.join(missing)} (VSENSE_DATA names their folder).")
    say(f"Written to {out}.")
    if failed:
        raise SystemExit(1)


@main.command()
@click.option("--bags", type=click.Path(path_type=Path), default=Path("bags"), show_default=True, help="Folder.")
@click.option("--only", multiple=True, metavar="TEXT", help="Drives with TEXT in their titles, faults, filters.")
@click.option("--quick", is_flag=True, help="Three drives alone.")
@click.option("--processes", type=click.IntRange(1), metavar="N", help="Default: as many as there are cores.")
@click.option("--out", type=NEW_FILE, default=Path("out/truth.json"), show_default=True, help="File.")
def truth(bags: Path, only: tuple[str, ...], quick: bool, processes: int | None, out: Path) -> None:
    """Hold what is published against what it says of itself, on all drives that have a reference.

    Coverage of standard deviations by drive and output, tyre forces, faults, GNSS/INS filters, and lags of sensors.
    Takes more than an hour beside other work. A part of it leaves in the file what that has of others. Each part that
    is done is kept in a folder beside FILE, so that what was stopped goes on where it was; a part that fails is listed
    at the end, beside the figures of the others.

    \b
    Examples:
      python -m studies truth
      python -m studies truth --quick
      python -m studies truth --only banked_oval --only med_lap
    """
    from studies import truth as job
    from vsense_ros.evaluate.terminal import console, progress, say

    only += job.QUICK if quick else ()
    with progress("driving and estimating") as done:
        results = job.examine(out.parent / "leung", out.with_suffix(""), bags, done, only=only, processes=processes)
    job.write(results, out, keep=bool(only))
    job.show(results, console())
    say(f"Written to {out}.")
    if results.failed:
        raise SystemExit(1)


@main.command()
@click.option("--sample", default=1040, show_default=True, type=click.IntRange(1), help="Rows, of some 6,000.")
@click.option("--seed", default=46, show_default=True, help="Of the choice of the rows.")
@click.option("--only", metavar="WORDS", default="", help="Only rows whose name contains these words.")
@click.option("--processes", type=click.IntRange(1), metavar="N", help="Default: as many as there are cores.")
@click.option("--out", type=NEW_FILE, default=Path("out/truth.json"), show_default=True, help="File.")
def faults(sample: int, seed: int, only: str, processes: int | None, out: Path) -> None:
    """Let every part of every sensor fail in every way: rows of the systematic table of faults.

    A part of a sensor × a kind of fault × 0.3, 1, 5 s or for good × on a straight, in a bend, at standstill, from the
    start × drives: generated, of the RAV4, of the Genesis. Writes the rows to a part of the file that `truth` writes,
    prints the worst and the shares for which each requirement holds, and ends with 1 where one is missed. A row takes
    three seconds of a core; what was stopped goes on where it was.

    \b
    Examples:
      python -m studies faults
      python -m studies faults --sample 150 --seed 7
      python -m studies faults --only "steering ×0.5"
    """
    from studies import fault_outcomes as job
    from studies.fault_rows import rows, some_rows
    from vsense_ros.errors import InputError
    from vsense_ros.evaluate.terminal import console, progress, say

    chosen = some_rows(sample, seed, only)
    if not chosen:
        raise InputError(f"expected words of a row such as {rows()[0].name!r}, found {only!r}, which none has")
    with progress("faults") as done:
        outcomes = job.examine_rows(chosen, out, done, processes=processes)
    console().print(job.table(outcomes))
    if left_out := len(chosen) - len(outcomes):
        say(f"{left_out} rows left out: they failed, or their recordings are not here.")
    say(f"Written to {out}.")
    if missed := job.missed(outcomes):
        say(f"Missed: {'; '.join(missed)}.")
        raise SystemExit(1)


@main.command()
@click.argument("recordings", nargs=-1, type=click.Path(path_type=Path))
@click.option("--vehicle", metavar="FILE", default="prototype_model", show_default=True, help="Where searches begin.")
@click.option("--out", type=NEW_FILE, default=Path("out/limit.json"), show_default=True, help="File.")
def limit(recordings: tuple[Path, ...], vehicle: str, out: Path) -> None:
    """Compare the side slip of observers and of simpler ways on drives to the limit of the tyres.

    Each is identified on other drives than it is compared on. Without RECORDINGS drives of the full car on other tyres
    are made, which takes minutes once; they are kept beside FILE. RECORDINGS are those of one real car, with a
    reference; one that is not there is left out.

    \b
    Examples:
      python -m studies limit
      python -m studies limit niki/Low_Speed niki/High_Speed --vehicle niki.yaml --out out/limit_niki.json
    """
    from studies import limit as job
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.evaluate.terminal import console, progress, say

    there = [path for path in recordings if path.exists()]
    for path in recordings:
        if path not in there:
            say(f"Left out, as it is not here: {path}.")
    if recordings and len(there) < 2:
        say("Nothing is compared: it takes two recordings, to identify on others than are estimated.")
        return
    with progress("driving, identifying and estimating") as done:
        drives = [import_recording(path) for path in there] if there else job.generated(out.with_suffix(""))
        results = job.compare_all(drives, load_car(vehicle), done)
    job.write(results, out)
    job.show(results, console())
    say(f"Written to {out}.")


@main.command()
@click.option("--out", type=NEW_FOLDER, default=Path("bags"), show_default=True, help="Folder.")
def bags(out: Path) -> None:
    """Generate the manoeuvre bags of the repository again, bit by bit.

    \b
    Examples:
      python -m studies bags
      python -m studies bags --out /tmp/bags && diff -r bags /tmp/bags
    """
    from studies.bags import plant, write_bags
    from vsense_ros.evaluate.terminal import progress
    from vsense_ros.manoeuvre import IN_BAGS

    written: list[Path] = []
    with progress("generating") as done:
        for path in write_bags(out, plant()):
            written.append(path)
            done(len(written) / len(IN_BAGS))
    for path in written:
        size = sum(file.stat().st_size for file in path.iterdir()) / 1e6
        click.echo(f"{path} {size:.2f} MB")


@main.command()
@click.option("--systems", default=10_000, show_default=True, type=click.IntRange(1), help="Of each kernel, for bits.")
@click.option("--requests", default=100_000, show_default=True, type=click.IntRange(1), help="Under each fault.")
@click.option("--short", is_flag=True, help="Of the implementation table the lines of 4 ms and 1e-5, drives of 1.2 s.")
@click.option("--table", "only_table", is_flag=True, help="The implementation table alone.")
@click.option("--out", type=NEW_FILE, default=Path("out/accelerator.json"), show_default=True, help="File.")
@click.option("--vehicle", default="prototype_model", show_default=True, help="Vehicle file with suspension tables.")
def accelerator(systems: int, requests: int, short: bool, only_table: bool, out: Path, vehicle: str) -> None:
    """Kernels of the accelerator: bits, clocks, resources, latency through ROS, iterations beside the thesis's.

    Simulates the hardware with Verilator, if it is there. Resources are those of the last `make hw`, clocks on ECP5
    those of the last `make hw-timing`; instructions on ARM those of the last `make arm`, if there was one.

    \b
    Examples:
      python -m studies accelerator
      python -m studies accelerator --systems 500 --requests 1000 --short
      python -m studies accelerator --table --short
    """
    from studies import accelerator as job
    from studies import accelerator_tables as tables
    from vsense_ros.accelerator.rtl import missing
    from vsense_ros.evaluate.terminal import console, progress, say

    if only_table:
        content, rows = job.implementation_table(load_car(vehicle), short, progress)
        tables.show_implementation(rows, content["shares"], short)
    else:
        if lacking := missing():
            say(f"Left out for want of {', '.join(lacking)} (make hw-tools): bits of the hardware, the node with rtl.")
        content, rows = job.results(load_car(vehicle), systems, requests, short, progress)
        tables.show(content, rows, short, console())
    job.write(content, out)
    say(f"Written to {out}.")


@main.command("can-survey")
@click.option("--databases", type=click.Path(path_type=Path), required=True, help="The folder opendbc/dbc of opendbc.")
@click.option("--out", type=NEW_FILE, default=Path("out/can_survey.json"), show_default=True, help="File.")
def can_survey(databases: Path, out: Path) -> None:
    """Examine `vsense can` on twenty cars of opendbc, whose logs are made from their databases.

    The databases are not part of this project: clone github.com/commaai/opendbc.

    \b
    Examples:
      python -m studies can-survey --databases opendbc/opendbc/dbc
    """
    from studies import can_survey as job
    from vsense_ros.evaluate.terminal import say

    job.run(databases, out)
    say(f"Written to {out}.")


@main.command("own-car")
@click.option("--out", type=NEW_FILE, default=Path("out/own_car.json"), show_default=True, help="File.")
@click.option("--car", "only", multiple=True, metavar="NAME", help="One of the cars; repeatable; default: all.")
@click.option(
    "--plant", type=click.Choice(["newton_euler", "mujoco_tree"]),
    help="Plant of all simulated cars; default: two by MuJoCo, three by the other, which takes twenty minutes once.",
)  # fmt: skip
@click.option("--keep", type=click.Path(file_okay=False, path_type=Path), help="Folder in which all files stay.")
@click.option(
    "--databases", type=click.Path(path_type=Path), default=Path("opendbc/opendbc/dbc"), show_default=True,
    help="The folder opendbc/dbc of a clone of opendbc; without it there are no figures of `vsense can`.",
)  # fmt: skip
def own_car(out: Path, only: tuple[str, ...], plant: str | None, keep: Path | None, databases: Path) -> None:
    """A newcomer's way with cars that are not ours: catalogue values, import of foreign logs, check, calibration,
    identification, estimate on a held-out drive.

    \b
    Examples:
      python -m studies own-car
      python -m studies own-car --car hatchback --car Genesis
    """
    from studies import own_car as job
    from studies import own_car_checks as checks
    from vsense_ros.evaluate.terminal import console, plain_table, say

    parts = {"check": checks.planted()}
    if databases.is_dir():
        parts["can"] = checks.buses(databases)
    outcomes, stopped = {}, []
    table = plain_table("car", "", "side slip [°]", "within 2σ", "yaw rate [°/s]", "Fz [%]", "minutes")
    for car in job.cars(only, plant):
        try:
            outcomes[car.name] = one = job.newcomer(car, keep)
        except RuntimeError as error:
            say(f"{car.name}: the way ended with {error}")
            stopped.append(car.name)
            continue
        rows = (("catalogue", one.before), ("calibrated", one.by_calibration), ("identified", one.after))
        for words, row in rows:
            cells = ["–" if value is None else f"{value:.3g}" for value in row.values()]
            table.add_row(car.name, words, *cells, f"{one.minutes:.1f}")
        job.write(outcomes, out, parts)
    console().print(table)
    say(
        f"check: {parts['check']['found']} of {parts['check']['of']} planted mistakes, {parts['check']['false']} false."
    )
    if "can" in parts:
        say(f"can: all signals of {parts['can']['found']} of {parts['can']['of']} cars.")
    say(f"Written to {out}.")
    if stopped:
        say(f"The way ended early for {', '.join(stopped)}.")
        raise SystemExit(1)
