"""Recordings: order of commands, downloads, segments, times, and what is refused.

Covered: upload, dispatch, clear and download in their order, also when they alternate; dispatches
that depend on each other; more passes than one query set holds; residents; running twice; empty
grids and empty arrays; marks and progress; times by stage from both clocks; nonsense timestamps.
"""

import numpy as np
import pytest

from gpusim.gpu import Device, Kernel, Recording, ShaderError
from gpusim.gpu import run as run_module
from gpusim.gpu.device import MAX_TICKS

TEXT = """
struct Params { n: u32, gain: f32, offset: f32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> a: array<f32>;
@group(0) @binding(2) var<storage, read_write> b: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x < params.n) { b[id.x] = a[id.x] * params.gain + params.offset; }
}
"""
N = 100
RAMP = np.arange(N, dtype=np.float32)


def affine(name: str = "tests/affine") -> Kernel:
    return Kernel.from_text(name, TEXT)


def step(rec: Recording, a, b, gain: float, offset: float, name: str = "tests/affine") -> None:
    kernel = affine(name)
    kernel.record(rec, kernel.cover(N), {"n": N, "gain": gain, "offset": offset}, a=a, b=b)


def pair(rec: Recording):
    return rec.buffer("a", N, np.float32), rec.buffer("b", N, np.float32)


def test_upload_dispatch_download(device: Device):
    rec = Recording(device)
    a, b = pair(rec)
    rec.upload(a, RAMP)
    step(rec, a, b, 2.0, 1.0)
    assert rec.download(b) == "b"
    result = rec.run()
    assert list(result) == ["b"]
    assert np.array_equal(result["b"], 2 * RAMP + 1)


def test_what_is_downloaded_as_other_numbers_has_the_same_values(device: Device):
    rec = Recording(device)
    a, _ = pair(rec)
    rec.upload(a, RAMP)
    label = rec.download(a, np.uint16)
    found = rec.run()[label]
    assert found.dtype == np.uint16 and np.array_equal(found, RAMP.astype(np.uint16))


