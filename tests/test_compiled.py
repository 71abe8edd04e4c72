"""Compiled functions: the same numbers, nothing compiled twice, and the interpreter whenever something is wrong."""

import os
import shutil
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import click
import numpy as np
import platformdirs
import pytest
from click.testing import CliRunner
from conftest import quick_compiler
from platformdirs.macos import MacOS
from platformdirs.unix import Unix

import orbitfinder as of
from orbitfinder._runtime import locks
from orbitfinder._runtime.caches import Kept
from orbitfinder.cli.options import compile_option
from orbitfinder.errors import InputError
from orbitfinder.integrate import compiled as rooms
from orbitfinder.integrate.compiled import (
    Unavailable,
    available,
    compiled,
    compiling,
    expected_seconds,
    find_compiler,
    flags,
    make_library,
    mode,
    set_mode,
    statistics,
    with_derivatives,
)
from orbitfinder.integrate.cvodes import IntegratorSettings, build_flow
from orbitfinder.integrate.lanes.kernel import kernel
from orbitfinder.integrate.rk8 import march, marcher
from orbitfinder.mechanics.model import vector_field
from orbitfinder.mechanisms.chain import chain

pytestmark = pytest.mark.skipif(not available()[0], reason="no C compiler: " + available()[1])


@pytest.fixture(autouse=True)
def fresh(tmp_path, monkeypatch):
    """An empty cache, mode auto, the compiler that users have and no memory of earlier tests."""
    monkeypatch.setenv("ORBITFINDER_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("ORBITFINDER_COMPILE", raising=False)
    if quick_compiler():
        monkeypatch.delenv("CC")
    forget(monkeypatch)
    monkeypatch.setattr(rooms, "_chosen", [])
    return tmp_path / "cache" / "compiled"


def example(factor: float | None = None) -> ca.Function:
    """A function in C; without a factor there is no number in it (CasADi 3.6 writes 2 as one)."""
    x = ca.SX.sym("x", 3)
    y = ca.sin(x) if factor is None else ca.sin(x) * factor
    return ca.Function("example", [x], [y + x[0] / x[1], ca.dot(x, x)], ["x"], ["y", "z"])


def forget(monkeypatch) -> None:
    """As if the process had just started."""
    for name, value in (("_known", Kept(32)), ("_libraries", Kept(32)), ("_statistics", rooms.Statistics())):
        monkeypatch.setattr(rooms, name, value)


def fake_compiler(folder: Path, monkeypatch, body: str) -> Path:
    """A $CC that answers --version and then does `body`."""
    path = folder / "fake-cc"
    path.write_text(f'#!/bin/sh\nif [ "$1" = --version ]; then echo fake 1.0; exit 0; fi\n{body}\n')
    path.chmod(0o755)
    monkeypatch.setenv("CC", str(path))
    return path


def stays_interpreted(function: ca.Function, **how) -> str:
    """The reason why `compiled` handed back the function itself."""
    assert compiled(function, **how) is function
    assert np.isfinite(function([0.1, 0.2, 0.3])[0].full()).all()
    return statistics().reason


# ---- the same numbers ------------------------------------------------------------------------------


def test_numbers_are_the_interpreted_ones():
    """Bit for bit on the equations of motion, since nothing may be contracted or reordered."""
    field = build_flow(chain(3)).field
    fast = compiled(field)
    assert fast is not field and fast.class_name() == "External"
    random = np.random.default_rng(1)
    for state in random.uniform(-2, 2, (20, 6)):
        np.testing.assert_allclose(fast(0, state, [], []).full(), field(0, state, [], []).full(), rtol=4e-16)


def test_a_whole_march_compiles(fresh):
    """400 eighth-order steps in one C function end where the interpreted ones do."""
    field = build_flow(chain(2)).field
    whole = marcher(field, 400)
    fast = compiled(whole)
    state, steps = np.array([0.3, -0.2, 0.1, 0.5]), np.full((1, 400), 1.7 / 400)
    end = fast(np.concatenate([[0.0], state]), steps).full()[1:, -1]
    assert fast is not whole
    np.testing.assert_allclose(end, march(field, state, 1.7, 400, np.zeros(0))[-1], rtol=1e-13, atol=1e-14)


@pytest.mark.skipif(not quick_compiler(), reason="needs a compiler of the usual names")
def test_optimising_changes_no_bit(monkeypatch):
    """The other tests compile without: their numbers are those of users."""
    field, state, ends = build_flow(chain(3)).field, np.array([0.3, -0.2, 0.4, 0.1, 0.5, -0.6]), []
    for compiler in (None, quick_compiler()):
        if compiler:
            monkeypatch.setenv("CC", compiler)
        forget(monkeypatch)
        whole = compiled(marcher(field, 400))
        ends.append(whole(np.concatenate([[0.0], state]), np.full((1, 400), 1.7 / 400)).full())
        assert statistics().made == 1 and compiler == os.environ.get("CC")
    assert np.isfinite(ends[0]).all() and ends[0].tobytes() == ends[1].tobytes()


def test_names_and_sparsity_are_kept():
    x = ca.SX.sym("x", 3)
    sparse = ca.Function("sparse", [x], [ca.diag(x), ca.SX(2, 2)], ["x"], ["d", "nothing"])
    fast = compiled(sparse)
    assert fast is not sparse
    assert fast.name_in() == ["x"] and fast.name_out() == ["d", "nothing"]
    assert fast.sparsity_out(0) == sparse.sparsity_out(0) and fast.nnz_out(1) == 0


def test_inside_an_integrator():
    """CVODES with the compiled right-hand side ends where it does with the interpreted one."""
    field = build_flow(chain(2)).field
    x, ends = ca.MX.sym("x", 4), []
    for one in (field, with_derivatives(field)):
        problem = {"x": x, "ode": one(0, x, ca.DM(0, 1), ca.DM(0, 1))}
        solver = ca.integrator("ends", "cvodes", problem, 0, 1.0, IntegratorSettings().options())
        ends.append(solver(x0=[0.3, -0.2, 0.1, 0.5])["xf"].full())
    assert statistics().made == 1
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-13)


