"""Tests of the page of ``isoparticles view``."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

HERE = Path(__file__).parent
MISSING = [name for name in ("trame", "trame_vtk", "aiohttp") if importlib.util.find_spec(name) is None]
pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"{', '.join(MISSING)}: not installed (extra view)")
BALL = "ball:16,11.5,11.5,3=0.8"
LIBRARY = "info: Vue.use"
"""A message that the client of trame writes on the console when a library is loaded."""


@pytest.fixture(scope="session")
def iso(site: Path) -> ModuleType:
    sys.path[:0] = [str(site), str(HERE)]
    return importlib.import_module("isoparticles")


@pytest.fixture(scope="session")
def mesh(iso: ModuleType) -> Any:
    return iso.mesh(labels(), labels=[1], size=2, backend="cpu", name="ball")


@pytest.fixture
def session(iso: ModuleType, mesh: Any, tmp_path: Path) -> Any:
    mesh.save(tmp_path)
    return opened(iso, tmp_path)


def labels() -> np.ndarray:
    x, y, z = np.mgrid[:24, :24, :24] - 11.5
    return (x**2 + y**2 + z**2 < 7.0**2).astype(np.uint8)


def opened(iso: ModuleType, folder: Path) -> Any:
    return importlib.import_module("isoparticles.viewer.session").Session(iso.Mesh.open(folder, "ball"), folder)


def request(text: str) -> Any:
    return importlib.import_module("isoparticles.viewer.session").parse(text)


def journal(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "ball.view.json").read_text())


def test_undo_returns_the_same_arrays(session: Any, tmp_path: Path) -> None:
    before = session.mesh
    vertices, triangles = before.result.vertices.copy(), before.result.triangles.copy()
    session.add(request(BALL))
    assert journal(tmp_path)["pending"] == [BALL]
    session.apply()
    assert len(session.mesh.result.vertices) > len(vertices)
    assert (journal(tmp_path)["applied"], journal(tmp_path)["pending"]) == ([[BALL]], [])
    session.undo()
    assert session.mesh is before
    np.testing.assert_array_equal(session.mesh.result.vertices, vertices)
    np.testing.assert_array_equal(session.mesh.result.triangles, triangles)
    assert (journal(tmp_path)["applied"], journal(tmp_path)["pending"]) == ([], [BALL])


def test_a_stopped_update_changes_nothing(session: Any, tmp_path: Path) -> None:
    run = importlib.import_module("isoparticles.viewer.run")
    session.add(request(BALL))
    before, job = session.mesh, run.Job("update")
    job.stop()
    job.start(lambda: session.apply(job.progress)).wait()
    assert job.was_stopped
    assert job.error is None
    assert session.mesh is before
    assert journal(tmp_path)["pending"] == [BALL]


def test_a_killed_session_is_restored(iso: ModuleType, session: Any, tmp_path: Path) -> None:
    other = "ball:7,11.5,11.5,3=1"
    session.add(request(BALL))
    session.apply()
    session.add(request(other))
    vertices = session.mesh.result.vertices
    again = opened(iso, tmp_path)
    assert again.waiting == [[BALL]]
    again.resume()
    np.testing.assert_array_equal(again.mesh.result.vertices, vertices)
    assert [one.text for one in again.pending] == [other]
    again.undo()
    assert len(again.mesh.result.vertices) < len(vertices)


def test_saved_updates_are_part_of_the_files(iso: ModuleType, session: Any, tmp_path: Path) -> None:
    session.add(request(BALL))
    session.apply()
    session.save()
    again = opened(iso, tmp_path)
    np.testing.assert_array_equal(again.mesh.result.vertices, session.mesh.result.vertices)
    assert (again.waiting, again.resize()) == ([], BALL)
    # the stages make the surface anew, without the updates
    session.meshes[0].save(tmp_path, overwrite=True)
    anew = opened(iso, tmp_path)
    assert ([one.text for one in anew.pending], anew.resize()) == ([BALL], "")
    assert "made anew" in anew.note
    # or with them
    module = importlib.import_module("isoparticles.viewer.session")
    (tmp_path / "ball.view.json").unlink()
    same = module.Session(iso.Mesh.open(tmp_path, "ball"), tmp_path, BALL)
    assert (same.resize(), same.pending, same.journal.saved) == (BALL, [], [[BALL]])


def test_a_mesh_in_memory_has_no_updates_of_the_files(iso: ModuleType, mesh: Any, session: Any, tmp_path: Path) -> None:
    assert session.is_saved
    session.add(request(BALL))
    session.apply()
    session.save()
    module = importlib.import_module("isoparticles.viewer.session")
    again = module.Session(mesh, tmp_path)
    assert (again.journal.applied, [one.text for one in again.pending], again.is_saved) == ([], [BALL], False)
    assert "another mesh" in again.note
    again.save()
    assert again.is_saved
    np.testing.assert_array_equal(iso.Mesh.open(tmp_path, "ball").result.vertices, mesh.result.vertices)
    # a new folder does not contain the mesh
    assert not module.Session(mesh, tmp_path / "new").is_saved


def test_a_size_field_of_earlier_updates_is_ignored(iso: ModuleType, session: Any, tmp_path: Path) -> None:
    session.add(request(BALL))
    session.apply()
    session.save()
    updated = tmp_path / "updates" / "ball.sizefield.vti"
    content = updated.read_bytes()
    np.testing.assert_array_equal(iso.Mesh.open(tmp_path, "ball").size.array, session.mesh.size.array)
    session.meshes[0].save(tmp_path, overwrite=True)
    updated.write_bytes(content)
    np.testing.assert_array_equal(iso.Mesh.open(tmp_path, "ball").size.array, session.meshes[0].size.array)


def test_a_surface_with_a_failed_check_opens(iso: ModuleType, session: Any, tmp_path: Path) -> None:
    (tmp_path / "ball.surface.vtp").rename(tmp_path / "ball.surface.failed.vtp")
    again = opened(iso, tmp_path)
    np.testing.assert_array_equal(again.mesh.result.vertices, session.mesh.result.vertices)
    again.save()
    assert (tmp_path / "ball.surface.vtp").is_file()


@pytest.mark.usefixtures("iso")
def test_the_command_repeats_the_updates() -> None:
    module = importlib.import_module("isoparticles.viewer.session")
    settings = {"LABELS": "1", "MIN_SIZE": "2", "INPUT": "a b.nrrd", "RESIZE": "old"}
    assert module.command_line("surface", settings, "out", f"{BALL} mask:m.vti=1") == (
        f"isoparticles surface 'a b.nrrd' --labels 1 --min-size 2 --out out --resize '{BALL} mask:m.vti=1'"
    )


def test_a_painted_region_is_a_mask(session: Any, tmp_path: Path) -> None:
    case, paint = (importlib.import_module(f"isoparticles.viewer.{name}") for name in ("case", "paint"))
    region = paint.Paint(case.of_mesh(session.mesh, folder=tmp_path).scan)
    region.dab(np.array([17.0, 11.5, 11.5]), 2.5)
    # a ball of radius 2.5 voxels has 65.4 voxels
    assert 50 < region.count < 80
    name = region.write(session)
    assert name == "ball.region-1.vti"
    session.add(request(f"mask:{name}=0.9"))
    session.apply()
    sizes = importlib.import_module("isoparticles.viewer.session").size_at
    assert sizes(session.mesh, (17.0, 11.5, 11.5)) == pytest.approx(0.9, abs=0.05)
    assert session.resize() == f"mask:{tmp_path / name}=0.9"


def test_places_have_positions_near_the_mesh(mesh: Any) -> None:
    module = importlib.import_module("isoparticles.viewer.places")
    found = module.places_to_inspect(mesh, None, None)
    assert [place.kind for place in found] == ["worst triangle"]
    assert np.linalg.norm(np.array(found[0].position) - 11.5) == pytest.approx(7.0, abs=0.5)
    report = {"changes": {"events": [{"kind": "gone", "volume": 2.0, "place": [1, 2, 3]}]}, "missing": [[4, 5, 6]]}
    assert [(kind, place) for kind, place, _ in module.positions(report)] == [
        ("gone", [1, 2, 3]),
        ("missing", [4, 5, 6]),
    ]


def test_walls_thinner_than_h_are_found(iso: ModuleType) -> None:
    slab = np.zeros((30, 30, 12), dtype=np.uint8)
    slab[5:25, 5:25, 5:8] = 1
    coarse = iso.mesh(slab, labels=[1], size=5, scale=0, backend="cpu")
    module = importlib.import_module("isoparticles.viewer.places")
    walls = module.thin_walls(coarse)
    assert walls
    assert all(4.0 < place.position[2] < 9.0 for place in walls)
    assert not module.thin_walls(iso.mesh(labels(), labels=[1], size=2, backend="cpu"))


def test_slices_and_world_agree(mesh: Any) -> None:
    case, slices = (importlib.import_module(f"isoparticles.viewer.{name}") for name in ("case", "slices"))
    shown = case.of_mesh(mesh)
    made = slices.Slices(shown.scan, shown.key)
    made.show_surface(mesh.surface)
    for name, plane in made.planes.items():
        world = np.array([10.0, 13.0, 9.0])
        flat = plane.to_plane(shown.scan.to_index(world[None]))[0]
        back = plane.to_world(flat.tolist(), plane.layer_of(world.tolist()))
        np.testing.assert_allclose(back, world, atol=1e-9)
        assert made.outline(name, plane.count // 2).startswith("M")
        assert made.outline(name, 0) == ""


@pytest.mark.usefixtures("iso")
@pytest.mark.skipif(os.name != "posix", reason="sends an interrupt")
def test_stages_log_their_lines_and_can_be_stopped() -> None:
    run = importlib.import_module("isoparticles.viewer.run")
    script = "import sys, time; print('settle: 40 % 5 s\\n  nodes (9 %)', file=sys.stderr, flush=True); time.sleep(60)"
    job = run.StagesJob([sys.executable, "-c", script])
    job.run()
    while len(job.log) < 2:
        time.sleep(0.02)
    assert (job.text, job.share, job.is_running) == ("settle: 40 % 5 s", 0.4, True)
    job.stop()
    job.wait()
    assert job.was_stopped
    assert job.error is None
    assert job.code == -signal.SIGINT


@pytest.mark.usefixtures("iso")
def test_the_error_of_a_stage_is_that_of_the_job() -> None:
    run = importlib.import_module("isoparticles.viewer.run")
    error = "error: a.nrrd: no voxel\n  why it matters: nothing to mesh\n  what to do: set ISO"
    job = run.StagesJob([sys.executable, "-c", f"import sys; print({error!r}); sys.exit(2)"])
    job.run().wait()
    assert (job.error.what, job.error.why, job.error.next) == ("a.nrrd: no voxel", "nothing to mesh", "set ISO")


# --- The server -----------------------------------------------------------------------------------


@contextlib.contextmanager
def serving(site: Path, folder: Path, *words: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Run the page in a program of its own; yield its address."""
    environment = {**os.environ, "PYTHONPATH": str(site)}
    command = [sys.executable, "-m", "isoparticles", "view", *words]
    with (folder / "server.log").open("w") as log:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=log, text=True)
        try:
            assert process.stdout is not None
            found = re.search(r"http://\S+", process.stdout.readline())
            assert found is not None, (folder / "server.log").read_text()
            wait_for_port(found.group())
            yield found.group(), process
        finally:
            process.kill()
            process.wait()


