"""Workers: the render of one process, whatever becomes of them."""

import os
import re
import signal
import urllib.error
import urllib.request
from contextlib import contextmanager
from functools import partial

import dask
import distributed
import mitsuba as mi
import numpy as np
import pytest
import xarray as xr
from dask.utils import parse_timedelta
from helpers.films_in_parts import OWN, ROUNDING, box, check_same, crop, in_tiles, names, render
from helpers.limits import lower
from helpers.processes import GUARD_S, wait_for
from helpers.refusals import one_line, refused
from helpers.support import with_film

import tofrender
from tofrender import local_workers
from tofrender.cli.options import Size
from tofrender.nlos import capture, reconstruct
from tofrender.rendering import workers
from tofrender.runtime import gpu
from tofrender.runtime.checkpoints import Checkpoint
from tofrender.scenes.packing import packed, unpacked

pytestmark = pytest.mark.filterwarnings("ignore:.*of the energy arrives outside")


@pytest.fixture(scope="module")
def cluster():
    """Two workers with a thread each."""
    with local_workers(2, threads=1) as client:
        yield client


@pytest.fixture
def client(cluster):
    """Those, both alive and as new."""
    cluster.wait_for_workers(2, timeout=GUARD_S)
    yield cluster
    cluster.wait_for_workers(2, timeout=GUARD_S)


def addresses(client) -> list[str]:
    return sorted(client.scheduler_info()["workers"])


def with_takes(client, wrapper, where=None) -> None:
    """Let some workers take pieces by `wrapper(take, job, piece)`; None as they always do."""

    def install(wrapper=wrapper):
        from tofrender.rendering import work_items

        def wrapped(j, piece, **options):
            return wrapper(partial(take, **options), j, piece)

        take = getattr(work_items, "own_render_item", work_items.render_item)
        work_items.own_render_item = take
        work_items.render_item = wrapped if wrapper else take

    client.run(install, workers=where)


@contextmanager
def taking(client, wrapper):
    """Let workers take pieces so for a while."""
    with_takes(client, wrapper)
    try:
        yield
    finally:
        client.wait_for_workers(2, timeout=GUARD_S)
        with_takes(client, None)


def die(take, job, piece):
    """Take no first piece of a film."""
    import os
    import signal

    if piece.y == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return take(job, piece)


def interrupt(monkeypatch) -> None:
    """Let Ctrl-C come when results are waited for once more."""
    following, calls = workers._next, []

    def interrupted(*arguments):
        calls.append(None)
        if len(calls) == 2:
            signal.raise_signal(signal.SIGINT)
        return following(*arguments)

    monkeypatch.setattr(workers, "_next", interrupted)


@pytest.mark.parametrize(
    ("described", "options"),
    [
        (box, {}),
        (lambda: with_film(box(), rfilter={"type": "gaussian"}, **crop(3, 2, 7, 6)), {"seed": 4}),
        (lambda: "nlos_z", {"spp": 64, "settings": {"width": 5, "height": 4}}),
        (lambda: "cornell_box", {"settings": {"width": 8, "height": 8, "temporal_bins": 50}}),
        (box, {"window": "auto", "bins": 30, "sampler": "padded_sobol"}),
        (lambda: box(12, 1), {}),
        (box, {"integrator": "transient_bdpt", "spp": 50}),
        (box, {"spp": 32, "errors": True}),
        (box, {"variant": "llvm_ad_spectral"}),
    ],
)
def test_workers_render_the_same(client, described, options):
    options = dict(options)
    mi.set_variant(options.pop("variant", mi.variant()))
    rounding = 1e-4 if {"integrator", "errors"} & set(options) else ROUNDING
    both = (render(described(), client=each, **options) for each in (client, None))
    check_same(*both, rounding)


def test_workers_write_tiles(client, tmp_path, monkeypatch):
    in_tiles(monkeypatch, 2)
    film = render(box(), client=client, out=tmp_path / "film.zarr")
    check_same(film, render(box()))
    assert names(tmp_path) == {"film.zarr"}