def test_with_derivatives_differentiates_like_the_original():
    function = example()
    fast, point = with_derivatives(function), [0.3, 0.7, -0.4]
    assert fast is not function
    np.testing.assert_allclose(fast.jacobian()(point, 0, 0)[0].full(), function.jacobian()(point, 0, 0)[0].full())
    with compiling("off"):
        assert with_derivatives(function) is function


def test_what_is_compiled_already_is_not_compiled_into_something_else():
    """No linker joins the two libraries: it calls itself without end by CasADi 3.6.7, or ends the process."""
    code = (
        "import casadi as ca; from orbitfinder.integrate.compiled import compiled, statistics, with_derivatives\n"
        "x = ca.MX.sym('x'); f = ca.Function('f', [x], [ca.sin(x)])\n"
        "inner = compiled(f); same, other = with_derivatives(f), ca.Function('g', [x], [2 * inner(x)])\n"
        "print(inner.class_name() == 'External', *(compiled(one) is one for one in (inner, same, other)), other(0.5))\n"
        "print(statistics().reason)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert ran.stdout.splitlines() == ["True True True True 0.958851", "g: its code needs another library"]


# ---- nothing twice ---------------------------------------------------------------------------------


def test_second_run_compiles_nothing(monkeypatch):
    compiled(example())
    assert (statistics().made, statistics().loaded) == (1, 0)
    compiled(example())
    assert statistics().made == 1  # the same equations, built again
    forget(monkeypatch)
    monkeypatch.setattr(rooms, "make_library", None)
    assert compiled(example()) is not None and (statistics().made, statistics().loaded) == (0, 1)


def scaled(factor: float) -> ca.Function:
    """Numbers in the text, in a table and in a vector of equal ones."""
    x = ca.MX.sym("x", 3)
    table = ca.DM([[1.5, 0, 2], [0, -3.25, 4], [1, 1, 1]]) * factor
    return ca.Function("scaled", [x], [table @ x + factor * ca.sin(x) - ca.MX(ca.DM([factor / 7] * 3))])


def attractor(rho: float) -> ca.Function:
    return vector_field(of.systems.lorenz(rho=rho))


@pytest.mark.parametrize("make", [scaled, attractor])
def test_other_numbers_need_no_other_library(make, monkeypatch, fresh):
    """All at once, each as the interpreter has it, in whatever order; nothing stays behind but the entry."""
    point, values = np.array([0.3, 0.7, -0.4]), (2.5, -1.25, 0.3, 28.0)

    def asked(function: ca.Function) -> Callable[[], ca.DM]:
        if make is attractor:
            fast = kernel(function, None, alone=True)
            return lambda: fast.rates(np.zeros(1), point[None], np.zeros((1, 0))).T
        quick = compiled(function)
        return lambda: quick.call([point])[0]

    for order in (values, values[::-1]):
        fast = {value: asked(make(value)) for value in order}
        for value, call in fast.items():
            given = [0.0, point, [], []] if make is attractor else [point]
            np.testing.assert_array_equal(call(), make(value).call(given)[0])
        assert statistics().made == (order is values) and not statistics().left
        assert len(list(fresh.glob("*.so"))) == 1 and not list(fresh.glob("making-*"))
        forget(monkeypatch)


def test_second_process_compiles_nothing(fresh):
    code = (
        "import casadi as ca; from orbitfinder.integrate.compiled import compiled, statistics; x = ca.SX.sym('x');"
        "f = compiled(ca.Function('f', [x], [ca.sin(x)])); print(f(0.5), statistics().made, statistics().loaded)"
    )
    said = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True) for _ in range(2)]
    assert [one.stdout.split()[1:] for one in said] == [["1", "0"], ["0", "1"]]
    assert said[0].stdout.split()[0] == said[1].stdout.split()[0] and not said[0].stderr + said[1].stderr