def wait_for_port(address: str) -> None:
    port = int(address.split(":")[2].split("/")[0])
    for _ in range(300):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        time.sleep(0.1)
    raise TimeoutError(address)


@pytest.fixture(scope="session")
def case_folder(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a volume and the results of its case in ``out/ball``."""
    import pyvista

    folder = tmp_path_factory.mktemp("case")
    image = pyvista.ImageData(dimensions=(24, 24, 24))
    image.point_data["labels"] = labels().flatten(order="F")
    image.save(folder / "ball.vti")
    words = ["surface", "ball.vti", "--labels", "1", "--size", "2", "--backend", "cpu", "-o", "out", "-q"]
    environment = {**os.environ, "PYTHONPATH": str(site)}
    command = [sys.executable, "-m", "isoparticles", *words]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if "tetmesh-check: not found" in done.stderr:
        pytest.skip("the command tetmesh-check is not installed")
    assert done.returncode == 0, done.stderr
    return folder


def test_requests_need_the_token_and_the_name_of_this_computer(site: Path, case_folder: Path) -> None:
    import asyncio

    import aiohttp

    async def ask(address: str) -> dict[str, int]:
        base, token = address.rsplit("/", 2)[0], address.rsplit("/", 2)[1]
        websocket = f"{base.replace('http', 'ws')}"
        found = {}
        async with aiohttp.ClientSession() as client:
            for name, url, headers in (
                ("page", address, {}),
                ("localhost", address, {"Host": "localhost"}),
                ("no token", f"{base}/index.html", {}),
                ("wrong token", f"{base}/{'0' * len(token)}/index.html", {}),
                ("root", f"{base}/", {}),
                ("other name", address, {"Host": "evil.example"}),
                ("similar name", address, {"Host": "127.0.0.1.evil.example:80"}),
            ):
                async with client.get(url, headers=headers, allow_redirects=False) as answer:
                    found[name] = answer.status
            for name, url, headers in (
                ("socket", f"{websocket}/{token}/ws", {}),
                ("socket without token", f"{websocket}/ws", {}),
                ("socket of another name", f"{websocket}/{token}/ws", {"Host": "evil.example"}),
            ):
                try:
                    async with client.ws_connect(url, headers=headers):
                        found[name] = 101
                except aiohttp.WSServerHandshakeError as error:
                    found[name] = error.status
        return found

    with serving(site, case_folder, "ball") as (address, _):
        assert address.startswith("http://127.0.0.1:")
        found = asyncio.run(ask(address))
    assert {name: status for name, status in found.items() if status != 403} == {
        "page": 200,
        "localhost": 200,
        "socket": 101,
    }


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["nowhere"], "nowhere: neither a case in out"),
        (["broken.nrrd"], "broken.nrrd"),
        (["ball", "--port", "{busy}"], "port {busy}"),
    ],
)
def test_errors_have_three_parts(site: Path, case_folder: Path, words: list[str], what: str) -> None:
    (case_folder / "broken.nrrd").write_text("NRRD0004\ntype: nothing\n")
    with socket.socket() as busy:
        busy.bind(("127.0.0.1", 0))
        busy.listen()
        port = str(busy.getsockname()[1])
        given = [word.replace("{busy}", port) for word in words]
        command = [sys.executable, "-m", "isoparticles", "view", *given]
        environment = {**os.environ, "PYTHONPATH": str(site)}
        done = subprocess.run(command, cwd=case_folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {what.replace('{busy}', port)}"), done.stderr
    assert "\n  why it matters: " in done.stderr
    assert "\n  what to do: " in done.stderr


def test_without_trame_the_error_names_the_extra(iso: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    viewer = importlib.import_module("isoparticles.viewer")
    monkeypatch.setattr(viewer, "find_spec", lambda _: None)
    with pytest.raises(iso.Error, match=r"isoparticles\[view\]"):
        iso.view("ball")


@pytest.mark.usefixtures("iso")
def test_a_notebook_serves_the_page_in_its_loop(mesh: Any) -> None:
    import asyncio

    import aiohttp

    case, page = (importlib.import_module(f"isoparticles.viewer.{name}") for name in ("case", "page"))

    async def ask() -> int:
        made = page.Page(case.of_mesh(mesh))
        made.start("task")
        await made.server.ready
        async with aiohttp.ClientSession() as client, client.get(made.address) as answer:
            return answer.status

    assert asyncio.run(ask()) == 200


def test_a_notebook_shows_a_folder_on_one_page(
    iso: ModuleType, mesh: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import asyncio

    import aiohttp

    frame = SimpleNamespace(IFrame=lambda address, **_: SimpleNamespace(address=address))
    monkeypatch.setitem(sys.modules, "IPython.display", frame)
    monkeypatch.setitem(sys.modules, "ipykernel", ModuleType("ipykernel"))

    async def statuses() -> list[int | None]:
        found: list[int | None] = []
        pages = []
        for folder in (tmp_path, tmp_path, None):
            pages.append(iso.view(mesh, folder=folder).page)
            await pages[-1].server.ready
        async with aiohttp.ClientSession() as client:
            for page in pages:
                try:
                    async with client.get(page.address) as answer:
                        found.append(answer.status)
                except aiohttp.ClientConnectionError:
                    found.append(None)
        pages[1].close()
        return found

    assert asyncio.run(statuses()) == [None, 200, 200]


@pytest.mark.parametrize("takes_port", [False, True])
def test_a_page_answers_as_soon_as_its_server_runs(mesh: Any, takes_port: bool) -> None:
    import asyncio

    import aiohttp

    case, page = (importlib.import_module(f"isoparticles.viewer.{name}") for name in ("case", "page"))

    async def ask() -> int:
        made = page.Page(case.of_mesh(mesh))
        if takes_port:
            # a page that ends before its server runs releases its port
            first = made
            first.start("task")
            first.close()
            made = page.Page(case.of_mesh(mesh), first.web.port)
        # a browser may connect before the loop of the notebook is free
        with socket.create_connection(("127.0.0.1", made.web.port), 1.0):
            made.start("task")
            async with aiohttp.ClientSession() as client, client.get(made.address) as answer:
                return answer.status

    assert asyncio.run(ask()) == 200


CELLS = [
    "import asyncio, urllib.request, isoparticles as iso",
    "get = lambda: urllib.request.urlopen(frame.src, timeout=10).status",
    "frame = iso.view('out/ball')",
    "port = frame.page.web.port; frame = iso.view('out/ball', port=port)",
    "assert await asyncio.to_thread(get) == 200",
    "assert frame.page.web.port == port",
    "assert len(frame.page.control.session.mesh.result.vertices) > 0",
]


@pytest.mark.timeout(120)
def test_cells_of_a_notebook_show_pages(site: Path, case_folder: Path) -> None:
    pytest.importorskip("ipykernel", reason="ipykernel: not installed")
    manager = importlib.import_module("jupyter_client.manager")
    environment = {**os.environ, "PYTHONPATH": str(site)}
    kernel, client = manager.start_new_kernel(cwd=str(case_folder), env=environment)
    try:
        # as "Run All", which requests all cells at once
        for cell in CELLS:
            client.execute(cell)
        answers = [client.get_shell_msg(timeout=60)["content"] for _ in CELLS]
        assert [(answer["status"], answer.get("evalue")) for answer in answers] == [("ok", None)] * len(CELLS)
    finally:
        client.stop_channels()
        kernel.shutdown_kernel(now=True)


@pytest.mark.skipif(os.name != "posix", reason="reads the mode of a file")
def test_a_second_server_is_refused(site: Path, case_folder: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(site)}
    second = [sys.executable, "-m", "isoparticles", "view", "out/ball"]
    with serving(site, case_folder, "ball") as (address, process):
        done = subprocess.run(second, cwd=case_folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: out/ball: process {process.pid} on "), done.stderr
    assert "\n  why it matters: " in done.stderr
    assert f"\n  what to do: open {address} " in done.stderr
    # the address contains the token
    assert (case_folder / "out" / "ball" / ".view.lock").stat().st_mode & 0o777 == 0o600


@pytest.mark.skipif(os.name != "posix", reason="uses flock")
def test_a_saved_mesh_is_shown(mesh: Any, tmp_path: Path) -> None:
    mesh.save(tmp_path / "saved", "ball")
    shown = importlib.import_module("isoparticles.viewer.case").open_case("saved", tmp_path)
    assert (shown.name, shown.folder) == ("ball", tmp_path / "saved")
    np.testing.assert_array_equal(shown.mesh.result.vertices, mesh.result.vertices)


def test_other_settings_of_a_case_are_kept(iso: ModuleType, session: Any, tmp_path: Path) -> None:
    session.save()
    (tmp_path / "ball.view.json").unlink(missing_ok=True)
    module = importlib.import_module("isoparticles.viewer.session")
    again = module.Session(iso.Mesh.open(tmp_path, "ball"), tmp_path, "points:near.csv mask:a.vti=1")
    assert again.resize() == f"points:near.csv mask:{tmp_path / 'a.vti'}=1"


def test_nothing_is_saved_during_a_run(iso: ModuleType, session: Any, tmp_path: Path) -> None:
    import fcntl

    session.add(request(BALL))
    session.apply()
    with (tmp_path / ".lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(iso.Error, match="a run of the stages"):
            session.save()
    session.save()
    assert opened(iso, tmp_path).resize() == BALL


def test_saving_leaves_unchanged_files(session: Any, tmp_path: Path) -> None:
    before = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("ball.*")}
    session.add(request(BALL))
    session.apply()
    session.save()
    changed = [name for name, when in before.items() if (tmp_path / name).stat().st_mtime_ns != when]
    assert sorted(changed) == ["ball.surface.vtp"]


@pytest.mark.usefixtures("iso")
@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="the administrator may write everywhere")
def test_a_read_only_folder_needs_no_lock(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    assert importlib.import_module("isoparticles.viewer.lock").take(tmp_path, "address") is None


# --- The page in a browser ------------------------------------------------------------------------


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Any]:
    devtools = importlib.import_module("devtools")
    if devtools.BROWSER is None:
        pytest.skip("no Chromium here (Debian: apt-get install chromium)")
    with devtools.Browser(tmp_path / "profile") as browser:
        yield browser


def count(browser: Any) -> int:
    return int(browser.evaluate("document.querySelector('.counts').textContent.split(' ')[0].replace(',', '')"))


@pytest.mark.timeout(300)
@pytest.mark.parametrize("drawn_by", ["browser", "server"])
def test_a_browser_refines_undoes_and_saves(
    iso: ModuleType, site: Path, case_folder: Path, browser: Any, drawn_by: str
) -> None:
    button = importlib.import_module("devtools").button
    folder = case_folder / "out" / "ball"
    (folder / "ball.view.json").unlink(missing_ok=True)
    with serving(site, case_folder, "ball") as (address, process):
        script = f"window.drawsInSoftware = {'true' if drawn_by == 'server' else 'false'}"
        browser.call("Page.addScriptToEvaluateOnNewDocument", source=script)
        browser.open(address)
        browser.wait(
            "document.querySelector('.axial image') && document.querySelector('.axial .outline')?.getAttribute('d')"
        )
        first = count(browser)
        browser.click("document.querySelectorAll('.tools label')[1]")
        browser.click("document.querySelector('.axial .slice')", 0.65, 0.5)
        browser.wait("document.querySelectorAll('.requests li').length === 1")
        browser.wait("document.querySelector('.axial circle')")
        # the ball fills the middle of the view
        browser.click("document.querySelector('.solid .view')", 0.5, 0.5)
        browser.wait("document.querySelectorAll('.requests li').length === 2")
        browser.click(button("Apply"))
        browser.wait("document.querySelector('.applied li')", 120)
        assert count(browser) > first
        browser.click(button("Undo"))
        browser.wait(f"document.querySelector('.counts').textContent.startsWith('{first} ')")
        browser.click(button("Apply"))
        browser.wait("document.querySelector('.applied li')", 120)
        refined = count(browser)
        browser.click(button("Save"))
        browser.wait("document.querySelector('.command textarea')")
        command = browser.evaluate("document.querySelector('.command textarea').value")
        assert "--labels 1" in command
        assert "--resize 'ball:" in command
        # keys move the cursor
        cursor = browser.evaluate("document.querySelector('.cursor').textContent")
        browser.evaluate("document.querySelector('.coronal .slice').focus()")
        browser.press("ArrowRight")
        browser.wait(f"document.querySelector('.cursor').textContent !== {cursor!r}")
        # every control has a name
        assert browser.evaluate(UNNAMED) == []
        assert [line for line in browser.console if not line.startswith(LIBRARY)] == []
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert len(iso.Mesh.open(folder, "ball").result.vertices) == refined
    assert len(json.loads((folder / "ball.view.json").read_text())["saved"]) == 1


def row(label: str) -> str:
    """Return the expression of the row of controls with a label."""
    return f"[...document.querySelectorAll('.row')].find(e => e.textContent.includes({label!r}))"


UNNAMED = """[...document.querySelectorAll('button, input, select, textarea, [tabindex]')].filter(e =>
  !(e.textContent.trim() || e.getAttribute('aria-label') || (e.labels && [...e.labels].some(l => l.textContent.trim())))
).filter(e => !e.closest('.view')).map(e => e.outerHTML.slice(0, 200))"""


PREDICTION = "document.querySelector('.prediction')"
VERTICES = f"{row('Vertices')}.children[1]"


def prediction(browser: Any) -> list[str]:
    return browser.evaluate("[...document.querySelectorAll('.prediction td:nth-child(2)')].map(e => e.textContent)")


@pytest.mark.timeout(300)
def test_a_browser_makes_the_surface_of_a_label(iso: ModuleType, site: Path, tmp_path: Path, browser: Any) -> None:
    import pyvista

    button = importlib.import_module("devtools").button
    image = pyvista.ImageData(dimensions=(24, 24, 24))
    image.point_data["labels"] = np.where(np.mgrid[:24, :24, :24][0] < 2, 2, labels()).flatten(order="F")
    image.save(tmp_path / "two.vti")
    with serving(site, tmp_path, "two.vti") as (address, _):
        browser.open(address)
        browser.wait(f"{PREDICTION}?.textContent.includes('MiB')")
        both = prediction(browser)
        browser.click("document.querySelectorAll('.labels input')[1]")
        browser.wait(f"!{PREDICTION}.textContent.includes({both[0]!r})")
        browser.click("[...document.querySelectorAll('.check')].find(e => e.textContent.includes('Derive'))")
        browser.wait(f"!{VERTICES}.disabled")
        browser.set(VERTICES, 5.3)
        browser.wait(f"{PREDICTION}.textContent.includes('200,000')")
        # the memory without the tetrahedra is about 1 kB for each vertex
        found = prediction(browser)
        assert re.fullmatch(r"about 2\d\d MiB", found[2]), found
        assert found[1].startswith("about ")
        assert browser.evaluate(UNNAMED) == []
        browser.click(button("Make the surface"))
        browser.wait("document.querySelector('.job')?.textContent.startsWith('particles')", 60)
        browser.wait("document.querySelector('progress')")
        browser.click(button("Stop"))
        browser.wait("document.querySelector('.job').textContent.startsWith('Stopped.')")
        browser.set(VERTICES, 2.7)
        browser.wait(f"{PREDICTION}.textContent.includes('about 500')")
        browser.click(button("Make the surface"))
        browser.wait("document.querySelector('.counts').textContent", 60)
        assert "two: passed" in browser.evaluate("document.querySelector('pre').textContent")
        assert 450 < count(browser) < 550
        browser.click(button("Place ball at"))
        browser.wait("document.querySelectorAll('.requests li').length === 1")
        browser.click(button("Apply"))
        browser.wait("document.querySelector('.applied li')", 60)
        browser.click(button("Save"))
        browser.wait("document.querySelector('.command textarea')")
        command = shlex.split(browser.evaluate("document.querySelector('.command textarea').value"))
        assert browser.evaluate("document.querySelector('.problem')") is None
        assert [line for line in browser.console if not line.startswith(LIBRARY)] == []
    saved = iso.Mesh.open(tmp_path / "out" / "two")
    environment = {**os.environ, "PYTHONPATH": str(site)}
    subprocess.run([sys.executable, "-m", *command], cwd=tmp_path, env=environment, check=True, capture_output=True)
    again = iso.Mesh.open(tmp_path / "out" / "two")
    np.testing.assert_array_equal(again.result.vertices, saved.result.vertices)


@pytest.mark.timeout(300)
def test_a_browser_previews_an_iso_value(site: Path, tmp_path: Path, browser: Any) -> None:
    import pyvista

    x, y, z = np.mgrid[:24, :24, :24] - 11.5
    image = pyvista.ImageData(dimensions=(24, 24, 24))
    image.point_data["grey"] = (10.0 - np.sqrt(x**2 + y**2 + z**2)).flatten(order="F")
    image.save(tmp_path / "grey.vti")
    iso_value = "document.querySelector('[aria-label=\"Iso value\"]')"
    outline = "document.querySelector('.axial .outline')?.getAttribute('d')"
    with serving(site, tmp_path, "grey.vti") as (address, _):
        browser.open(address)
        browser.wait(outline)
        browser.wait(f"{PREDICTION}.textContent.includes('MiB')")
        first, wider = browser.evaluate(outline), prediction(browser)
        browser.set(iso_value, 5)
        browser.wait(f"{outline} !== {first!r}")
        browser.wait(f"!{PREDICTION}.textContent.includes({wider[0]!r})")
        browser.set(iso_value, "''")
        browser.wait("document.querySelector('.hint') && document.body.textContent.includes('not a number')")
        assert prediction(browser) == ["", "", ""]
        browser.set(iso_value, 90)
        browser.wait(f"!{outline}")
        browser.click(importlib.import_module("devtools").button("Make the surface"))
        browser.wait("document.querySelector('.problem')", 60)
        assert "no voxel crosses iso value 90" in browser.evaluate("document.querySelector('.problem').textContent")
        assert [line for line in browser.console if not line.startswith(LIBRARY)] == []


@pytest.mark.timeout(300)
def test_a_closed_tab_does_not_stop_an_update(site: Path, case_folder: Path, tmp_path: Path) -> None:
    devtools = importlib.import_module("devtools")
    if devtools.BROWSER is None:
        pytest.skip("no Chromium here (Debian: apt-get install chromium)")
    (case_folder / "out" / "ball" / "ball.view.json").unlink(missing_ok=True)
    with serving(site, case_folder, "ball") as (address, _):
        with devtools.Browser(tmp_path / "one") as one:
            one.open(address)
            one.wait("document.querySelector('.axial image')")
            one.click(devtools.button("Place ball at"))
            one.wait("document.querySelectorAll('.requests li').length === 1")
            # a small h, so that the update takes longer than closing the tab
            one.set("document.querySelector('[aria-label=\"Radius in mm\"]')", 8)
            one.set(f"{row('Edge length')}.children[1]", 0.3)
            one.wait("document.querySelector('.requests').textContent.includes('radius 8 mm, h = 0.3 mm')")
            one.click(devtools.button("Apply"))
            one.wait("document.querySelector('.job')")
        with devtools.Browser(tmp_path / "two") as two:
            two.open(address)
            two.wait("document.querySelector('.applied li')", 120)
            assert two.evaluate("document.querySelectorAll('.requests li').length") == 0


@pytest.mark.timeout(300)
def test_a_killed_server_leaves_no_lock(site: Path, case_folder: Path, browser: Any) -> None:
    button = importlib.import_module("devtools").button
    (case_folder / "out" / "ball" / "ball.view.json").unlink(missing_ok=True)
    with serving(site, case_folder, "ball") as (address, process):
        browser.open(address)
        browser.wait("document.querySelector('.axial image')")
        browser.click(button("Place ball at"))
        browser.wait("document.querySelectorAll('.requests li').length === 1")
        browser.click(button("Apply"))
        browser.wait("document.querySelector('.applied li')", 60)
        browser.click(button("Save"))
        browser.wait("document.querySelector('.command')")
        saved = count(browser)
        browser.click("document.querySelectorAll('.tools label')[1]")
        browser.click("document.querySelector('.axial .slice')", 0.65, 0.5)
        browser.wait("document.querySelectorAll('.requests li').length === 1")
        browser.click(button("Apply"))
        browser.wait("document.querySelectorAll('.applied li').length === 2", 60)
        refined = count(browser)
        browser.click(button("Place ball at"))
        browser.wait("document.querySelectorAll('.requests li').length === 1")
        process.send_signal(signal.SIGKILL)
        process.wait()
        with serving(site, case_folder, "ball") as (again, _):
            browser.open(again)
            browser.wait("document.querySelectorAll('.applied li').length === 2", 60)
            browser.wait("document.querySelectorAll('.requests li').length === 1")
            assert count(browser) == refined > saved
            browser.click(button("Undo"))
            browser.wait("document.querySelectorAll('.requests li').length === 2")
            assert count(browser) == saved
            assert "--resize" in browser.evaluate("document.querySelector('.command textarea').value")
            # the first update is part of the file
            browser.wait(f"{button('Undo')}.disabled && {button('Undo')}.title.includes('part of the opened surface')")