def test_numbers_of_threads_change_nothing(client):
    first = addresses(client)[0]
    client.run(os.environ.__setitem__, workers.THREADS, "2", workers=[first])
    try:
        check_same(render(box(), client=client), render(box()))
    finally:
        client.run(os.environ.__setitem__, workers.THREADS, "1", workers=[first])


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_spectral"])
def test_scenes_pack_as_they_are(variant):
    mi.set_variant(variant)
    turned = mi.ScalarTransform4f().look_at([0.3, 1, 4], [0, 0.3, 0], [0, 1, 0])
    turned = turned.rotate([0, 0.6, 0.8], 33).scale([0.3, 0.2, 5])
    pixels = mi.Bitmap(np.random.default_rng(1).uniform(0, 1, (3, 4, 3)).astype(np.float32))
    described = {"a": {"to_world": turned}, "b": [pixels, 2.5, "text"], "grid": Size(4, 3)}
    again = unpacked(packed("scene", described))
    assert again["grid"] == (4, 3)
    assert str(again["a"]["to_world"]) == str(turned)
    for part in ("matrix", "inverse_transpose"):
        one, other = (np.array(getattr(t, part)) for t in (turned, again["a"]["to_world"]))
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(np.array(again["b"][0]), np.array(pixels))
    assert again["b"][1:] == [2.5, "text"]


@pytest.mark.parametrize("streamed", [False, True])
def test_a_killed_worker_costs_its_piece(client, tmp_path, monkeypatch, streamed):
    in_tiles(monkeypatch, 2)
    mark = str(tmp_path / "killed")

    def die_once(take, job, piece):
        import os
        import signal

        if piece.y == 4:
            try:
                os.close(os.open(mark, os.O_CREAT | os.O_EXCL))
            except FileExistsError:
                pass
            else:
                os.kill(os.getpid(), signal.SIGKILL)
        return take(job, piece)

    before = set(client.run(os.getpid).values())
    options = {"out": tmp_path / "film.zarr"} if streamed else {}
    with taking(client, die_once):
        check_same(render(box(), client=client, **options), render(box()))
    assert names(tmp_path) == {"killed"} | ({"film.zarr"} if streamed else set())
    assert set(client.run(os.getpid).values()) != before


def test_a_worker_that_hangs_is_given_up(client, monkeypatch):
    in_tiles(monkeypatch, 1)
    lower(monkeypatch, worker_patience=2.0, worker_least_wait_s=1.0)
    hanging = addresses(client)[0]

    def hang(take, job, piece):
        import time

        time.sleep(1e6)

    with_takes(client, hang, [hanging])
    try:
        check_same(render(box(), client=client), render(box()))
    finally:
        for pid in client.run(os.getpid, workers=[hanging]).values():
            os.kill(pid, signal.SIGKILL)
        wait_for(lambda: hanging not in addresses(client))


def test_a_piece_that_kills_everybody_is_an_error(client):
    def allow(failures):
        client.run_on_scheduler(
            lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", failures)
        )

    allow(0)
    try:
        with taking(client, die), refused("workers died", RuntimeError):
            render(box(), client=client)
    finally:
        allow(3)


def test_killed_workers_have_time_to_come_back(client):
    """Those that take longer would be given up by the cluster."""
    given = dask.config.get("distributed.deploy.lost-worker-timeout")
    assert parse_timedelta(given) >= GUARD_S


def test_errors_of_workers_are_one_line(client):
    def fail(take, job, piece):
        raise MemoryError("no room for this")

    with taking(client, fail), refused("no room for this", MemoryError):
        render(box(), client=client)
    assert render(box(), client=client).attrs["complete"] == 1


def test_workers_of_other_versions_are_refused(client):
    def pretend(version):
        from tofrender.runtime import versions

        own = versions.__version__
        versions.__version__ = version
        return own

    (second,) = addresses(client)[1:]
    own = client.run(pretend, "0.0.7", workers=[second])[second]
    try:
        with pytest.raises(ValueError, match=r"^client: worker .* must have") as error:
            render(box(), client=client)
        assert "0.0.7" in one_line(error)
    finally:
        client.run(pretend, own, workers=[second])
    assert render(box(), client=client).attrs["complete"] == 1


def test_a_worker_that_ends_while_it_is_asked_is_left_out(client, monkeypatch):
    run, first = client.run, addresses(client)[0]
    closed = distributed.comm.CommClosedError("Stream is closed")
    monkeypatch.setattr(client, "run", lambda *given, **more: run(*given, **more) | {first: closed})
    assert workers.check_client(client) == 1