def test_two_processes_at_once_compile_once(fresh, tmp_path):
    """Three processes start together: the first makes the library, the others wait and load it."""
    code = (
        "import casadi as ca, sys, time, os; from orbitfinder.integrate.compiled import compiled, statistics\n"
        "x = ca.SX.sym('x', 40)\ny = x\n"
        "for k in range(60): y = ca.sin(y) + ca.vertcat(y[1:], y[0]) / (2 + k)\n"
        "f = ca.Function('f', [x], [y])\n"
        f"while not os.path.exists({str(tmp_path / 'go')!r}): time.sleep(0.005)\n"
        "f = compiled(f); print(statistics().made, statistics().loaded, f.class_name() == 'External')"
    )
    crowd = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(3)]
    time.sleep(1.0)
    (tmp_path / "go").touch()
    said = sorted(one.communicate(timeout=120)[0].split() for one in crowd)
    assert said == [["0", "1", "True"]] * 2 + [["1", "0", "True"]]
    assert len(list(fresh.glob("*.so"))) == 1 and not list(fresh.glob("making-*"))


def test_lock_that_is_never_released(fresh, monkeypatch):
    """Another process that hangs while holding the lock costs patience, not correctness."""
    fcntl = pytest.importorskip("fcntl")
    rooms.usable()
    monkeypatch.setattr(rooms, "expected_seconds", lambda size: -0.99)  # patience of 0.1 s
    with monkeypatch.context() as patched:
        handles = [(fresh / f"lock-{k:02x}").open("w") for k in range(256)]
        for handle in handles:
            fcntl.flock(handle, fcntl.LOCK_EX)
        patched.setattr(locks, "PATIENCE", 0.01)
        assert "another process" in stays_interpreted(example())
        for handle in handles:
            handle.close()


def test_key_depends_on_everything(monkeypatch, fresh):
    """Other code, another compiler, other flags: another entry."""
    compiled(example())
    compiled(example(3.0))
    assert len(list(fresh.glob("*.so"))) == 2
    forget(monkeypatch)
    monkeypatch.setattr(rooms, "flags", lambda size, tuning: ("-O0", *rooms.ALWAYS))
    compiled(example())
    forget(monkeypatch)
    other = rooms.find_compiler
    monkeypatch.setattr(rooms, "find_compiler", lambda: type(other())(other().command, "another version"))
    compiled(example())
    assert len(list(fresh.glob("*.so"))) == 4
    assert rooms.key_of("ab", "c") != rooms.key_of("a", "bc")


