"""Which accuracy sensors give: `vsense design`."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.assess import sensor_design as job
from vsense_ros.assess.drives import Errors, drive_plant
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.manoeuvre.receivers import RECEIVERS

MANOEUVRE = "right_turn"


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return tmp_path_factory.mktemp("plants")


@pytest.fixture(scope="module")
def truth(store):
    return drive_plant(MANOEUVRE, "jaguar_saloon", store)


@pytest.mark.exam
def test_what_noise_and_model_leave_makes_up_the_error_of_a_filter(truth):
    slip = job.expect("dual_kkf", job.Plan(MANOEUVRE, Errors()), truth, 10).side_slip
    assert slip.rmse**2 == pytest.approx(slip.noise**2 + slip.model**2, rel=0.15)


@pytest.mark.exam
def test_the_heading_is_as_well_known_as_the_filter_states_and_twenty_draws_of_the_noise_show(truth):
    heading = job.expect("yaw_kkf", job.Plan(MANOEUVRE, Errors()), truth, 20).heading
    assert heading.stated == pytest.approx(heading.rmse, rel=0.2)


@pytest.mark.exam
def test_a_better_receiver_and_two_antennas_help_the_kinematic_filter(truth):
    plan = job.Plan(MANOEUVRE, Errors())
    survey = replace(plan, errors=job.with_receiver(plan.errors, "survey", 1.0))
    poor = replace(plan, errors=job.with_receiver(plan.errors, "mapping", 1.0))
    both = replace(plan, errors=job.with_antennas(survey.errors, 1.0))
    error = {
        name: job.expect(filter, one, truth, 3).side_slip.rmse
        for name, filter, one in (
            ("poor", "dual_kkf", poor), ("survey", "dual_kkf", survey), ("both", "dual_kkf_heading", both)
        )
    }  # fmt: skip
    assert error["both"] < 1.2 * error["survey"] < error["poor"]


def test_fixes_that_come_late_and_an_outage_are_in_the_budget(truth):
    plan = job.Plan(MANOEUVRE, Errors())
    now, late = job.budget(plan, truth), job.budget(replace(plan, latency=0.2), truth)
    assert late.total > now.total
    assert late.parts["fixes late"] == pytest.approx(np.degrees(0.2 * now.slip_rate))
    out = job.budget(replace(plan, outage=(20.0, 30.0)), truth)
    assert out.parts["held between fixes"] == pytest.approx(10 * now.parts["held between fixes"])


@given(
    sizes=st.lists(st.floats(0.01, 1.0), min_size=30, max_size=30),
    wanted=st.floats(0.01, 1.0),
)
def test_of_what_is_enough_the_cheapest_are_named(sizes, wanted):
    every = [(r, rate, g) for r in job.BY_PRICE for rate in job.RATES for g in job.GRADES]
    found = [job.Choice(*one, size) for one, size in zip(every, sizes, strict=True)]
    named = job.cheapest(found, wanted)
    assert all(one.side_slip <= wanted for one in named)
    assert bool(named) == any(size <= wanted for size in sizes)
    order = {one: i for i, one in enumerate(job.BY_PRICE)}, {one: i for i, one in enumerate(job.GRADES)}

    def cost(one):
        return order[0][one.receiver], one.rate, order[1][one.grade]

    for one in found:
        if one.side_slip <= wanted:
            assert any(all(a <= b for a, b in zip(cost(other), cost(one), strict=True)) for other in named)


def test_all_receivers_have_their_place_by_price():
    assert sorted(job.BY_PRICE) == sorted(RECEIVERS)


@pytest.mark.parametrize(
    ("plan", "names", "told"),
    [
        (job.Plan("no_such", Errors()), ("dual_kkf",), "no manoeuvre"),
        (job.Plan(MANOEUVRE, Errors()), ("error_ekf",), "no filter"),
        (job.Plan(MANOEUVRE, Errors(), outage=(30.0, 20.0)), ("dual_kkf",), "outage"),
    ],
)
def test_what_cannot_be_is_said(plan, names, told, store):
    with pytest.raises(InputError, match=told):
        job.design(plan, names, store)


@pytest.mark.exam
def test_the_command_writes_a_picture_and_figures_and_names_what_to_buy(tmp_path, monkeypatch):
    monkeypatch.setattr(job, "RATES", (1.0,))
    out = tmp_path / "design"
    options = [MANOEUVRE, "--filter", "dual_kkf", "--filter", "yaw_kkf", "--side-slip", "1", "--seeds", "1"]
    result = CliRunner().invoke(main, ["design", *options, "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "Enough for 1°" in result.output
    assert out.with_suffix(".png").stat().st_size > 20_000
    found = json.loads(out.with_suffix(".json").read_text())
    assert len(found["choices"]) == 15
    assert found["filters_deg"]["yaw_kkf"]["side_slip"] is None
    assert found["enough"]
