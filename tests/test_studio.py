"""The studio: what its processes compute, what a tab keeps and saves, and a browser that drives the whole page."""

import asyncio
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from studio_browser import BROWSER, Server, Tab, children, shared

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.mechanics.model import energy, positions
from orbitfinder.mechanisms.chain import chain
from orbitfinder.mechanisms.library import brusselator, duffing, forced_duffing, van_der_pol
from orbitfinder.mechanisms.machines import simplest_walker
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.find import find_orbit
from orbitfinder.problemfile.read import load_problem
from orbitfinder.records.family import load_family, save_family
from orbitfinder.records.registry import load_orbit
from orbitfinder.studio.films import draggable, pose, pullable, view
from orbitfinder.studio.plots import clicked, section_figure
from orbitfinder.studio.serve import MOST_TABS, free_port, redirect
from orbitfinder.studio.session import Session, leaving, opened, parameters, rests, session_folder
from orbitfinder.studio.tasks import Tasks
from orbitfinder.studio.worker import RefusedError, StoppedError, TaskProcess

ROOT = Path(__file__).parents[1]


@pytest.fixture
def session(tmp_path):
    (tmp_path / "tab").mkdir()
    return Session(opened(None), tmp_path / "tab", tmp_path / "out")


@pytest.fixture(scope="module")
def tasks():
    said = []
    found = Tasks(said.append)
    found.said = said
    return found


def test_close_returns_are_ranked_by_miss_times_period_cubed(tasks, session):
    run = tasks.simulated(dict(session.model.system), [0.3, 0.4, 0.0, 0.0], 20.0)
    assert run.energy == pytest.approx(energy(session.model, np.array([0.3, 0.4, 0, 0])), rel=1e-12)
    assert run.change < 1e-9 * abs(run.energy)
    ranks = [one.distance * one.period**3 for one in run.returns]
    assert len(ranks) > 3 and ranks == sorted(ranks)
    nearest = min(one.distance for one in run.returns)
    assert run.returns[0].distance > nearest  # which is not the most promising here


def test_what_is_found_saved_and_found_again_is_one_orbit(tasks, session, tmp_path, monkeypatch):
    """The command lines repeat the work in another folder, to 1e-12."""
    run = tasks.simulated(dict(session.model.system), [0.3, 0.4, 0.0, 0.0], 20.0)
    session.energy = run.energy
    taken: set[str] = set()
    name, file = session.problem(run.returns[0].state, run.returns[0].period, taken)
    found = tasks.found(file, session.folder)
    assert found.orbit.certificate.passed and found.film["points"] == 3
    assert any("shooting" in str(one) for one in tasks.said)
    item = session.keep_orbit(found.orbit)
    tasks.said.clear()
    family = tasks.followed(item.file, "energy", 2, f"{name}-energy", session.folder)
    steps = [one for one in tasks.said if not isinstance(one, str)]
    assert sum(len(one.batch.points) for one in steps) >= 4 and all(film for one in steps for film in one.films)
    session.keep_family(family, name, 2)
    assert [node["children"][0]["id"] for node in session.tree()] == [f"{name}-energy"]
    assert len(session.save()) == 6 and session.save() == []

    monkeypatch.chdir(tmp_path)
    for line in session.commands():
        program, *arguments = shlex.split(line)
        assert program == "orbitfinder"
        result = CliRunner().invoke(cli, arguments)
        assert result.exit_code == 0, result.output
    saved, again = (load_orbit(place / name / "orbit.json") for place in (session.out, tmp_path / "again"))
    assert abs(again.period / saved.period - 1) < 1e-12 and np.abs(again.state - saved.state).max() < 1e-12
    one, other = (load_family(place / family.name / "family.json") for place in (session.out, tmp_path / "again"))
    assert np.abs(one.values("period") / other.values("period") - 1).max() < 1e-12
    assert certify(saved).passed


def test_saving_leaves_what_others_wrote_alone(tasks, session):
    orbit = find_orbit(_swing())
    name, _ = session.problem_of(orbit, set())
    found = tasks.found(session.folder / f"{name}.toml", session.folder)
    session.keep_orbit(found.orbit)
    (session.out / name).mkdir(parents=True)
    with pytest.raises(InputError, match="exists already and is left alone"):
        session.save()
    assert list((session.out / name).iterdir()) == []
    (session.out / "double-pendulum-7.toml").touch()
    taken = {f"double-pendulum-{k}" for k in range(1, 7)}
    assert session.unused(taken) == "double-pendulum-8" and "double-pendulum-8" in taken


def _swing(model=None):
    from orbitfinder.loops.conditions import pin
    from orbitfinder.loops.problem import Problem
    from orbitfinder.orbits.guesses.modes import normal_mode

    model = model or chain(2)
    guess = normal_mode(model, 1, 0.4)
    return Problem(model, guess, pin(energy=energy(model, np.asarray(guess.state))), name="swing")