# ---- when something is wrong -----------------------------------------------------------------------


def test_a_compiler_that_has_begun_is_waited_for(monkeypatch, fresh):
    """A library that was begun is made by that compiler and compared as any other; what nobody asks for goes."""
    for factor in (None, 3.0):
        rooms.begin(lambda factor=factor: rooms.casadi_code(example(factor)), None)
    assert len(list(fresh.glob("making-*"))) == 2
    monkeypatch.setattr(rooms, "_compiling", None)  # no other compiler is started
    before = statistics().made
    assert compiled(example()).class_name() == "External" and statistics().made == before + 1
    rooms._abandoned()
    assert len(list(fresh.glob("*.so"))) == 1 and not list(fresh.glob("making-*"))


def test_a_compiler_that_another_process_has_overtaken_is_ended(monkeypatch, fresh):
    """Both begin with the same library: whose is ready first is loaded by the other, which leaves nothing behind."""
    rooms.begin(lambda: rooms.casadi_code(example()), None)
    mine, *rest = rooms._begun.items()
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr(rooms, "_begun", {})
        assert compiled(example()).class_name() == "External"
    forget(monkeypatch)
    assert compiled(example()).class_name() == "External" and statistics().loaded == 1
    assert not rest and not rooms._begun and mine[1][0].poll() is not None
    assert len(list(fresh.glob("*.so"))) == 1 and not list(fresh.glob("making-*"))


def test_missing_compiler(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler-here")
    assert "not on the path" in stays_interpreted(example())
    assert available() == (False, "no C compiler: no-such-compiler-here is not on the path")


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("echo internal error; exit 1", "exit code 1: internal error"),
        ("exit 0", "wrote nothing"),
        ('while [ "$1" != -o ]; do shift; done; echo rubbish > "$2"', "cannot be loaded"),
    ],
)
def test_broken_compiler(tmp_path, monkeypatch, fresh, body, reason, capfd):
    """It fails, it does nothing, it writes rubbish: interpreted, silently, and no entry or litter remains."""
    fake_compiler(tmp_path, monkeypatch, body)
    function = example()
    assert reason in stays_interpreted(function)
    assert statistics().left == 1 and compiled(function) is function and statistics().left == 1  # not tried again
    assert not list(fresh.glob("*.so")) and not list(fresh.glob("making-*"))
    assert capfd.readouterr() == ("", "")


def test_compiler_that_cannot_say_its_version(tmp_path, monkeypatch):
    path = tmp_path / "mute-cc"
    path.write_text("#!/bin/sh\nexit 3\n")
    path.chmod(0o755)
    monkeypatch.setenv("CC", str(path))
    assert "exit code 3" in stays_interpreted(example())


def test_compiler_that_hangs(tmp_path, monkeypatch, fresh):
    """It is ended with its children after the time-out."""
    hangs = f"echo $$ > {tmp_path}/pid; sleep 60 & echo $! > {tmp_path}/child; wait"
    fake_compiler(tmp_path, monkeypatch, f"[ $2 = -dM ] && exit 1; {hangs}")
    monkeypatch.setattr("orbitfinder.integrate.compiled.TIMEOUT", 0.5)
    assert "took longer than 0.5 s" in stays_interpreted(example())
    for name in ("pid", "child"):
        process = Path(f"/proc/{(tmp_path / name).read_text().strip()}/stat")
        assert not process.exists() or process.read_text().split()[2] == "Z"
    assert not list(fresh.glob("making-*"))


def test_compiler_that_compiles_something_else(tmp_path, monkeypatch, fresh):
    """A library whose numbers differ is thrown away."""
    wrong = example(2.5)
    generator = ca.CodeGenerator("code.c")
    generator.add(wrong)
    (tmp_path / "wrong.c").write_text(generator.dump())
    real = find_compiler().command[0]
    fake_compiler(
        tmp_path, monkeypatch,
        f'while [ "$1" != -o ]; do shift; done; {real} -shared -fPIC {tmp_path}/wrong.c -o "$2" -lm',
    )  # fmt: skip
    assert "disagrees" in stays_interpreted(example())
    assert not list(fresh.glob("*.so"))


