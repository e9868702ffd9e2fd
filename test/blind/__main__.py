"""`python -m blind`: make the cases, let the tool answer them, compare the answers with the labels.

Needs the folder `test` on PYTHONPATH; `make blind` does all steps of the public split.
"""

from __future__ import annotations

import json
import shutil
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed, wait
from dataclasses import replace
from multiprocessing import Manager
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from blind import cases, evidence, observing, oracle, picture, reading, score, tool, vehicle_file
from blind.effects import EFFECTS
from blind.generate import FINISHED, batches, generate, seconds
from vsense_ros.errors import InputError
from vsense_ros.mismatch import thresholds

SEALS = Path(__file__).with_name("labels.sha256")
CONSOLE = Console()


def _progress() -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=CONSOLE)


@click.group()
@click.option("--out", type=click.Path(path_type=Path), default=Path("out/blind"), show_default=True)
@click.option("--split", type=click.Choice(sorted(cases.SEEDS)), default="public", show_default=True)
@click.option("--cases", "count", type=int, help="Only the first so many: a mixture of all kinds.")
@click.option("--after", type=int, default=0, show_default=True, help="Without the first so many, before that.")
@click.option("--set", "manoeuvres", multiple=True, help="Only cases of these manoeuvre sets.")
@click.option("--kind", "kinds", multiple=True, help="Only cases in which this is hidden: effect, nothing, double, …")
@click.option("--processes", type=int, default=2, show_default=True)
@click.pass_context
def main(
    context: click.Context, out: Path, split: str, count: int | None, after: int, manoeuvres: tuple[str, ...],
    kinds: tuple[str, ...], processes: int,
) -> None:  # fmt: skip
    """The examination of `vsense explain`."""
    every = cases.all_cases(split)
    for option, asked, there in (
        ("--set", manoeuvres, {case.manoeuvres for case in every}), ("--kind", kinds, {case.kind for case in every}),
    ):  # fmt: skip
        if unknown := set(asked) - there:
            raise click.BadParameter(
                f"there is no {', '.join(sorted(unknown))}; there are {', '.join(sorted(there))}", param_hint=option
            )
    chosen = [
        case
        for case in every
        if (not manoeuvres or case.manoeuvres in manoeuvres) and (not kinds or case.kind in kinds)
    ][after:][:count]
    context.obj = {"out": out / split, "split": split, "every": every, "chosen": chosen, "processes": processes}


@main.command()
@click.pass_obj
def make(options: dict) -> None:
    """Simulate the cases and write their recordings; cases that are there are kept."""
    folder, labels = options["out"] / "cases", options["out"] / "labels"
    labels.mkdir(parents=True, exist_ok=True)
    (labels / "labels.json").write_text(cases.labels_text(options["every"]), encoding="utf-8")
    work = [(batch, folder) for batch in batches(_missing(options["chosen"], folder))]
    twins = _twins(options["out"])
    without = [replace(case, hidden=()) for case in options["chosen"] if case.kind == "outside"]
    work += [(batch, twins) for batch in batches(_missing(without, twins))]
    lost = set(_lost(options["out"]))
    with _progress() as progress, Manager() as manager, ProcessPoolExecutor(options["processes"]) as pool:
        bar = progress.add_task("simulated seconds", total=round(sum(seconds(batch) for batch, _ in work)))
        steps = manager.Queue()
        running = {pool.submit(_make, batch, target, steps) for batch, target in work}
        while running:
            done, running = wait(running, timeout=0.3)
            for future in done:
                lost |= set(future.result())
                _lost_file(options["out"]).write_text(json.dumps(sorted(lost)) + "\n", encoding="utf-8")
            while not steps.empty():
                progress.advance(bar, steps.get())
    CONSOLE.print(f"{len(options['chosen'])} cases in {folder}")
    _tell_lost(options)


def _missing(wanted: list[cases.Case], folder: Path) -> list[cases.Case]:
    return [case for case in wanted if not (folder / case.number / FINISHED).exists()]


def _twins(out: Path) -> Path:
    """Folder of the cases with something outside the library, simulated once more without it. They tell that it is
    there, so they lie with the labels."""
    return out / "labels" / "twins"


