"""Whatever the accelerator answers, or does not, the observer has a right result in time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linear_systems import mass_matrices, tables
from marks import exam_except
from vsense_ros.accelerator.client import FIRST_PAUSE, MISSES, Client, Direct
from vsense_ros.accelerator.device import Device
from vsense_ros.accelerator.faults import Faults
from vsense_ros.accelerator.frame import RESPONSE, Frame, FrameError, Status, parse
from vsense_ros.accelerator.kernels import SOLVE_14, SUSPENSION_MOTION
from vsense_ros.accelerator.link import Link
from vsense_ros.errors import InputError

FAULTS = [
    "drop", "delay", "bit_flip", "stuck", "repeat", "wrong_sequence", "wrong_sender", "nan", "silent_error",
    "error_status",
]  # fmt: skip
HOW_COUNTED = {
    "drop": {"missed"},
    "delay": {"missed", "dropped_sequence"},
    "bit_flip": {"dropped_crc", "dropped_magic", "dropped_length", "dropped_version"},
    "stuck": {"implausible"},
    "wrong_sequence": {"dropped_sequence"},
    "wrong_sender": {"dropped_sender"},
    "nan": {"not_finite"},
    "silent_error": {"implausible"},
    "error_status": {"status_fault"},
}


def frame(**changes):
    given = {"kernel": 1, "sequence": 7, "payload": np.arange(5, dtype=np.uint32), "rows": 14, "right_sides": 1}
    return Frame(**given | changes)


def test_a_frame_comes_back_as_it_was_sent():
    sent = frame(flags=RESPONSE, status=Status.PIVOT, stamp=2**60, deadline=5, compute_cycles=335, link_cycles=224)
    found = parse(sent.to_bytes())
    assert np.array_equal(found.payload, sent.payload)
    for name in ("kernel", "sequence", "flags", "status", "stamp", "deadline", "rows", "compute_cycles", "link_cycles"):
        assert getattr(found, name) == getattr(sent, name)


@given(st.integers(0, 8 * 72 - 1))
def test_no_flipped_bit_of_a_frame_goes_unseen(bit):
    data = bytearray(frame().to_bytes())
    data[bit // 8] ^= 1 << bit % 8
    with pytest.raises(FrameError):
        parse(bytes(data))


@given(st.binary(max_size=400))
def test_bytes_from_anywhere_are_a_frame_or_are_refused_by_kind(data):
    with pytest.raises(FrameError) as refusal:
        parse(data)
    assert refusal.value.kind in {"magic", "version", "length", "crc"}


def test_a_frame_in_another_byte_order_is_refused_and_gets_no_answer():
    data = np.frombuffer(frame().to_bytes(), "<u4").byteswap().tobytes()
    with pytest.raises(FrameError) as refusal:
        parse(data)
    assert refusal.value.kind == "magic"
    assert Device().handle(data, 0.0) == []


class OfAnotherByteOrder(Device):
    """Swaps the bytes of the numbers in its answers, under a good checksum."""

    def handle(self, data, now):
        answers = [(answer, parse(answer.data)) for answer in super().handle(data, now)]
        return [replace(a, data=replace(f, payload=f.payload.byteswap()).to_bytes()) for a, f in answers]


def test_numbers_in_another_byte_order_are_not_used():
    client, a, b = Client(Direct(OfAnotherByteOrder())), mass_matrices(1, 5)[0], np.arange(14.0)
    exact = np.linalg.solve(a, b)
    assert np.array_equal(client.solve(a, b, lambda *_: exact), exact)
    assert client.counts["accelerated"] == 0
    assert client.counts["implausible"] + client.counts["not_finite"] == 1


def solved(faults, count=400, seed=0, backend="mock"):
    device = Device(backend, ("solve14",), faults=faults, seed=seed)
    transport = Direct(device)
    client = Client(transport)
    a = mass_matrices(10, 5)
    random = np.random.default_rng(6)
    worst = 0.0
    for i in range(count):
        transport.at(0.004 * i)
        b = random.normal(0, 1000, 14)
        exact = np.linalg.solve(a[i % 10], b)
        found = client.solve(a[i % 10], b)
        scale = 1 / np.sqrt(a[i % 10].diagonal())  # in which the accelerator works
        worst = max(worst, np.abs((found - exact) / scale).max() / np.abs(exact / scale).max())
    return client, device, worst


@pytest.mark.parametrize("fault", exam_except(FAULTS, "bit_flip", "delay", "repeat"))
def test_a_fault_costs_no_accuracy_and_no_deadline_and_is_counted(fault):
    client, device, worst = solved(Faults(**{fault: 0.2}))
    assert worst < 1e-3
    assert client.longest <= client.deadline + 1e-12
    assert device.chance.happened[fault] > 10
    if fault == "repeat":
        assert client.counts["dropped_sequence"] > 10
        assert client.fallbacks == 0
        return
    assert any(client.counts[name] for name in HOW_COUNTED[fault])
    if fault != "silent_error":  # a wrong last bit of a word is within what is plausible
        assert client.fallbacks > 10


def test_without_faults_every_request_is_accelerated_in_the_modelled_time():
    client, _, worst = solved(Faults(), 50)
    assert client.counts["accelerated"] == 50
    assert client.compute_cycles == SOLVE_14.cycles()
    assert client.link_cycles == SOLVE_14.words_in + SOLVE_14.words_out
    link = Link()
    assert client.longest == pytest.approx(1e-6 * (link.setup_us + (335 + 224) / link.clock_mhz))
    assert worst < 1e-5


@pytest.mark.parametrize(("setup_us", "expected"), [(1.0, 5e-4), (500.0, 2 * 505.59e-6), (5000.0, 4e-3)])
def test_a_deadline_is_chosen_by_what_the_first_requests_take_within_a_step(setup_us, expected):
    client = Client(Direct(Device("mock", ("solve14",), link=Link(setup_us=setup_us))), deadline=None)
    matrix, right = mass_matrices(1, 5)[0], np.ones(14)
    for _ in range(2):
        client.solve(matrix, right)
    assert client.deadline == pytest.approx(expected)
    assert client.counts["accelerated"] == (0 if setup_us > 4000 else 2)


def test_a_deadline_is_chosen_once_the_accelerator_has_come():
    device = Device("off", ("solve14",))
    transport = Direct(device)
    client = Client(transport, deadline=None)
    client.solve(np.eye(14), np.ones(14))
    assert (client.counts["missed"], client.deadline) == (1, 4e-3)
    device.backend = "mock"
    client.solve(np.eye(14), np.ones(14))
    assert client.counts["accelerated"] == 1
    assert client.deadline == 5e-4


def test_the_same_seed_gives_the_same_run():
    first, _, _ = solved(Faults(drop=0.1, bit_flip=0.1, delay=0.1), 200, seed=3)
    again, _, _ = solved(Faults(drop=0.1, bit_flip=0.1, delay=0.1), 200, seed=3)
    assert first.counts == again.counts
    assert first.longest == again.longest


def test_an_accelerator_that_does_not_answer_is_left_alone_for_longer_and_longer():
    client, _, worst = solved(Faults(), 2500, backend="off")  # 10 s
    # Three misses, then a probe after 1, 2 and 4 s.
    assert client.counts["missed"] == MISSES + 3
    assert client.counts["left_alone"] == 2500 - MISSES - 3
    assert worst == 0.0


def test_an_accelerator_that_comes_back_is_used_again():
    device = Device("off", ("solve14",))
    transport = Direct(device)
    client = Client(transport)
    for i in range(MISSES):
        transport.at(0.004 * i)
        client.solve(np.eye(14), np.ones(14))
    device.backend = "mock"
    transport.at(1.0 + FIRST_PAUSE)
    client.solve(np.eye(14), np.ones(14))
    assert client.counts["accelerated"] == 1
    assert not client.is_off


def test_two_observers_share_an_accelerator_and_each_takes_its_own_answers():
    device = Device("mock", ("solve14",))
    a = mass_matrices(2, 8)
    clients = []
    for i in range(2):
        transport = Direct(device)
        clients.append((Client(transport, sender=i), transport))
    for k in range(20):
        for i, (client, transport) in enumerate(clients):
            transport.at(0.004 * k)
            b = np.ones(14) * (i + 1)
            assert np.allclose(client.solve(a[i], b), np.linalg.solve(a[i], b), rtol=1e-3, atol=1e-3)
    first, second = (client.counts for client, _ in clients)
    assert first["accelerated"] == 20
    # The second always asks while the first is served.
    assert second["status_busy"] >= MISSES
    assert second["accelerated"] == 0


def test_coefficients_are_sent_before_the_first_request_and_again_to_an_accelerator_that_was_started_anew():
    device = Device("mock", ("suspension_motion",))
    transport = Direct(device)
    client = Client(transport)
    client.set_table("suspension_motion", tables())
    request = np.full(12, 0.1, np.float32).view(np.uint32)
    assert client.request(SUSPENSION_MOTION, request) is not None
    transport.device = Device("mock", ("suspension_motion",))
    transport.at(1.0)
    assert client.request(SUSPENSION_MOTION, request) is None
    assert client.counts["status_fault"] == 1
    assert client.request(SUSPENSION_MOTION, request) is not None


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({"kernel": 99}, Status.UNKNOWN_KERNEL),
        ({"rows": 13}, Status.WRONG_SIZE),
        ({"payload": np.zeros(3, np.uint32)}, Status.WRONG_SIZE),
        ({"version": 2}, Status.BAD_FRAME),
        ({"payload": np.zeros(210, np.uint32)}, Status.PIVOT),
        ({"payload": np.ones(210, np.float32).view(np.uint32), "deadline": 1}, Status.DEADLINE),
    ],
)
def test_a_request_that_is_wrong_is_answered_by_what_is_wrong(changes, status):
    device = Device()
    sent = frame(**{"payload": np.ones(210, np.uint32)} | changes)
    (answer,) = device.handle(sent.to_bytes(), 0.0)
    found = parse(answer.data)
    assert found.status == status
    assert found.sequence == sent.sequence


def test_bytes_that_are_no_request_get_no_answer():
    device = Device()
    assert device.handle(b"", 0.0) == []
    assert device.handle(b"nothing that anybody would understand, and long enough", 0.0) == []
    assert device.handle(frame(flags=RESPONSE).to_bytes(), 0.0) == []


@pytest.mark.parametrize("text", ["drop", "drop: often", "flood: 0.1", "drop: 2", "drop: -0.1", "delay_ms: inf"])
def test_faults_that_are_none_are_refused(text):
    with pytest.raises(InputError, match="faults"):
        Faults.of(text)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1.0])
def test_a_system_that_has_no_scale_is_left_to_the_processor(value):
    matrix = np.eye(14)
    matrix[3, 3] = value
    client = Client(Direct(Device()))
    asked = []
    client.solve(matrix, np.ones(14), lambda a, b: asked.append(a) or b)
    assert len(asked) == 1


def test_the_table_of_faults_has_every_kind_and_none_costs_accuracy_or_time():
    from studies.accelerator import under_faults

    found = under_faults(60, lambda share: None)
    assert set(found) == set(FAULTS)
    for one in found.values():
        assert one.happened > 0
        assert one.worst < 1e-5
        assert one.longest <= 1 + 1e-9