def test_workers_that_cannot_render_are_refused(client):
    def break_it(broken):
        from tofrender.runtime import backend

        def refuse(variant):
            raise backend.BackendError("no LLVM here")

        if broken:
            backend.own = backend.activate
        backend.activate = refuse if broken else backend.own

    (second,) = addresses(client)[1:]
    client.run(break_it, True, workers=[second])
    try:
        with pytest.raises(RuntimeError, match=f"^client: worker {second} cannot render: no LLVM"):
            render(box(), client=client)
    finally:
        client.run(break_it, False, workers=[second])


@pytest.mark.parametrize(
    ("argument", "value", "text"),
    [
        (
            "scene",
            lambda: tofrender.load_scene(box()),
            "scene = Scene: loaded objects cannot be sent",
        ),
        ("integrator", lambda: mi.load_dict({"type": "transient_path"}), "integrator = Transient"),
        ("sampler", lambda: mi.load_dict({"type": "independent"}), "sampler = Sampler"),
        ("client", lambda: 3, "client = 3: must be a distributed.Client"),
        ("scene", lambda: box() | {"ball": mi.load_dict({"type": "sphere"})}, "scene.ball = "),
        ("resume", lambda: render(box(), spp=4), "resume: must be left out"),
    ],
)
def test_what_cannot_be_sent_is_refused(client, argument, value, text):
    options = {"scene": box(), "client": client, argument: value()}
    with refused("^" + re.escape(text)) as error:
        render(options.pop("scene"), **options)
    assert re.search("must be|Pass a name or a dict", str(error.value))


def test_light_that_lands_anywhere_is_not_streamed_by_workers(client, tmp_path):
    options = {"integrator": "transient_bdpt", "out": tmp_path / "film.zarr"}
    with refused(r"^client: must be left out"):
        render(box(), client=client, **options)
    assert names(tmp_path) == set()


def test_strangers_cannot_reach_workers(client):
    """Neither without a certificate nor with another one; nor are there pages."""
    cluster = client.cluster
    servers = [client.scheduler.address, *(nanny.address for nanny in cluster.workers.values())]
    for address in [*servers, *addresses(client)]:
        assert address.startswith("tls://127.0.0.1:")
        for place, security in (
            (address.replace("tls", "tcp"), None),
            (address, distributed.Security.temporary()),
        ):
            with pytest.raises((OSError, TimeoutError)):
                distributed.Client(place, security=security, timeout=0.5)
    page = f"http://127.0.0.1:{cluster.scheduler.http_server.port}/info/main/workers.html"
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(page)


BROKEN = {"DRJIT_LIBLLVM_PATH": __file__}  # Environment in which no worker can start


def test_workers_that_cannot_start(monkeypatch):
    monkeypatch.setenv(*next(iter(BROKEN.items())))
    with refused(r"^workers: cannot start: .* not a", RuntimeError), local_workers(2):
        pass


def test_workers_that_cannot_start_again():
    with local_workers(1, threads=1) as client:
        with_takes(client, die)
        client.cluster.workers[0].process.env |= BROKEN
        with refused(r"all workers are lost.*0 of \d+ p", ConnectionError):
            render(box(), client=client)


def test_workers_beside_others(client):
    """A second scheduler on the machine takes no port that the first has."""
    with local_workers(1) as other:
        assert other.scheduler.address != client.scheduler.address
        assert other.submit(sum, [1, 2]).result() == 3


def test_a_client_keeps_pieces_as_often_as_asked(client, tmp_path, monkeypatch, capsys):
    """It ends after its second saving, as by a kill: nothing is saved on its way out."""
    in_tiles(monkeypatch, 2)
    path, save, saved = tmp_path / "box.npz", Checkpoint.save, []

    def killed(self, done, *arguments):
        save(self, done, *arguments)
        saved.append(done)
        if len(saved) == 2:
            raise SystemExit

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "due", True)
        patch.setattr(Checkpoint, "save", killed)
        with pytest.raises(SystemExit):
            render(box(), client=client, checkpoint=path)
    assert saved == [1, 2]
    with refused("was made with seed"):
        render(box(), client=client, checkpoint=path, seed=5)
    check_same(render(box(), client=client, checkpoint=path), render(box()))
    assert capsys.readouterr().out == "resuming from 2 of 9 pieces\n"


def test_ctrl_c_stops_workers(client, tmp_path, monkeypatch, capsys):
    in_tiles(monkeypatch, 2)
    path = tmp_path / "box.npz"
    with monkeypatch.context() as patch, refused(r"of 9 pieces", KeyboardInterrupt) as error:
        interrupt(patch)
        render(box(), client=client, checkpoint=path)
    assert str(path) in str(error.value)
    check_same(render(box(), client=client, checkpoint=path), render(box()))
    assert capsys.readouterr().out.startswith("resuming from ")


