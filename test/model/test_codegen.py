"""Compiled functions: a cache that may always be missing, shared or broken, and never matters for the result."""

from __future__ import annotations

import logging
import os
import stat
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from vsense_ros import cache as cache_module
from vsense_ros import codegen
from vsense_ros.cache import kept, unsafe
from vsense_ros.codegen import compile as _compile
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.car import steps
from vsense_ros.model.car.car import Car

PROGRAM = """
import logging, sys
import casadi as ca
from vsense_ros import cache as cache_module
from vsense_ros import codegen
from vsense_ros.codegen import compile as _compile
logging.basicConfig(level=logging.WARNING)
x = ca.SX.sym("x", 3)
function, = codegen.compiled("probe", [codegen.function("probe", [x], [ca.sin(x) * x], ["x"])])
print(function.is_a("External", False), *(f"{y:.12f}" for y in function([1, 2, 3]).full().ravel()))
"""


def probe(scale: float = 1.0) -> ca.Function:
    x = ca.SX.sym("x", 3)
    return codegen.function("probe", [x], [scale * ca.sin(x) * x], ["x"])


def value(function: ca.Function) -> np.ndarray:
    return np.asarray(function([1.0, 2.0, 3.0]))[:, 0]


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("VSENSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("VSENSE_COMPILE", "1")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(_compile, "_broken", set())
    return tmp_path / "cache"


@pytest.fixture
def compiler(cache: Path) -> str:
    found = codegen.compiler()
    if found is None:
        pytest.skip("needs a C compiler: none of cc, gcc, clang is on the path")
    return found


@pytest.mark.usefixtures("compiler")
def test_a_function_is_compiled_once_and_found_again(cache, monkeypatch):
    (first,) = codegen.compiled("probe", [probe()])
    assert first.is_a("External", False)
    (library,) = cache.glob("probe-*.so")
    made = library.stat().st_mtime_ns
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: pytest.fail("compiled again"))
    (second,) = codegen.compiled("probe", [probe()])
    assert library.stat().st_mtime_ns == made
    assert_allclose(value(first), value(probe()), rtol=1e-14)
    assert_allclose(value(second), value(probe()), rtol=1e-14)


@pytest.mark.usefixtures("compiler", "cache")
def test_source_is_written_only_for_what_the_cache_does_not_have(monkeypatch):
    written = []

    def source() -> str:
        written.append(1)
        return codegen.native_source([probe()])

    for _ in range(2):
        (made,) = codegen.loaded("probe", source, ["probe"], "one") or []
        assert_allclose(value(made), value(probe()), rtol=1e-14)
    assert len(written) == 1
    codegen.loaded("probe", source, ["probe"], "other")
    monkeypatch.setattr(_compile, "_generator", lambda: "a later version, which writes otherwise")
    codegen.loaded("probe", source, ["probe"], "one")
    assert len(written) == 3


@pytest.mark.usefixtures("compiler", "cache")
def test_a_car_that_was_compiled_once_is_there_without_its_equations(monkeypatch):
    vehicle = load_vehicle(vehicle_path("genesis"))
    first = steps.model_functions.__wrapped__(Car(vehicle))
    monkeypatch.setattr(steps, "functions_of", lambda car: pytest.fail("functions are made"))
    second = steps.model_functions.__wrapped__(Car(vehicle))
    assert [*first] == [*second]


def test_cars_with_other_equations_have_other_identities(monkeypatch):
    plain, tables = (load_vehicle(vehicle_path(name)) for name in ("genesis", "prototype_model"))
    heavy = plain.with_parameters({"chassis.mass": 3000.0})
    assert Car(plain).identity == Car(heavy).identity != Car(tables).identity
    before = Car(plain).identity
    monkeypatch.setattr("vsense_ros.model.car.car.digest_of", lambda folder: "other code")
    assert Car(plain).identity != before


@pytest.mark.usefixtures("compiler")
def test_other_expressions_are_other_libraries(cache):
    (one,), (two,) = codegen.compiled("probe", [probe()]), codegen.compiled("probe", [probe(2.0)])
    assert len(list(cache.glob("probe-*.so"))) == 2
    assert_allclose(value(two), 2 * value(one))


@pytest.mark.usefixtures("compiler")
def test_a_function_that_solves_linear_equations_is_compiled_like_any_other():
    a, b = ca.MX.sym("a", 3, 3), ca.MX.sym("b", 3)
    solve = ca.Function("solve", [a, b], [ca.solve(a, b, "qr")], ["a", "b"], ["x"])
    (made,) = codegen.compiled("solve", [solve])
    assert made.is_a("External", False)
    matrix = np.array([[2.0, 1.0, 0.0], [1.0, 3.0, 1.0], [0.0, 1.0, 4.0]])
    assert_allclose(np.asarray(made(matrix, [1.0, 2.0, 3.0]))[:, 0], np.linalg.solve(matrix, [1.0, 2.0, 3.0]))


