"""Capture of what C code and Python code print."""

import os
import subprocess
import sys

import casadi as ca
import pytest

from orbitfinder._runtime.quiet import captured


def test_python_and_descriptor_level_output_are_both_captured(capfd):
    """Text written through sys.stdout, sys.stderr and straight to descriptors 1 and 2 lands in the result."""
    with captured() as output:
        print("from python")
        print("from python, stderr", file=sys.stderr)
        os.write(1, b"from C\n")
        os.write(2, b"from C, stderr\n")
    for text in ("from python\n", "from python, stderr\n", "from C\n", "from C, stderr\n"):
        assert text in output.text
    assert capfd.readouterr() == ("", "")


def test_output_of_a_child_process_is_captured(capfd):
    """A child inherits the redirected descriptors, so what it prints is captured too."""
    with captured() as output:
        subprocess.run([sys.executable, "-c", "print('child')"], check=True)
    assert output.text.strip() == "child"
    assert capfd.readouterr().out == ""


def test_output_is_restored_after_the_block(capfd):
    """After the block both levels reach the terminal again, and nothing of the block does."""
    with captured():
        print("inside")
    print("outside")
    os.write(2, b"outside too\n")
    assert capfd.readouterr() == ("outside\n", "outside too\n")


def test_text_printed_before_the_block_stays_outside(capfd):
    """What was buffered before the block is not swallowed by it."""
    sys.stdout.write("before ")
    with captured() as output:
        os.write(1, b"inside")
    assert output.text == "inside"
    assert capfd.readouterr().out == "before "


def test_nested_blocks_leave_the_text_to_the_outermost(capfd):
    """An inner block captures nothing itself and does not end the capture of the outer one."""
    with captured() as outer:
        with captured() as inner:
            os.write(1, b"deep ")
        print("shallow")
    assert inner.text == ""
    assert "deep " in outer.text and "shallow" in outer.text
    assert capfd.readouterr() == ("", "")


def test_an_exception_restores_the_descriptors_and_keeps_the_text(capfd):
    """An exception passes through, the captured text is kept, and the terminal works again."""
    with pytest.raises(ValueError, match="planned"), captured() as output:
        os.write(1, b"last words")
        raise ValueError("planned")
    assert output.text == "last words"
    os.write(1, b"alive")
    assert capfd.readouterr().out == "alive"
    with captured() as again:
        print("again")
    assert again.text == "again\n"


def test_no_descriptor_is_leaked():
    """A hundred blocks, half of them left by an exception, open no file descriptor for good."""

    def lowest_free() -> list[int]:
        found = [os.dup(1) for _ in range(6)]
        for descriptor in found:
            os.close(descriptor)
        return found

    before = lowest_free()
    for k in range(100):
        try:
            with captured():
                if k % 2:
                    raise KeyError
        except KeyError:
            pass
    assert lowest_free() == before


def test_casadi_output_is_captured(capfd):
    """What CasADi prints about a failing rootfinder stays off the terminal."""
    x = ca.MX.sym("x")
    with captured() as output:
        solver = ca.nlpsol("solver", "ipopt", {"x": x, "f": (x - 1) ** 2})
        solver(x0=0.0)
    assert "EXIT: Optimal Solution Found" in output.text
    assert capfd.readouterr() == ("", "")


def test_bytes_that_are_not_utf8_do_no_harm():
    """Undecodable output is replaced, not raised."""
    with captured() as output:
        os.write(1, b"\xff\xfe ok")
    assert output.text.endswith(" ok")