def test_an_orbit_follows_a_parameter_warm_and_back(tasks):
    orbit = find_orbit(_swing())
    longer = tasks.turned(orbit, "length2", 1.2).orbit
    direct = find_orbit(_swing_at(longer))
    assert longer.certificate.passed and longer.system["length"] == [1.0, 1.2]
    assert longer.energy == pytest.approx(orbit.energy, rel=1e-12)
    assert longer.period == pytest.approx(direct.period, rel=1e-11)
    back = tasks.turned(longer, "length2", 1.0).orbit
    assert back.period == pytest.approx(orbit.period, rel=1e-11)
    warm = tasks._refiner[1]
    tasks.turned(back, "length2", 0.9)
    assert tasks._refiner[1] is warm
    with pytest.raises(ConvergenceError, match="the orbit was lost on the way"):
        tasks.turned(orbit, "length2", 0.2)  # below the lowest energy that there is


def test_a_parameter_slid_through_a_hopf_point_and_back_shows_the_cycle_appear(tasks):
    """The Brusselator: amplitudes grow like a root beyond rate 2, below it everything comes to rest at (1, rate)."""
    state, near, sizes, extents = [3.6, 1.3], [1.0, 2.0], np.zeros(2), {}
    for rate in (2.08, 2.02, 1.95, 2.02, 2.08):
        done = tasks.settled(dict(brusselator(rate=rate).system), state, "rate", 57.0, near, sizes)
        state, near, sizes = done.state, done.rest.state.tolist(), done.sizes
        assert done.still == (rate < 2)
        assert np.allclose(near, [1.0, rate], rtol=1e-12)
        assert done.rest.stability == ("stable" if rate < 2 else "unstable") and done.rest.value == rate
        extents.setdefault(rate, []).append(np.ptp(done.path[:, 0]))
    assert extents[1.95] == pytest.approx([0.0], abs=1e-3)
    assert np.allclose(extents[2.08], 2 * np.array(extents[2.02]), rtol=0.05)
    assert np.ptp(extents[2.02]) < 0.02 * extents[2.02][0]  # the same cycle from outside and from the equilibrium


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_an_equilibrium_at_zero_is_left_and_come_back_to_in_any_unit(tasks, unit):
    """x'' + d (x^2 / u^2 - 1) x' + x = 0 goes round at 2 u, and with -d comes to rest inside of it."""
    state, near, sizes = [0.5 * unit, 0.0], [0.0, 0.0], np.zeros(2)
    for damping in (-0.5, 0.5):
        model = of.ode(
            lambda t, x, p: [x[1], p[0] * (1 - (x[0] / unit) ** 2) * x[1] - x[0]], ["x", "y"], parameters={"d": damping}
        )
        tasks.model = lambda _, model=model: model
        try:
            done = tasks.settled({}, state, "d", 40.0, near, sizes)
        finally:
            del tasks.model
        state, near, sizes = done.state, done.rest.state.tolist(), done.sizes
        assert done.rest.stability == ("stable" if damping < 0 else "unstable") and done.still == (damping < 0)
        if damping > 0:
            assert np.abs(done.path[:, 0]).max() == pytest.approx(2 * unit, rel=0.02)


def test_systems_that_settle_by_themselves_are_those_without_clock_energy_or_control():
    assert rests(brusselator()) and rests(van_der_pol())
    assert not any(map(rests, (chain(2), duffing(), forced_duffing(), simplest_walker())))


def _swing_at(orbit):
    from orbitfinder.loops.conditions import pin
    from orbitfinder.loops.problem import Guess, Problem
    from orbitfinder.mechanics.kind import build_model

    return Problem(build_model(orbit.system), Guess(orbit.state, orbit.period), pin(energy=orbit.energy))


def test_what_a_chain_shows_can_be_dragged():
    model = chain(2, length=[1.0, 0.5])
    assert draggable(model) == [1.0, 0.5]
    still = pose(model, np.array([0.3, 0.1, 0.0, 0.0]))
    assert still["points"] == 3 and still["moving"] == []
    joints = positions(model, np.array([[0.3, 0.1, 0.0, 0.0]]))[0]
    shown = [[still["still"][str(c)] for c in range(3)], [still["still"][str(3 + c)] for c in range(3)]]
    assert np.abs(np.array(shown) - joints).max() < 1e-9
    assert view(model, np.zeros((1, 4)))["spans"][0] > 3.0
    values = parameters(model)
    assert values["length2"] == (0.5, 0.25, 0.75)