@pytest.mark.usefixtures("compiler", "cache")
def test_processes_that_build_at_once_all_succeed():
    processes = [
        subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    answers = [process.communicate(timeout=120) for process in processes]
    expected = " ".join(["True", *(f"{y:.12f}" for y in value(probe()))])
    assert [(out.strip(), err) for out, err in answers] == [(expected, "")] * 3


@pytest.mark.usefixtures("cache")
def test_a_broken_compiler_is_reported_once_and_the_virtual_machine_takes_over(monkeypatch, caplog):
    monkeypatch.setenv("CC", "/bin/false")
    with caplog.at_level(logging.WARNING):
        functions = [codegen.compiled("probe", [probe(scale)])[0] for scale in (1.0, 2.0, 3.0)]
    assert not any(function.is_a("External", False) for function in functions)
    assert_allclose(value(functions[2]), 3 * value(probe()))
    (record,) = caplog.records
    assert "compiling probe failed, continuing without compiled code" in record.message


def test_compilation_can_be_switched_off(cache, monkeypatch):
    monkeypatch.setenv("VSENSE_COMPILE", "0")
    (function,) = codegen.compiled("probe", [probe()])
    assert not function.is_a("External", False)
    assert not cache.exists()
    assert_allclose(value(function), value(probe()))


@pytest.mark.usefixtures("compiler")
def test_a_damaged_library_is_reported_and_done_without(cache, caplog):
    codegen.compiled("probe", [probe(4.0)])
    (library,) = cache.glob("probe-*.so")
    library.write_bytes(b"not a library")
    with caplog.at_level(logging.WARNING):
        (function,) = codegen.compiled("probe", [probe(4.0)])
    assert_allclose(value(function), 4 * value(probe()))
    assert "cannot be loaded" in caplog.text


@pytest.mark.usefixtures("compiler")
def test_a_cache_that_cannot_be_written_is_done_without(tmp_path, monkeypatch, caplog):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("VSENSE_CACHE", str(tmp_path / "file" / "cache"))
    (function,) = codegen.compiled("probe", [probe()])
    assert not function.is_a("External", False)
    assert_allclose(value(function), value(probe()))
    assert "continuing without compiled code" in caplog.text


@pytest.mark.usefixtures("compiler")
def test_a_library_that_another_user_could_have_written_is_built_again(cache):
    codegen.compiled("probe", [probe(4.0)])
    (library,) = cache.glob("probe-*.so")
    library.write_bytes(b"planted")
    library.chmod(0o777)
    (function,) = codegen.compiled("probe", [probe(4.0)])
    assert function.is_a("External", False)
    assert_allclose(value(function), 4 * value(probe()))
    assert stat.S_IMODE(library.stat().st_mode) == 0o700


@pytest.mark.parametrize("mode", [0o777, 0o757])
def test_nothing_is_kept_below_a_folder_that_others_can_change(tmp_path, monkeypatch, mode):
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared").chmod(mode)
    monkeypatch.setenv("VSENSE_CACHE", str(tmp_path / "shared" / "cache"))
    with pytest.raises(PermissionError, match=r"shared can be changed by others.*VSENSE_CACHE"):
        kept("probe", ["content"], lambda folder: folder)


def test_a_link_in_the_cache_is_not_followed(cache, tmp_path):
    cache.mkdir(mode=0o700)
    (tmp_path / "elsewhere.so").write_bytes(b"code")
    link = cache / "library.so"
    link.symlink_to(tmp_path / "elsewhere.so")
    assert "is a link" in unsafe(link)


def test_a_kernel_reads_its_arguments_and_writes_its_results_in_place():
    x = ca.SX.sym("x", 2)
    function = codegen.function("f", [x], [ca.vertcat(x[0], 0, x[1]), x @ x.T], ["x"])
    argument = np.array([2.0, 3.0])
    memory = np.zeros(7)
    kernel = codegen.Kernel(function, [argument], memory)
    kernel.call()
    assert_allclose(kernel.results[0][:, 0], [2, 0, 3])
    assert_allclose(kernel.results[1], [[4, 6], [6, 9]])
    argument[:] = 1.0, 5.0
    kernel.call()
    assert_allclose(memory, [1, 0, 5, 1, 5, 5, 25])


def test_a_kernel_refuses_arguments_of_a_wrong_size():
    with pytest.raises(ValueError, match=r"probe: argument 0 \(x\) needs 3 elements, got 2"):
        codegen.Kernel(probe(), [np.zeros(2)])


def test_a_folder_that_another_member_of_a_group_can_change_is_not_safe(tmp_path, monkeypatch):
    import grp
    import pwd

    above, library = tmp_path / "above", tmp_path / "above" / "probe.so"
    above.mkdir()
    library.write_bytes(b"")
    library.chmod(0o700)
    above.chmod(0o775)
    own = os.getuid()
    for uid, said in ((own, ""), (own + 4711, f"{above} can be changed by others")):
        monkeypatch.setattr(grp, "getgrgid", lambda group: SimpleNamespace(gr_mem=["somebody"]))
        monkeypatch.setattr(pwd, "getpwnam", lambda name, uid=uid: SimpleNamespace(pw_uid=uid))
        monkeypatch.setattr(pwd, "getpwall", list)
        cache_module._has_others.cache_clear()
        assert cache_module.unsafe(library) == said
    cache_module._has_others.cache_clear()