def test_unwritable_cache(tmp_path, monkeypatch):
    """A file stands where the cache should be."""
    (tmp_path / "blocked").write_text("")
    monkeypatch.setenv("ORBITFINDER_CACHE", str(tmp_path / "blocked"))
    assert stays_interpreted(example())


@pytest.mark.parametrize("damage", ["truncated", "altered", "empty"])
def test_damaged_entry_is_made_again(monkeypatch, fresh, damage):
    """Recognised by its digest before it is loaded; loading a truncated library can end the process."""
    compiled(example())
    (entry,) = fresh.glob("*.so")
    whole = entry.read_bytes()
    entry.unlink()  # another inode: this process has the old one mapped
    entry.write_bytes({"truncated": whole[: len(whole) // 3], "altered": whole[:-1] + b"?", "empty": b""}[damage])
    entry.chmod(0o700)
    forget(monkeypatch)
    assert compiled(example()).class_name() == "External"
    assert (statistics().made, statistics().loaded) == (1, 0)
    assert [path.read_bytes() for path in fresh.glob("*.so")] == [whole]


def test_entry_with_the_right_digest_and_the_wrong_content(monkeypatch, fresh):
    """A sound file that is no library, or one of another function, is replaced too."""
    compiled(example(2.5))
    (entry,) = fresh.glob("*.so")
    other = make_library(find_compiler(), "int f;", fresh)  # which takes no numbers
    contents = (b"rubbish", other.read_bytes())
    for path in (entry, other):
        path.unlink()
    wrong = [fresh / f"{entry.stem.partition('-')[0]}-{rooms.digest(content)}.so" for content in contents]
    for path, content in zip(wrong, contents, strict=True):
        path.write_bytes(content)
        path.chmod(0o700)
    forget(monkeypatch)
    assert compiled(example(2.5)).class_name() == "External" and statistics().made == 1
    assert not any(path.exists() for path in wrong)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="needs POSIX permissions")
def test_entry_that_others_may_write_is_not_loaded(monkeypatch, fresh):
    compiled(example())
    (entry,) = fresh.glob("*.so")
    entry.chmod(0o777)
    assert rooms.find_entry(fresh, entry.stem.partition("-")[0]) is None
    assert stat.S_IMODE(fresh.stat().st_mode) == 0o700


def _exposed_by(how, fresh):
    """Let others reach a cache in a way of a name."""
    if how == "folder":
        fresh.chmod(0o777)
    elif how == "parent":
        fresh.parent.chmod(0o777)
    elif how == "link":  # a safe-looking path to a folder that others reach
        target = fresh.parent.parent / "elsewhere"
        shutil.move(fresh, target)
        target.chmod(0o777)
        fresh.symlink_to(target)
    elif os.getuid() == 0:
        os.chown(fresh, 65534, 65534)
    else:
        pytest.skip("only root gives folders away")


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="needs POSIX permissions")
@pytest.mark.parametrize("how", ["folder", "parent", "link", "owner"])
def test_a_folder_that_others_can_change_is_not_used(monkeypatch, fresh, how):
    """Its owner could put a library of his in place of one that is being made: nothing is loaded, nothing written."""
    compiled(example())
    _exposed_by(how, fresh)
    forget(monkeypatch)
    before = sorted(fresh.iterdir())
    assert "could be another's" in stays_interpreted(example())
    assert sorted(fresh.iterdir()) == before


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="needs POSIX permissions")
def test_a_shared_temporary_folder_may_hold_a_cache_of_ours(fresh):
    """In a sticky folder others cannot replace what is ours; what may be written by a group of one is ours too."""
    fresh.parent.mkdir(parents=True, exist_ok=True)
    fresh.parent.chmod(0o1777)
    assert compiled(example()).class_name() == "External"
    about = fresh.stat()
    assert about.st_mode & 0o777 == 0o700 and not list(fresh.glob("lock-*"))


@pytest.mark.parametrize(
    ("kind", "reason"), [("integrator", "not supported for CvodesInterface"), ("solver", "its code needs <coin-or")]
)
def test_what_casadi_cannot_generate_stays_interpreted(kind, reason):
    flow = build_flow(chain(1))
    function = flow.end if kind == "integrator" else ca.Function("solved", [x := ca.MX.sym("x")], [_solver(x)])
    assert compiled(function) is function
    assert reason in statistics().reason