@pytest.mark.parametrize(
    "file, message",
    [
        ("thing.py", "the studio runs no Python files"),
        ("atlas.json", "which `studio` does not take; give an orbit, a family, an atlas, or one orbit of the file"),
        ("missing.toml", "missing.toml"),
    ],
)
def test_other_files_are_refused_with_a_sentence(tmp_path, file, message):
    (tmp_path / "thing.py").write_text("raise SystemExit")
    (tmp_path / "atlas.json").write_text("[]")
    result = CliRunner().invoke(cli, ["studio", str(tmp_path / file), "--out", str(tmp_path / "o"), "--no-browser"])
    assert result.exit_code == 2 and message in result.output and "Traceback" not in result.output


def test_a_port_in_use_is_named_and_another_one_is_free():
    import socket

    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        held.listen()
        port = held.getsockname()[1]
        with pytest.raises(InputError, match=f"port: {port} is in use"):
            free_port(port)
        assert free_port() != port


def test_whatever_a_page_sends_is_a_number_or_nothing():
    assert clicked({"points": [{"curveNumber": 1, "pointIndex": 4}]}) == (1, 4)
    for nonsense in ({}, {"points": []}, {"points": [{"pointIndex": "x"}]}, {"points": [None]}, None, {"points": 3}):
        assert clicked(nonsense) is None


def test_a_process_is_stopped_at_once_and_the_next_task_has_another():
    async def tried():
        worker = TaskProcess()
        await worker.start()
        first = worker.process
        slow = asyncio.create_task(worker.do("simulated", dict(chain(9).system), [2.0] * 9 + [0.0] * 9, 3000.0))
        await asyncio.sleep(0.3)
        assert worker.busy and not slow.done()
        began = time.monotonic()
        worker.stop()
        with pytest.raises(StoppedError, match="nothing that is saved is lost"):
            await slow
        waited = time.monotonic() - began
        with pytest.raises(RefusedError, match="duration: must be positive"):
            await worker.do("simulated", dict(chain(1).system), [0.5, 0.0], -1.0)
        assert worker.process not in (None, first)
        worker.close()
        with pytest.raises(StoppedError, match="the page is closed"):
            await worker.do("simulated", dict(chain(1).system), [0.5, 0.0], 1.0)
        return waited

    assert asyncio.run(tried()) < 0.5


def test_a_process_that_was_killed_while_it_waited_costs_nothing():
    async def tried():
        worker = TaskProcess()
        await worker.start()
        first = worker.process
        os.kill(first, signal.SIGKILL)
        await asyncio.sleep(0.2)
        found = await worker.do("simulated", dict(chain(1).system), [0.5, 0.0], 1.0)
        assert worker.process != first and found.film
        worker.close()

    asyncio.run(tried())


def test_a_family_whose_process_was_killed_is_kept_as_far_as_it_came(tasks, session):
    name, _ = session.problem_of(find_orbit(_swing()), set())
    item = session.keep_orbit(tasks.found(session.folder / f"{name}.toml", session.folder).orbit)
    assert session.rescued("nothing") is None

    class KilledError(Exception):
        pass

    def die(what):
        if not isinstance(what, str):
            raise KilledError

    with pytest.raises(KilledError):
        Tasks(die).followed(item.file, "energy", 10, "part", session.folder)
    again = begun_again(session)  # a studio that died with it finds both
    assert list(again.items) == [name, "part"] and len(again.items["part"].family.points) == 2
    family = session.rescued("part")
    assert len(family.points) == 2 and family.ends == ()
    session.keep_family(family, name, 10)
    session.save()
    assert len(load_family(session.out / "part" / "family.json").points) == 2
    assert leaving(family) == {}


def test_a_section_starts_motions_at_its_energy_and_shows_where_the_orbit_crosses(tasks, monkeypatch):
    monkeypatch.setattr("orbitfinder.studio.tasks.SEEDS", 4)
    monkeypatch.setattr("orbitfinder.studio.tasks.CROSSINGS", 6)
    orbit = find_orbit(_swing())
    model, cut = chain(2), tasks.cut(dict(orbit.system), orbit.energy, orbit)
    section = cut.section
    assert section.energy == orbit.energy and section.returns == 24 and len(cut.crossings) == 1
    assert [energy(model, one) for one in section.states] == pytest.approx([orbit.energy] * 24, rel=1e-9)
    moment = np.abs(orbit.samples[:, 0]).argmin()  # one of the two times at which theta1 = 0
    assert abs(cut.crossings[0, 0]) == pytest.approx(abs(orbit.samples[moment, 1]), abs=0.02)
    figure = section_figure(cut, False)
    assert len(figure["data"][0]["x"]) == 24 and figure["data"][1]["x"] == cut.crossings[:, 0].tolist()
    native = load_problem(ROOT / "problems" / "linkages" / "four-bar-rocking.toml").model
    with pytest.raises(InputError, match="systems under constraints have no section"):
        tasks.cut(dict(native.system), -10.0, None)