@pytest.mark.parametrize("mode", ["confocal", "single", "exhaustive"])
def test_captures_by_workers(client, mode):
    options = {"mode": mode, "grid": (3, 2), "spp": 16, "progress": False}
    found, whole = (capture("nlos_z", client=each, **options) for each in (client, None))
    attrs = ({k: v for k, v in each.attrs.items() if k not in OWN} for each in (found, whole))
    assert next(attrs) == next(attrs)
    xr.testing.assert_allclose(found, whole, rtol=1e-4, atol=1e-5 * float(whole["transient"].max()))


def test_an_exhaustive_capture_by_workers_goes_on(client, tmp_path, monkeypatch, capsys):
    options = {"mode": "exhaustive", "grid": (3, 2), "spp": 16, "progress": False}
    path = tmp_path / "z.npz"
    with monkeypatch.context() as patch, refused("^interrupted ", KeyboardInterrupt):
        interrupt(patch)
        capture("nlos_z", client=client, checkpoint=path, **options)
    found = capture("nlos_z", client=client, checkpoint=path, **options)
    assert capsys.readouterr().out.startswith("resuming from ")
    whole = capture("nlos_z", **options)
    assert abs(found["transient"] - whole["transient"]).max() <= 1e-5 * whole["transient"].max()


@pytest.fixture(scope="module")
def seen():
    return capture("nlos_z", grid=(4, 4), spp=16, progress=False)


@pytest.mark.parametrize("method", ["bp", "fbp"])
def test_reconstructions_by_workers(client, seen, method):
    found = reconstruct(seen, method, client=client, progress=False)["intensity"]
    whole = reconstruct(seen, method, progress=False)["intensity"]
    assert dict(found.sizes) == dict(whole.sizes)
    assert whole.max() > 0
    assert abs(found - whole).max() <= 1e-5 * whole.max()


def test_a_capture_of_a_loaded_scene_is_not_sent(client):
    with refused("scene = Scene: loaded objects"):
        capture(tofrender.load_scene("nlos_z", optimize=False), client=client, progress=False)


@pytest.mark.parametrize(
    ("variant", "devices", "count", "expected"),
    [
        ("llvm_ad_rgb", ["0"], 3, [None, None, None]),
        ("cuda_ad_mono", ["2", "GPU-a", "1"], 2, ["2", "GPU-a"]),
        ("cuda_ad_rgb", ["0"], 1, ["0"]),
        ("cuda_ad_rgb", ["0"], 2, "workers = 2: must be at most 1, the number of GPUs; .* llvm_"),
        ("cuda_ad_rgb", ["3", "1"], 3, "workers = 3: must be at most 2, the number of GPUs"),
        ("metal_ad_rgb", [], 1, [None]),
        ("metal_ad_rgb", [], 2, "workers = 2: must be at most 1, the number of GPUs"),
    ],
)
def test_each_worker_has_its_own_gpu(monkeypatch, variant, devices, count, expected):
    monkeypatch.setattr(mi, "variant", lambda: variant)
    monkeypatch.setattr(gpu, "devices", lambda: devices)
    if isinstance(expected, str):
        with refused(expected), local_workers(count):
            pass
    else:
        variables = workers.visible_devices(count)
        assert [each.get("CUDA_VISIBLE_DEVICES") for each in variables] == expected


def test_a_worker_sees_its_device_also_after_it_has_died(monkeypatch):
    """The processes are real, and the devices are names only, which LLVM does not read."""
    monkeypatch.setattr(
        workers, "visible_devices", lambda count: [{"CUDA_VISIBLE_DEVICES": d} for d in "75"]
    )

    def seen():
        import os

        return os.environ["CUDA_VISIBLE_DEVICES"]

    with local_workers(2, threads=1) as client:
        before = sorted(client.run(seen).values())
        first = addresses(client)[0]
        pid = client.run(os.getpid, workers=[first])[first]
        os.kill(pid, signal.SIGKILL)
        wait_for(lambda: first not in addresses(client))
        client.wait_for_workers(2, timeout=GUARD_S)
        after = sorted(client.run(seen).values())
    assert before == after == ["5", "7"]