def _solver(x: ca.MX) -> ca.MX:
    y = ca.MX.sym("y")
    options = {"ipopt": {"print_level": 0, "sb": "yes"}, "print_time": False}
    return ca.nlpsol("inner", "ipopt", {"x": y, "f": (y - 1) ** 2}, options)(x0=x)["x"]


# ---- when it pays ----------------------------------------------------------------------------------


def test_auto_weighs_the_work(monkeypatch):
    function = example()
    assert compiled(function, effort=0.001) is function and statistics().left == 0
    assert "compiling would take" in stays_interpreted(function, effort=0.051)
    assert compiled(function, effort=10.0).class_name() == "External"
    forget(monkeypatch)
    assert compiled(example(), effort=0.051).class_name() == "External"  # it is in the cache now


def test_on_compiles_whatever_the_work():
    with compiling("on"):
        assert compiled(example(), effort=0.0).class_name() == "External"


def test_too_much_code(monkeypatch):
    monkeypatch.setattr(rooms, "LIMITS", replace(rooms.LIMITS, longest_auto=0.01))
    function = example()
    assert "compiling would take" in stays_interpreted(function)
    monkeypatch.setattr(rooms, "LIMITS", replace(rooms.LIMITS, largest=100))
    with compiling("on"):
        assert "MB of C" in stays_interpreted(example(3.0))


def test_modes(monkeypatch):
    assert mode() == "auto"
    monkeypatch.setenv("ORBITFINDER_COMPILE", "off")
    function = example()
    assert mode() == "off" and compiled(function) is function and statistics().left == 0
    with compiling("auto"):
        assert mode() == "auto"
        with compiling("on"):
            assert mode() == "on"
    assert mode() == "off"
    set_mode("on")
    assert mode() == "on"
    with pytest.raises(InputError, match="compile: unknown mode 'fast'; use on, off or auto"):
        set_mode("fast")
    monkeypatch.setattr(rooms, "_chosen", [])
    monkeypatch.setenv("ORBITFINDER_COMPILE", "yes")
    with pytest.raises(InputError, match="ORBITFINDER_COMPILE: unknown mode 'yes'"):
        mode()


def test_flags_and_expectation():
    assert flags(1000)[0] == "-O3" and flags(10**6)[0] == "-O1"
    assert not {"-ffast-math", "-Ofast"} & set(flags(1000)) and {"-ffp-contract=off", "-fno-tree-slp-vectorize"} <= set(
        flags(1000)
    )
    assert flags(1000, ("-march=native",))[-1] == "-march=native"
    assert expected_seconds(10**6) > expected_seconds(1000) > 0


def test_each_processor_has_its_own_entries(tmp_path, monkeypatch):
    """What "native" defines is part of the identity; a compiler that does not know the flag goes without it."""
    real = shutil.which("cc")
    if real is None:
        pytest.skip("no cc")
    said = []
    for number, body in enumerate(("echo '#define __WIDE__ 1'", "echo '#define __NARROW__ 1'", "exit 1")):
        script = tmp_path / f"cc{number}"
        script.write_text(f'#!/bin/sh\ncase "$*" in *-dM*) {body};; *) exec {real} "$@";; esac\n')
        script.chmod(0o755)
        monkeypatch.setenv("CC", str(script))
        said.append(find_compiler())
    assert [one.tuning for one in said] == [("-march=native",), ("-march=native",), ()]
    assert len({one.identity for one in said}) == 3
    forget(monkeypatch)
    assert compiled(example()).class_name() == "External"


# ---- the cache -------------------------------------------------------------------------------------


