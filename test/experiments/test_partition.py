"""Which kernels are worth a device."""

from pathlib import Path

import pytest

from vsense_ros.accelerator.kernels import KERNELS
from vsense_ros.errors import InputError
from vsense_ros.experiments.partition import RESOURCES, load_device, partition, uses
from vsense_ros.files.vehicle import load_vehicle

ROOT = Path(__file__).parents[2]
VEHICLE = load_vehicle(ROOT / "config/vehicles/prototype_model.yaml")


def test_nothing_is_recommended_for_a_processor_alone():
    device = load_device("none").model_copy(update={"setup_us": 0.0})
    assert partition(device, 1000.0, uses(VEHICLE)).chosen == ()


def test_the_link_that_ate_the_thesis_s_mass_matrix_eats_ours():
    found = partition(load_device("xc7z020"), 1000.0, uses(VEHICLE))
    assert found.best["body_mass"].gain_us < 0
    assert all(choice.use.kernel.name != "body_mass" for choice in found.chosen)


def test_without_a_cost_of_transfers_what_is_chosen_gains_and_fits():
    device = load_device("xc7z020").model_copy(update={"setup_us": 0.0, "stream_bits": 128})
    found = partition(device, 1000.0, uses(VEHICLE))
    assert found.chosen
    assert found.speed_up > 1
    for resource in RESOURCES:
        assert sum(choice.resources[resource] for choice in found.chosen) <= getattr(device, resource)
    slower = partition(device, 1000.0, uses(VEHICLE), more_iterations=1.85)
    assert slower.gain_us < found.gain_us


def test_all_kernels_together_fit_the_thesis_s_device():
    from vsense_ros.experiments.partition import recorded_resources

    known, device = recorded_resources(), load_device("xc7z020")
    for resource in RESOURCES:
        total = 0
        for name, kernel in KERNELS.items():
            (variant,) = (v for v, p in kernel.variants.items() if kernel.parameters | p == kernel.parameters)
            total += known[f"{name}/{variant}"][resource]
        assert total <= getattr(device, resource), resource


@pytest.mark.parametrize("text", ["dsp: many", "name: x\nflops: 3", "[", "name: x\ndsp: -1"])
def test_a_file_that_is_no_device_is_refused_by_key(tmp_path, text):
    path = tmp_path / "device.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"device\.yaml"):
        load_device(str(path))


def test_a_device_that_nobody_knows_is_refused_with_those_that_are():
    with pytest.raises(InputError, match="xc7z020"):
        load_device("virtex")