@main.command()
@click.argument("kinds", nargs=-1, required=True)
@click.option("--to", "target", type=click.Path(path_type=Path), required=True, help="The --out of these cases.")
@click.pass_obj
def untold(options: dict, kinds: tuple[str, ...], target: Path) -> None:
    """Cases for a tool that does not hear sensors of these KINDS, such as wheel_torques: the vehicle file does
    not have them."""
    _check_seal(options)
    source, target = options["out"], target / options["split"]
    left = shutil.ignore_patterns("oracle", "twins")
    shutil.copytree(source / "labels", target / "labels", ignore=left, dirs_exist_ok=True)
    there = [case.number for case in options["chosen"] if (source / "cases" / case.number / FINISHED).exists()]
    for number in there:
        _without_sensors(source / "cases" / number, target / "cases" / number, kinds)
        if (twin := _twins(source) / number).exists():
            _without_sensors(twin, _twins(target) / number, kinds)
    CONSOLE.print(f"{len(there)} cases without {', '.join(kinds)} in {target / 'cases'}")


def _without_sensors(case: Path, quiet: Path, kinds: tuple[str, ...]) -> None:
    quiet.mkdir(parents=True, exist_ok=True)
    try:
        vehicle_file.without_sensors(case / "vehicle.yaml", quiet / "vehicle.yaml", kinds)
    except ValueError as error:
        raise click.ClickException(str(error)) from error
    for name in ("train", "held_out"):
        (quiet / name).unlink(missing_ok=True)
        (quiet / name).symlink_to((case / name).resolve())
    shutil.copy(case / FINISHED, quiet / FINISHED)


def _lost_file(out: Path) -> Path:
    return out / "labels" / "lost_control.json"


def _lost(out: Path) -> list[str]:
    """Numbers of the cases in which the car lost control: they are not scored."""
    file = _lost_file(out)
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else []


def _tell_lost(options: dict) -> None:
    lost = sorted(set(_lost(options["out"])) & {case.number for case in options["chosen"]})
    if lost:
        CONSOLE.print(f"{len(lost)} cases are not scored because the car lost control: {', '.join(lost)}")


def _make(batch: list[cases.Case], folder: Path, steps) -> list[str]:
    passed = 0.0

    def tick(step: float) -> None:
        nonlocal passed
        passed += step
        if passed >= 0.5:
            steps.put(passed)
            passed = 0.0

    return generate(batch, folder, tick)


@main.command()
@click.option("--ablation", type=click.Choice(tool.ABLATIONS), help="The tool with a part left out.")
@click.option("--oracle/--no-oracle", "ask", default=True, help="Also fit the true effect, to know what was possible.")
@click.pass_obj
def run(options: dict, ablation: str | None, ask: bool) -> None:
    """Let the tool answer; answers that are there are kept."""
    _check_seal(options)
    if not tool.can_conceal():
        raise click.ClickException(
            f"labels cannot be concealed from the tool here: `{' '.join(tool.UNSHARE)} true` fails; "
            "run as root or allow user namespaces (on Ubuntu: kernel.apparmor_restrict_unprivileged_userns=0)"
        )
    chosen = options["chosen"]
    _all(options, "answers", _answer, [(case.number, options["out"], ablation) for case in chosen])
    told = [(case.number, options["out"], _truth(case)) for case in chosen if _truth(case)]
    if ask and not ablation:
        _all(options, "true effects", _ask_oracle, told)
        twins = _twins(options["out"])
        there = [case.number for case in chosen if (twins / case.number / FINISHED).exists()]
        _all(options, "nothing instead", _ask_without, [(number, options["out"]) for number in there])


def _all(options: dict, title: str, job, arguments: list[tuple]) -> None:
    with _progress() as progress, ProcessPoolExecutor(options["processes"]) as pool:
        bar = progress.add_task(title, total=len(arguments))
        for future in as_completed([pool.submit(job, *each) for each in arguments]):
            future.result()
            progress.advance(bar)


def _answer(number: str, out: Path, ablation: str | None) -> None:
    words = ("--ablation", ablation) if ablation else ()
    tool.explain(out / "cases" / number, out / _answers(ablation) / number, *words, hidden=out / "labels")


def _ask_oracle(number: str, out: Path, truth: list[str]) -> None:
    """Its reports tell what is hidden, so they lie with the labels."""
    oracle.ask(out / "cases" / number, _oracle(out, number), truth)


def _ask_without(number: str, out: Path) -> None:
    oracle.ask_without(_twins(out) / number, _oracle(out, number))


@main.command()
@click.pass_obj
def observe(options: dict) -> None:
    """Run the observer on held-out recordings with what the answers have named; what is there is kept."""
    _check_seal(options)
    named = [
        (case.number, options["out"])
        for case in options["chosen"]
        if (options["out"] / "answers" / case.number / observing.EXTENDED).exists()
    ]
    _all(options, "observers", _observe, named)