def test_eviction_takes_the_least_recently_used(fresh):
    fresh.mkdir(parents=True)
    for age, name in enumerate(("newest", "middle", "oldest")):
        (fresh / f"{name}.so").write_bytes(b"x" * 100)
        os.utime(fresh / f"{name}.so", (1e9 - age, 1e9 - age))
    (fresh / "making-dead.so").write_bytes(b"")
    (fresh / "making-gone").mkdir()
    (fresh / "making-gone" / "code.c").write_text("")
    for name in ("making-dead.so", "making-gone"):
        os.utime(fresh / name, (1e9, 1e9))
    (fresh / "making-now.so").write_bytes(b"")
    rooms.evict(fresh, limit=200)
    assert sorted(path.name for path in fresh.iterdir()) == ["making-now.so", "middle.so", "newest.so"]
    rooms.evict(fresh, keep=fresh / "middle.so", limit=0)
    assert sorted(path.name for path in fresh.glob("*.so")) == ["making-now.so", "middle.so"]


def test_evicted_library_goes_on_working(monkeypatch, fresh):
    monkeypatch.setattr(rooms, "LIMITS", replace(rooms.LIMITS, limit=1))
    one, two = compiled(example()), compiled(example(3.0))
    assert len(list(fresh.glob("*.so"))) == 1
    np.testing.assert_array_equal(one([1, 2, 3])[0], example()([1, 2, 3])[0])
    np.testing.assert_array_equal(two([1, 2, 3])[0], example(3.0)([1, 2, 3])[0])


def test_use_is_remembered(monkeypatch, fresh):
    compiled(example())
    (entry,) = fresh.glob("*.so")
    os.utime(entry, (1e9, 1e9))
    forget(monkeypatch)
    compiled(example())
    assert entry.stat().st_mtime > 1e9


def test_place_of_the_cache(monkeypatch, tmp_path):
    monkeypatch.delenv("ORBITFINDER_CACHE")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.setattr(platformdirs, "PlatformDirs", Unix)
    assert rooms.folder() == tmp_path / "xdg" / "orbitfinder" / "compiled"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert rooms.folder() == tmp_path / ".cache" / "orbitfinder" / "compiled"
    monkeypatch.setattr(platformdirs, "PlatformDirs", MacOS)
    assert rooms.folder() == tmp_path / "Library" / "Caches" / "orbitfinder" / "compiled"
    monkeypatch.setenv("ORBITFINDER_CACHE", str(tmp_path / "chosen"))
    assert rooms.folder() == tmp_path / "chosen" / "compiled"


@pytest.mark.parametrize("home", ["", None])
def test_somebody_without_a_home(monkeypatch, home):
    """No cache is made in a folder named ~ of the current one."""
    for name in ("ORBITFINDER_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    if home is not None:
        monkeypatch.setenv("HOME", home)
    else:
        monkeypatch.setattr(platformdirs, "user_cache_path", lambda *_, **__: Path("~nosuchuser/cache"))
    with pytest.raises(OSError, match="Set ORBITFINDER_CACHE to a folder of your own"):
        rooms.folder()
    assert stays_interpreted(example())


def test_library_in_a_folder_that_vanishes(tmp_path):
    with pytest.raises((Unavailable, OSError)):
        make_library(find_compiler(), "int f;", tmp_path / "nowhere")


# ---- the command line ------------------------------------------------------------------------------


@click.command()
@compile_option
def command() -> None:
    click.echo(mode())


def test_option(monkeypatch):
    runner = CliRunner()
    assert runner.invoke(command, []).output == "auto\n"
    assert runner.invoke(command, ["--compile", "off"]).output == "off\n"
    assert "ORBITFINDER_COMPILE" not in os.environ
    monkeypatch.setenv("ORBITFINDER_COMPILE", "off")
    assert runner.invoke(command, ["--compile", "auto"]).output == "auto\n"
    assert os.environ["ORBITFINDER_COMPILE"] == "off"
    refused = runner.invoke(command, ["--compile", "maybe"])
    assert refused.exit_code == 2 and "'maybe' is not one of" in refused.output
    monkeypatch.setenv("CC", "no-such-compiler-here")
    said = runner.invoke(command, ["--compile", "on"])
    assert said.exit_code == 0 and "running interpreted" in said.output


@pytest.mark.parametrize("name", ["run", "continue", "reproduce"])
def test_commands_have_the_option(name):
    from orbitfinder.cli.group import cli

    assert "--compile" in CliRunner().invoke(cli, [name, "--help"]).output