@pytest.mark.slow
def test_a_search_that_is_killed_keeps_what_it_found_and_goes_on(tasks, session, tmp_path, monkeypatch):
    """The command line repeats it: the same orbits under the same ids."""
    from orbitfinder.atlas.store import Atlas

    class KilledError(Exception):
        pass

    def die(at):
        if at.made >= 2:
            raise KilledError

    monkeypatch.setattr("orbitfinder.studio.tasks.SPEAK_EVERY", 0.0)
    taken, level = set(), energy(session.model, np.array([0.5, 1.0, 0.0, 0.0]))
    name, file = session.search([0.5, 1.0, 0.0, 0.0], (0.7, 3.0), level, taken)
    assert (name, file) == session.search([0.1, 0.1, 0.0, 0.0], (0.7, 3.0), level, taken)
    asked = dict(session.model.system), level, (0.7, 3.0)
    with pytest.raises(KilledError):
        Tasks(die).searched(*asked, 60.0, file)
    assert tasks.searched(*asked, 0.5, file) >= 3  # it went on
    item = session.keep_atlas(name)
    assert item.atlas and session.save() == [] and session.tree()[0]["label"].startswith(f"{name}: an atlas of ")
    number = item.atlas[0].id
    found = tasks.opened(Path(f"{file}#{number}"))
    assert certify(found.orbit).passed and found.film
    member = session.keep_member(item, number, found.orbit)
    family = tasks.followed(member.file, "energy", 1, f"{member.name}-energy", session.folder)
    session.keep_family(family, member.name, 1)
    session.save()
    monkeypatch.chdir(tmp_path)
    for line in session.commands():
        result = CliRunner().invoke(cli, shlex.split(line)[1:])
        assert result.exit_code == 0, result.output
    with Atlas(file) as mine, Atlas(f"again-{name}.sqlite") as theirs:
        assert mine.rows() == theirs.rows()
    one, other = (load_family(place / family.name / "family.json") for place in (session.out, tmp_path / "again"))
    assert np.abs(one.values("period") / other.values("period") - 1).max() < 1e-12
    shown = opened(file)
    assert shown.atlas == file and shown.model.system == session.model.system
    assert opened(Path(f"{file}#{number}")).orbit is not None
    with Atlas(tmp_path / "empty.sqlite", session.model.system, write=True):
        pass
    with pytest.raises(InputError, match="the atlas is empty"):
        opened(tmp_path / "empty.sqlite")


@pytest.mark.parametrize(
    "file, pulls",
    [("hybrid/bouncing-ball", True), ("control/cart-pole-cycle", True), ("linkages/four-bar-rocking", True),
     pytest.param("robots/a1-leg", True, marks=pytest.mark.needs("robot")), ("mechanisms/furuta", True)],
)  # fmt: skip
def test_every_kind_of_system_opens_runs_and_is_found_by_its_own_file(tasks, tmp_path, file, pulls):
    given = opened(ROOT / "problems" / f"{file}.toml")
    run = tasks.simulated(dict(given.model.system), given.state.tolist(), given.duration / 8)
    assert run.film["count"] > 1
    points = pullable(given.model, given.state)
    assert bool(points) == pulls
    (tmp_path / "tab").mkdir()
    name, copy = Session(given, tmp_path / "tab", tmp_path / "out").own_problem(set())
    again = load_problem(copy)  # its robot's description is found from elsewhere, too
    assert again.name == name and again.model.system["kind"] == given.model.system["kind"]
    if pulls:
        there = positions(given.model, given.state[None])[0, :, points[-1]]
        state, film = tasks.pulled(dict(given.model.system), given.state.tolist(), points[-1], (there + 0.01).tolist())
        assert film["moving"] == [] and np.isfinite(state).all()
        system = dict(given.model.system)
        assert tasks.later(system, state, 0.0) == state and np.isfinite(tasks.later(system, state, 0.01)).all()


def test_a_machine_with_impacts_is_dragged_seen_arc_by_arc_and_its_orbit_is_found(tasks, tmp_path):
    """A ball is lifted and thrown, not pulled through the table; its motion bounces, and a close return is an orbit."""
    given = opened(ROOT / "problems" / "hybrid" / "bouncing-ball.toml")
    system, (height, _, phase) = dict(given.model.system), given.state.tolist()
    table = 0.012 * np.sin(phase)
    below, _ = tasks.pulled(system, given.state.tolist(), 0, [0.5, 0.0])
    assert below[0] >= min(height, table) - 1e-12
    lifted, film = tasks.pulled(system, given.state.tolist(), 0, [-0.11, 0.0])
    assert lifted[::2] == pytest.approx([0.11, phase]) and film["moving"] == []
    lifted = tasks.thrown(system, lifted, 0, [0.0, 0.0])
    assert lifted == pytest.approx([0.11, 0.0, phase])
    thrown = tasks.thrown(system, lifted, 0, [0.2, 0.0])  # downwards
    assert thrown == pytest.approx([0.11, -0.2, phase])
    run = tasks.simulated(system, lifted, 8.0)
    ((event, often),) = run.events
    assert event == "bounce" and 10 < len(run.film["jumps"]) <= often + 1 and run.film["ground"]
    session = Session(given, tmp_path, tmp_path / "out")
    near = tasks.simulated(system, [height + 0.002, 0.49, phase], 3.0).returns[0]
    found = tasks.found(session.problem(near.state, near.period, set())[1], tmp_path)
    assert found.orbit.certificate.passed and found.orbit.period == pytest.approx(1.0, abs=1e-12)
    later = tasks.later(system, lifted, 0.3)
    assert later[0] == pytest.approx(0.11 - 0.3**2 / 2, abs=1e-6)
    dead = tasks.simulated(system | {"arguments": {"amplitude": 0.0, "restitution": 0.5}}, lifted, 8.0)
    assert "gap holds no longer" in dead.stopped and dead.film["period"] == pytest.approx(
        np.sqrt(2 * 0.11) * 3, rel=0.01
    )