def _observe(number: str, out: Path) -> None:
    observing.observe(out / "cases" / number, out / "answers" / number)


@main.command()
@click.pass_obj
def alone(options: dict) -> None:
    """What the tool says of every recording by itself, nothing held out: how often each verdict, and what explains most
    of what is there, over its duration. With `--kind nothing` that is chance."""
    _check_seal(options)
    jobs = []
    for case in options["chosen"]:
        if (finished := options["out"] / "cases" / case.number / FINISHED).exists():
            jobs += [(case.number, name, options["out"]) for name in json.loads(finished.read_text())["train"]]
    _all(options, "recordings", _answer_alone, jobs)
    found = {f"{number}, {name}": tool.earlier(_alone(out, number, name)).explain for number, name, out in jobs}
    verdicts = Counter(answer.verdict for answer in found.values() if answer)
    CONSOLE.print(", ".join(f"{count} {verdict}" for verdict, count in verdicts.most_common()))
    most = sorted(((reading.explained_seconds(answer), name) for name, answer in found.items() if answer), reverse=True)
    for (explained, id), name in most[:5]:
        CONSOLE.print(f"{explained:.2f} s explained by {id}: {name}")


def _alone(out: Path, number: str, name: str) -> Path:
    return out / "alone" / number / Path(name).name


def _answer_alone(number: str, name: str, out: Path) -> None:
    case, part = out / "cases" / number, _alone(out, number, name)
    if tool.earlier(part) is None:
        folder = part.with_name(f"{part.name}.case")
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copy(case / "vehicle.yaml", folder)
        told = {"train": [str((case / name).resolve())], "held_out": []}
        (folder / FINISHED).write_text(json.dumps(told), encoding="utf-8")
        tool.explain(folder, part, hidden=out / "labels")


def _oracle(out: Path, number: str) -> Path:
    return out / "labels" / "oracle" / number


def _truth(case: cases.Case) -> list[str]:
    return [name for name, _ in case.hidden if name in EFFECTS]


def _answers(ablation: str | None) -> str:
    return f"answers_{ablation}" if ablation else "answers"


@main.command(name="score")
@click.option("--json", "target", type=click.Path(path_type=Path), default=Path("out/blind.json"), show_default=True)
@click.option("--of", "commit", default="", help="Commit of the tool that answered, to stand beside the scores.")
@click.option("--note", default="", help="What else to know of these scores, to stand beside them.")
@click.pass_obj
def score_command(options: dict, target: Path, commit: str, note: str) -> None:
    """Compare the answers that are there with the labels; print the tables, write the figures."""
    _check_seal(options)
    results = _results(options, None)
    if not results:
        raise click.ClickException(f"no answers in {options['out'] / 'answers'}; `python -m blind run` gives them")
    sets = score.all_sets(results)
    figures = sets | {
        "split": options["split"],
        "seed": cases.SEEDS[options["split"]],
        "commit": commit,
        "note": note,
        "ablations": {"shuffled_labels": score.all_sets(score.shuffled(results))},
        "confusion": score.confusion(results),
        "reliability": score.reliability(results),
        "brier": score.brier(results),
    }
    for ablation in tool.ABLATIONS:
        if found := _results(options, ablation):
            figures["ablations"][ablation] = score.all_sets(found)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    for name, scores in sets.items():
        _print(name, scores, {ablation: other.get(name, {}) for ablation, other in figures["ablations"].items()})
    _print_confusion(figures["confusion"])
    _print_reliability(figures["reliability"])
    CONSOLE.print(f"Brier score {figures['brier']:.3f}")
    drawing = picture.reliability(figures["reliability"], target.with_name(f"{target.stem}_reliability.svg"))
    CONSOLE.print(f"Written to {target} and {drawing}.")
    _tell_lost(options)


def _results(options: dict, ablation: str | None) -> list[score.Result]:
    labels = json.loads((options["out"] / "labels" / "labels.json").read_text(encoding="utf-8"))
    results = []
    lost = _lost(options["out"])
    for case in options["chosen"]:
        if case.number in lost:
            continue
        answer = tool.earlier(options["out"] / _answers(ablation) / case.number)
        if answer:
            report = _oracle(options["out"], case.number)
            truth = _truth(case)
            best = oracle.best(report, truth) if truth else oracle.best_without(answer, report)
            seen = observing.observed(options["out"] / _answers(ablation) / case.number)
            results.append(score.Result(labels[case.number], answer, best, seen))
    return results