def test_each_dispatch_sees_the_one_before_and_its_own_params(device: Device):
    rec = Recording(device)
    a, b = pair(rec)
    rec.upload(a, RAMP)
    for n in range(600):
        step(rec, a, b, 1.0, float(n))
        step(rec, b, a, 1.0, 1.0)
    rec.download(a)
    # Sums of integers below 2^24 are exact in f32.
    assert np.array_equal(rec.run()["a"], RAMP + 600 * 599 // 2 + 600)


def test_uploads_clears_and_copies_keep_their_place(device: Device):
    rec = Recording(device)
    a, b = pair(rec)
    c, d, e = (rec.buffer(name, N, np.float32) for name in "cde")
    rec.upload(a, RAMP)
    step(rec, a, b, 1.0, 0.0)
    rec.upload(a, 10 * RAMP)  # must not reach the dispatch before it
    step(rec, a, c, 1.0, 0.0)
    rec.clear(a)
    step(rec, a, d, 1.0, 5.0)
    step(rec, a, e, 1.0, 7.0)
    rec.download(b)
    rec.download(e)
    step(rec, a, e, 1.0, 9.0)  # after the copy
    rec.download(c)
    rec.download(d)
    result = rec.run()
    assert np.array_equal(result["b"], RAMP)
    assert np.array_equal(result["c"], 10 * RAMP)
    assert (result["d"] == 5).all()
    assert (result["e"] == 7).all()


def test_residents_and_proxies_are_used_alike(device: Device):
    source = device.resident("source", RAMP)
    target = device.empty("target", N, np.float32)
    rec = Recording(device)
    middle = rec.buffer("middle", N, np.float32)
    step(rec, source, middle, 3.0, 0.0)
    step(rec, middle, target, 1.0, 1.0)
    rec.run()
    assert np.array_equal(device.read(target), 3 * RAMP + 1)
    source.destroy()
    target.destroy()


def test_a_recording_may_run_again(device: Device):
    rec = Recording(device)
    a, b = pair(rec)
    rec.upload(a, RAMP)
    step(rec, a, b, 2.0, 0.0)
    rec.download(b)
    first, second = rec.run(), rec.run()
    assert first["b"] is not second["b"]
    assert np.array_equal(first["b"], second["b"])


def test_the_array_is_read_when_the_recording_runs(device: Device):
    array = RAMP.copy()
    rec = Recording(device)
    a = rec.buffer("a", N, np.float32)
    rec.upload(a, array)
    rec.download(a)
    array[:] = 3
    assert (rec.run()["a"] == 3).all()


def test_an_empty_grid_is_left_out(device: Device):
    rec = Recording(device)
    a, b = pair(rec)
    rec.upload(a, RAMP)
    rec.clear(b)
    affine().record(rec, (0, 1, 1), {"n": N, "gain": 1.0, "offset": 1.0}, a=a, b=b)
    rec.download(b)
    result = rec.run()
    assert (result["b"] == 0).all()
    assert result.times_s == {}


def test_arrays_without_elements_pass_through(device: Device):
    rec = Recording(device)
    a = rec.buffer("a", (0, 4), np.float32)
    b = rec.buffer("b", (0, 4), np.float32)
    rec.upload(a, np.zeros((0, 4), np.float32))
    rec.clear(b)
    affine().record(rec, (0, 1, 1), {"n": 0, "gain": 1.0, "offset": 1.0}, a=a, b=b)
    rec.download(b)
    assert rec.run()["b"].shape == (0, 4)


def test_progress_is_told_after_each_segment(device: Device):
    rec = Recording(device)
    a, b = pair(rec)
    rec.mark()  # an empty segment is none
    rec.upload(a, RAMP)
    step(rec, a, b, 2.0, 0.0)
    rec.mark()
    step(rec, b, a, 2.0, 0.0)
    rec.download(a)
    rec.mark()
    rec.download(b)
    told = []
    result = rec.run(lambda done, total: told.append((done, total)))
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert np.array_equal(result["a"], 4 * RAMP)
    assert np.array_equal(result["b"], 2 * RAMP)


def test_an_error_in_progress_gives_the_buffers_back(device: Device):
    rec = Recording(device)
    a, _ = pair(rec)
    rec.clear(a)
    before = device.pool.in_use

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rec.run(stop)
    assert device.pool.in_use == before


@pytest.fixture
def wall(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Switch the timestamps off for one test."""
    monkeypatch.setattr(device, "timestamps", False)


def two_stages(device: Device) -> Recording:
    rec = Recording(device)
    a, b = pair(rec)
    rec.upload(a, RAMP)
    step(rec, a, b, 2.0, 0.0, "tests/one")
    step(rec, b, a, 2.0, 0.0, "tests/two")
    step(rec, a, b, 2.0, 0.0, "tests/one")
    rec.download(b)
    return rec


def test_timestamps_give_positive_times_by_stage(device: Device):
    if not device.timestamps:
        pytest.skip("this adapter has no timestamp queries; the wall clock is tested below")
    result = two_stages(device).run()
    assert result.clock == "gpu"
    assert set(result.times_s) == {"tests/one", "tests/two"}
    assert all(0 < seconds < 1 for seconds in result.times_s.values())


def test_the_wall_clock_serves_where_there_are_no_timestamps(device: Device, wall: None):
    result = two_stages(device).run()
    assert result.clock == "wall"
    assert set(result.times_s) == {"tests/one", "tests/two"}
    assert all(0 < seconds < 1 for seconds in result.times_s.values())
    assert np.array_equal(result["b"], 8 * RAMP)


@pytest.mark.parametrize("nonsense", [-1e-6, 3600.0])
def test_nonsense_timestamps_are_not_believed(
    device: Device, monkeypatch: pytest.MonkeyPatch, nonsense: float
):
    monkeypatch.setattr(device, "timestamps", device.timestamps)  # restored after the test
    if not device.timestamps:
        pytest.skip("this adapter has no timestamp queries")
    monkeypatch.setattr(
        run_module, "spans_s", lambda ticks, tick_s: [1e-6] * (len(ticks) - 1) + [nonsense]
    )
    result = two_stages(device).run()
    assert result.clock == "wall"
    assert not device.timestamps
    assert all(0 < seconds < 1 for seconds in result.times_s.values())
    # Equal shares for the three passes of the segment.
    assert result.times_s["tests/one"] == pytest.approx(2 * result.times_s["tests/two"])


def test_spans_of_ticks():
    ticks = np.array([[10, 30], [7, 5], [2**63, 2**63 + 1], [6, 6], [0, 0]], np.uint64)
    spans = run_module.spans_s(ticks, 1e-3)
    assert spans[:4] == pytest.approx([0.02, -0.002, 0.001, 0.0])
    assert spans[4] < 0  # never written


def test_more_passes_than_one_query_set_holds(device: Device):
    passes = MAX_TICKS // 2 + 10
    rec = Recording(device)
    a, b = pair(rec)
    rec.upload(a, np.zeros(N, np.float32))
    for n in range(passes):
        step(rec, *((a, b) if n % 2 == 0 else (b, a)), 1.0, 1.0, f"tests/{n % 2}")
    rec.download(b if passes % 2 else a)
    result = rec.run()
    (last,) = result.values()
    assert (last == passes).all()
    assert set(result.times_s) == {"tests/0", "tests/1"}


def test_what_does_not_fit_is_refused_when_it_is_recorded(device: Device):
    rec = Recording(device)
    a, b = pair(rec)
    with pytest.raises(ShaderError, match="already has a buffer 'a'"):
        rec.buffer("a", 3, np.float32)
    with pytest.raises(ShaderError, match="dtype float64"):
        rec.buffer("c", 3, np.float64)
    with pytest.raises(ShaderError, match="shape"):
        rec.buffer("c", (-1, 3), np.float32)
    with pytest.raises(ShaderError, match="'a' is float32"):
        rec.upload(a, RAMP.astype(np.float64))
    with pytest.raises(ShaderError, match="'a' is read before it is written"):
        step(rec, a, b, 1.0, 0.0)
    with pytest.raises(ShaderError, match="'b' is read before it is written"):
        rec.download(b)
    rec.upload(a, RAMP)
    step(rec, a, b, 1.0, 0.0)
    rec.download(b)
    with pytest.raises(ShaderError, match="'b' is downloaded twice"):
        rec.download(b)
    other = Recording(device)
    with pytest.raises(ShaderError, match="'a' is of another recording"):
        other.clear(a)
    assert np.array_equal(rec.run()["b"], RAMP)  # the control: nothing of that was recorded