def test_a_linkage_without_a_guess_is_put_together(tmp_path):
    text = (ROOT / "problems" / "linkages" / "four-bar-rocking.toml").read_text()
    table = text[text.index("[system]") : text.index("[guess]")]
    file = tmp_path / "bare.toml"
    file.write_text(f'name = "bare"\n{table}\n[search]\nperiod = [0.5, 2.0]\nenergy = -10.0\n')
    given = opened(file)
    assert given.guess is None and given.model.constraint is None and np.isfinite(given.state).all()


# ---------------------------------------------------------------------- in a browser

browsing = pytest.mark.skipif(not BROWSER, reason="no browser: install chromium and chromedriver")


@pytest.fixture
def server(tmp_path):
    one = Server(tmp_path)
    yield one
    if one.process.poll() is None:
        one.end(signal.SIGKILL)
    one.log.close()


@pytest.mark.needs("studio")
def test_the_page_is_served_to_whoever_knows_the_address_here_only(server, tmp_path):
    base, token = re.fullmatch(r"(http://127\.0\.0\.1:\d+)/([\w-]{20,})", server.address).groups()

    def status(path, **headers):
        try:
            return urllib.request.urlopen(urllib.request.Request(base + path, headers=headers)).status
        except urllib.error.HTTPError as error:
            return error.code

    assert status(f"/{token}") == 200 and status(f"/{token}/site/core.js") == 200
    page = urllib.request.urlopen(f"{base}/{token}").read().decode()  # what is painted first, before all else is built
    assert '<p class="opening"' in page and len(page) < 20_000
    assert re.findall(r"<script (?!defer|type=)[^>]*src", page) == []
    assert status("/") == status(f"/{token[:-1]}") == status("/site/core.js") == 404
    assert status(f"/{token}", Host="evil.example") == 400
    port = base.rpartition(":")[2]
    again = CliRunner().invoke(cli, ["studio", "--no-browser", "--port", port, "--out", str(tmp_path / "o")])
    assert again.exit_code == 2 and f"--port: {port} is in use" in again.output
    other = Server(tmp_path)
    assert other.address.startswith("http://127.0.0.1:") and not other.address.startswith(base)
    for one in (other, server):
        one.end()
        assert "Traceback" not in one.words()
    other.log.close()