def _print(name: str, scores: dict, ablations: dict[str, dict]) -> None:
    table = Table("score", "value", "95 %", "n", *ablations, title=name)
    for key, found in scores.items():
        interval = f"{found['low']:.2f} … {found['high']:.2f}" if "low" in found and found["n"] else ""
        others = [_shown(other.get(key, {}).get("value")) for other in ablations.values()]
        table.add_row(key, _shown(found["value"]), interval, str(found["n"]), *others)
    CONSOLE.print(table)


def _shown(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}" if abs(value) < 10 else f"{value:.0f}"


def _print_confusion(table: dict[str, dict[str, int]]) -> None:
    shown = Table("hidden", "said", title="what was said")
    for truth, said in table.items():
        shown.add_row(truth, ", ".join(f"{name} {count}" for name, count in said.items()))
    CONSOLE.print(shown)


def _print_reliability(bins: list[dict]) -> None:
    table = Table("confidence", "stated", "there", "95 %", "n", title="how reliable a confidence is")
    for each in bins:
        right = each["right"]
        table.add_row(
            f"{each['from']:.2f} … {each['to']:.2f}", _shown(each["stated"]), _shown(right["value"]),
            f"{right['low']:.2f} … {right['high']:.2f}", str(right["n"]),
        )  # fmt: skip
    CONSOLE.print(table)


def _table_of(curve: evidence.Curve) -> Table:
    """What a number was chosen by."""
    table = Table(curve.name, curve.criterion, title=curve.source)
    for value, criterion in zip(curve.values, curve.found, strict=True):
        table.add_row(f"{value:g}" + (" *" if value == curve.best else ""), f"{criterion:.3f}")
    return table


def _check_seal(options: dict) -> None:
    known = dict(line.split()[::-1] for line in SEALS.read_text(encoding="utf-8").splitlines() if line)
    found = cases.seal(cases.labels_text(options["every"]))
    stored = options["out"] / "labels" / "labels.json"
    if known.get(options["split"]) != found:
        raise click.ClickException(f"the labels of the split {options['split']} are not those of {SEALS.name}")
    if not stored.exists() or cases.seal(stored.read_text(encoding="utf-8")) != found:
        raise click.ClickException(f"{stored} is missing or changed; `python -m blind make` writes it")


@main.command()
@click.option(
    "--to", "file", type=click.Path(exists=True, dir_okay=False, path_type=Path), default=thresholds.FILE,
    help="The thresholds of the tool; default: those of the package.",
)  # fmt: skip
@click.pass_obj
def calibrate(options: dict, file: Path) -> None:
    """Fit the confidence of the tool to its answers, and write it into its thresholds: how often a name is right, by
    the lead of its gain, and how often an effect is there that was refused. Tell how far off its sizes are, too."""
    _check_seal(options)
    results = _results(options, None)
    leads, right, stated = score.leads(results)
    if not stated.any():
        raise click.ClickException("no answer has a name to calibrate with; `python -m blind run` gives answers")
    curves = evidence.curves(results, options["split"])
    found = {**score.calibrated(leads, right, stated, options["split"]), **evidence.found(curves)}
    thresholds.write(found, file)
    for name, (value, source) in found.items():
        CONSOLE.print(f"{name} {value:g}: {source}")
    CONSOLE.print(f"written to {file}")
    for curve in curves:
        CONSOLE.print(_table_of(curve))
    errors = score.relative_errors(results)
    if len(errors):
        half, most = np.quantile(errors, [0.5, 0.9])
        held = [one for r in results if r.kind == "effect" and r.detectable for one in score.intervals_hold(r)]
        CONSOLE.print(f"of {len(errors)} sizes half are within {half:.1%}, nine in ten within {most:.1%}")
        CONSOLE.print(f"of {len(held)} intervals of 90 % {np.mean(held):.0%} hold")


@main.command()
def seal() -> None:
    """Print the SHA-256 of the labels of every split, as it stands in labels.sha256."""
    for split in sorted(cases.SEEDS):
        click.echo(f"{cases.seal(cases.labels_text(cases.all_cases(split)))} {split}")


@main.command()
def sizes() -> None:
    """Print what size 1 of every effect is."""
    table = Table("effect", "parameter", "size 1", "unit", "shows best in")
    for name, effect in EFFECTS.items():
        table.add_row(name, effect.parameter, f"{effect.nominal:g}", effect.unit, effect.best)
    CONSOLE.print(table)


if __name__ == "__main__":
    try:
        main(prog_name="python -m blind")
    except InputError as error:
        raise SystemExit(f"Error: {error}") from None