def socket_of(base, origin, frames=()):
    """The first line of the answer to a websocket's handshake, text frames sent after it."""
    import socket

    host = base.removeprefix("http://")
    lines = ["GET /_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1", f"Host: {host}", "Upgrade: websocket"]
    lines += ["Connection: Upgrade", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13"]
    lines += [f"Origin: {origin}"] if origin else []
    with socket.create_connection((host.split(":")[0], int(host.split(":")[1])), 10.0) as made:
        made.sendall("\r\n".join([*lines, "", ""]).encode())
        answer = made.recv(400).decode("latin-1").splitlines()[0]
        for frame in frames:
            made.sendall(bytes([0x81, 0x80 | len(frame)]) + b"\0\0\0\0" + frame.encode())
            time.sleep(0.05)
    return answer


@pytest.mark.needs("studio")
def test_pages_of_elsewhere_what_they_send_and_too_many_tabs_are_refused_in_a_word(server):
    base = server.address.rpartition("/")[0]

    def answer(path, **headers):
        try:
            return urllib.request.urlopen(urllib.request.Request(base + path, headers=headers)).read()
        except urllib.error.HTTPError as error:
            return error.code, error.read()

    assert "101" in socket_of(base, base) and "403" in socket_of(base, "http://evil.example")
    assert answer("/")[0] == answer("/_nicegui/other")[0] == 404 and len(answer("/")[1]) < 100
    assert answer(server.address.removeprefix(base), Origin="http://evil.example")[0] == 403
    hostile = ('42["event",{}]', '42["event",3]', '42["handshake",{}]', '42["ack",{"client_id":[]}]', "4zzz", "42{")
    socket_of(base, base, ("40", *hostile))
    shown = [b"tabs of this studio are open" in answer(server.address.removeprefix(base)) for _ in range(MOST_TABS + 1)]
    assert shown == [False] * MOST_TABS + [True]
    server.end()
    words = server.words()
    assert "client_id" in words and "Traceback" not in words and max(map(len, words.splitlines())) < 320


def test_only_this_user_can_read_where_a_browser_is_sent(tmp_path):
    file = redirect(tmp_path, "http://127.0.0.1:1/secret")
    assert "url=http://127.0.0.1:1/secret" in file.read_text() and file.stat().st_mode & 0o777 == 0o600
    with pytest.raises(FileExistsError):  # nobody lays a file there before
        redirect(tmp_path, "http://127.0.0.1:1/secret")


@pytest.mark.needs("studio")
def test_a_tab_that_is_closed_leaves_what_was_found(session):
    from types import SimpleNamespace

    from orbitfinder.studio.page import Page

    page = Page(session, set(), "")
    page.timer, page.background = SimpleNamespace(deactivate=int), SimpleNamespace(close=int)
    (session.folder / "orbit.json").touch()
    page.close()
    assert (session.folder / "orbit.json").exists()


def begun_again(session):
    """The same folder as a reloaded page, a second tab or a studio after a crash finds it."""
    again = Session(session.opened, session.folder, session.out)
    again.restore()
    return again


def found_before(session):
    """A session with an orbit and a family of it, as their tasks write them; a shipped orbit stands for the first."""
    orbit = load_orbit(ROOT / "results" / "gallery" / "duffing" / "orbit.json")
    name = session.unused(set())
    of.save_orbit(replace(orbit, name=name), session.folder / name / "orbit.json")
    session.keep_orbit(replace(orbit, name=name))
    shipped = load_family(ROOT / "results" / "families" / "henon-heiles-loop" / "family.json")
    family = replace(shipped, name=f"{name}-energy", points=shipped.points[:3], events=(), ends=())
    save_family(family, session.folder / family.name)
    session.keep_family(family, name, 2)
    return name


def test_what_was_found_is_brought_back_from_the_sessions_folder(session):
    name = found_before(session)
    again = begun_again(session)
    assert again.tree() == session.tree() and again.commands() == session.commands() and not again.damaged
    assert again.items[name].orbit.period == session.items[name].orbit.period
    assert len(again.items[f"{name}-energy"].family.points) == 3
    assert again.unused(set()) == "double-pendulum-2"  # a name that is there is not given again
    again.items[name].files = again.items[name].files[1:]  # its problem file is not of this test
    again.items[f"{name}-energy"].files = again.items[f"{name}-energy"].files[1:]
    assert len(again.save()) == 4 and again.save() == []
    assert all(item.saved for item in begun_again(session).items.values()) and begun_again(session).save() == []


@pytest.mark.parametrize("spoil", ["note", "orbit", "name", "files"])
def test_a_damaged_file_of_a_session_is_reported_and_left_alone(session, spoil):
    name = found_before(session)
    file = session.folder / (f"{name}/orbit.json" if spoil == "orbit" else f"{name}.json")
    text = file.read_text()
    changed = {"name": text.replace(f'"name": "{name}"', '"name": "other"'),
               "files": text.replace(f'"{name}.toml"', f'"{name}/../../../x.toml"')}  # fmt: skip
    file.write_text(changed.get(spoil, text[:40]))
    left = file.read_bytes()
    again = begun_again(session)
    assert list(again.items) == [f"{name}-energy"] and len(again.damaged) == 1
    assert str(file) in again.damaged[0] and "left alone" in again.damaged[0]
    assert file.read_bytes() == left and again.unused(set()) == "double-pendulum-2"


def test_two_studios_at_once_have_folders_of_their_own(tmp_path):
    with session_folder(tmp_path, "clock") as one, session_folder(tmp_path, "clock") as other:
        assert (one.name, other.name) == ("clock-1", "clock-2") and one.parent == tmp_path / "sessions"
    with session_folder(tmp_path, "clock") as again:
        assert again == one


@pytest.fixture
def tab(server, tmp_path):
    one = Tab(server.address, tmp_path / "profile")
    yield one
    one.driver.quit()


@pytest.mark.needs("studio", "browser")
@browsing
@pytest.mark.slow
def test_from_a_dragged_mechanism_to_a_saved_tree_of_families(server, tab, tmp_path):
    """The slow mode's shape is released: along its family the multipliers turn, so that branches leave it."""
    began = time.monotonic()
    tab.turn(2, 0.5 * np.sqrt(2.0))
    assert re.match(r"E = -\d+\.\d+ J, kept to \S+ J, \d+ close returns in 18\.8 s", tab.text("readout"))
    tab.click("find")
    tab.said("certified")
    assert time.monotonic() - began < 10.0 * shared()
    assert "Certified" in tab.text("badge") and tab.text("about").startswith("T = ")

    tab.click("badge")
    tab.until("return [...document.querySelectorAll('.certificate td')].some(one => one.innerText === 'closure')")
    tab.escape()
    tab.click("follow")
    tab.said(r": \d+ orbits?$")  # points come in
    tab.said("closed orbits")
    times = tab.slid()
    print(f"sliding: median {np.median(times):.0f} ms, worst {max(times):.0f} ms")
    assert np.median(times) < 50.0 * shared()
    assert "orbit " in tab.text("where")

    tab.click("branch")
    tab.said("search|looking|found")
    time.sleep(1.0)
    began = time.monotonic()
    tab.click("cancel")
    tab.said("Stopped", 5.0)
    assert time.monotonic() - began < 0.5 * shared()
    tab.click("branch")
    tab.said("famil(y|ies) found at event")
    tab.click("save")
    tab.said("files? saved")
    assert tab.driver.get_log("browser") == []
    hosts = {
        one.split("/")[2] for one in tab.ask("return performance.getEntries().map(one => one.name)") if "//" in one
    }
    assert hosts <= {server.address.split("/")[2]}  # nothing from elsewhere: it works offline

    server.end(signal.SIGKILL)  # nothing saved is lost
    saved = sorted((tmp_path / "studio").glob("*/*.json"))
    assert len(saved) >= 3
    commands = tab.ask("return document.querySelector('.commands').innerText").strip().splitlines()
    assert sum("--switch" in one for one in commands) >= 1
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    for line in [one for one in commands if one.startswith("orbitfinder")][:2]:
        command = [sys.executable, "-m", *shlex.split(line)]
        subprocess.run(command, cwd=tmp_path, check=True, env=environment, stdout=subprocess.DEVNULL)
    for one in (tmp_path / "again").glob("*/*.json"):
        mine = json.loads((tmp_path / "studio" / one.relative_to(tmp_path / "again")).read_text())
        theirs = json.loads(one.read_text())
        for a, b in zip(mine.get("points", [mine]), theirs.get("points", [theirs]), strict=True):
            assert abs(a["period"] / b["period"] - 1) < 1e-12
            assert np.abs(np.array(a["state"]) - b["state"]).max() < 1e-12


@pytest.mark.needs("studio", "browser")
@browsing
@pytest.mark.slow
def test_a_click_on_a_return_finds_it_and_two_tabs_do_not_meet(server, tab, tmp_path):
    from selenium.webdriver.common.action_chains import ActionChains

    tab.drag(1, 60, -40, flick=True)
    assert tab.ask("return stage.rates()")[0] != 0  # it was let go of while it moved
    tab.drag(2, 40, -30)
    assert tab.ask("return stage.rates()") == [0, 0]
    second = Tab(server.address, tmp_path / "second")
    try:
        dots = tab.driver.find_elements("css selector", "#returns .points path")
        ActionChains(tab.driver).move_to_element(dots[0]).click().perform()
        second.click("find")
        for one in (tab, second):
            one.said("certified$|not an orbit$|no orbit")
        second.driver.quit()  # a browser that goes leaves what it found
        tab.click("find")
        tab.said("double-pendulum-3: certified")
        tab.click("save")
        tab.said("saved")
    finally:
        second.driver.quit()
    names = {one.parent.name for one in (tmp_path / "studio").glob("*/orbit.json")}
    assert names == {f"double-pendulum-{number}" for number in (1, 2, 3)}  # each written as it was found


@pytest.mark.needs("studio", "browser")
@browsing
@pytest.mark.slow
def test_a_section_to_start_from_and_a_search_beside_that_loses_nothing_when_it_is_killed(server, tab, tmp_path):
    from selenium.webdriver.common.action_chains import ActionChains

    from orbitfinder.atlas.store import Atlas

    for panel in ("beside", "background"):
        tab.open_panel(panel)
    before = set(children(server.process.pid))
    tab.click("search")
    tab.until("return /starts?, [1-9]\\d* orbit/.test(document.getElementById('search-about').innerText)")
    (searcher,) = [one for one in set(children(server.process.pid)) - before if "spawn" in _command(one)]
    tab.click("cut")  # and the page goes on meanwhile
    tab.said("section: \\d+ crossings")
    level = re.search(r"E = (-\d+\.\d+) J", tab.text("readout"))[1]
    assert f"at E = {level} J" in tab.text("cut-about")
    shown = tab.ask("return stage.shown")
    dots = tab.driver.find_elements("css selector", "#section .points path")
    ActionChains(tab.driver).move_to_element(dots[3]).click().perform()
    tab.until(f"return stage.shown > {shown}")
    assert f"E = {level} J" in tab.text("readout")

    os.kill(searcher, signal.SIGKILL)
    tab.until("return /stopped; the same search goes on/.test(document.getElementById('search-about').innerText)", 5.0)
    (file,) = (tmp_path / "studio").glob("*.sqlite")
    with Atlas(file) as book:
        kept = book.rows()
    assert kept and file.with_suffix(".toml").is_file()
    tab.ask("document.querySelector('#found button').click()")
    tab.said("orbit 1 of double-pendulum-")
    assert "Certified" in tab.text("badge")
    tab.click("follow")
    tab.said(r": \d+ orbits?$")
    tab.click("cancel")
    began = time.monotonic()
    tab.said("closed orbits|Stopped", 5.0)
    assert time.monotonic() - began < 0.5 * shared()
    assert tab.driver.get_log("browser") == []
    server.end(signal.SIGKILL)
    with Atlas(file) as book:
        assert book.rows()[: len(kept)] == kept or set(kept) <= set(book.rows())


def _command(process):
    return Path(f"/proc/{process}/cmdline").read_bytes().replace(b"\0", b" ").decode()


@pytest.mark.needs("studio", "browser")
@browsing
@pytest.mark.slow
def test_joints_of_a_linkage_are_pulled_as_far_as_its_bars_reach(tmp_path):
    server = Server(tmp_path, str(ROOT / "problems" / "linkages" / "four-bar-rocking.toml"))
    tab = Tab(server.address, tmp_path / "profile")
    try:
        before, place = tab.text("readout"), tab.ask("stage.rewind(); return stage.joint(1)")
        tab.drag(1, 20, 10)
        words = "document.getElementById('readout').innerText"
        tab.until(f"return /close return/.test({words}) && {words} !== {json.dumps(before)}")
        moved = tab.ask("stage.rewind(); return stage.joint(1)")
        assert 8 < np.hypot(*(np.array(moved) - place)) < 30
        assert tab.pulled_between(1, 20, 10) < 2
        tab.drag(1, 20, -20, flick=True)
        assert tab.driver.get_log("browser") == []
        tab.click("own")
        tab.said("certified", 150.0)
    finally:
        tab.driver.quit()
        server.end(signal.SIGKILL)
        server.log.close()


@pytest.mark.needs("studio", "browser")
@browsing
@pytest.mark.slow
def test_a_slider_goes_through_a_hopf_point_with_the_cycle_and_without(tmp_path):
    server = Server(tmp_path, str(ROOT / "problems" / "gallery" / "brusselator.toml"))
    tab = Tab(server.address, tmp_path / "profile")
    words = "document.getElementById('rest-about').innerText"
    seen = """const plot = document.getElementById('portrait');
      const d = plot.querySelector('.js-plotly-plot') || plot, x = d.data[0].x;"""
    try:
        tab.ask("document.querySelector('#parameters .q-item').click()")
        tab.until("return document.querySelector('#parameters [aria-label=rate]').offsetWidth > 0")
        tab.slide("rate", 0.1)  # of 1.5 to 4.5
        tab.until(f"return /rate = 1[.].*equilibrium stable.*; the motion comes to rest/.test({words})")
        assert tab.ask(f"{seen} return Math.max(...x) - Math.min(...x)") < 1e-3
        assert tab.ask(f"{seen} return d.data[1].marker.symbol") == "circle"
        tab.slide("rate", 0.3)
        tab.until(f"return /rate = 2[.].*equilibrium unstable.*; the motion does not come to rest/.test({words})")
        assert tab.ask(f"{seen} return Math.max(...x) - Math.min(...x)") > 1.0
        tab.click("find")
        tab.said("certified")
        tab.slide("rate", 0.25)
        tab.said("the orbit follows")
        tab.slide("rate", 0.1)  # where there is none
        tab.until(f"return /rate = 1[.].*the motion comes to rest/.test({words})")
        assert tab.text("about") == "" and tab.driver.get_log("browser") == []
    finally:
        tab.driver.quit()
        server.end(signal.SIGKILL)
        server.log.close()


@pytest.mark.needs("studio", "browser")
@browsing
@pytest.mark.slow
@pytest.mark.parametrize("dark", [False, True])
def test_nothing_is_cut_off_at_any_width(tab, dark):
    for width in (1440, 800, 360):
        tab.size(width, dark)
        tab.driver.refresh()
        tab.until("return window.stage && stage.shown > 0")
        assert tab.ask("return document.documentElement.scrollWidth <= innerWidth")
        assert tab.ask("return document.body.classList.contains('body--dark')") == dark
    nameless = """return [...document.querySelectorAll('button:not(#badge)')].filter(one => {
        const text = one.cloneNode(true);
        text.querySelectorAll('.q-icon').forEach(icon => icon.remove());
        return !one.ariaLabel && !text.textContent.trim(); }).length"""
    assert tab.ask(nameless) == 0 and tab.ask("return document.querySelectorAll('main').length") == 1
