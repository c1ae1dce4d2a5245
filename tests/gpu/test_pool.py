"""Size classes, reuse, counters and the budget of the buffer pool."""

import numpy as np
import pytest

from gpusim.errors import UserError
from gpusim.gpu import Device, Recording, ShaderError
from gpusim.gpu.pool import MAX_BINDING_BYTES, Pool, Use, size_class

MIB = 1 << 20


@pytest.fixture
def pool(device: Device) -> Pool:
    """Make a pool of its own with a budget of 4 MiB."""
    made = Pool(device.gpu, 4 * MIB)
    yield made
    made.clear()


@pytest.mark.parametrize(
    ("nbytes", "size"),
    [(0, 256), (1, 256), (256, 256), (257, 384), (384, 384), (385, 512), (513, 768), (769, 1024)],
)
def test_size_classes(nbytes: int, size: int):
    assert size_class(nbytes) == size


def test_the_largest_binding_is_a_class_of_its_own():
    assert size_class(MAX_BINDING_BYTES) == MAX_BINDING_BYTES


def test_a_returned_buffer_serves_the_next_request_of_its_class(pool: Pool):
    first = pool.acquire("a", 1000)
    assert (pool.in_use, pool.idle, pool.misses, pool.hits) == (1024, 0, 1, 0)
    second = pool.acquire("b", 1000)
    assert second is not first
    pool.release(first)
    assert (pool.in_use, pool.idle) == (1024, 1024)
    assert pool.acquire("c", 800) is first
    assert (pool.in_use, pool.idle, pool.peak) == (2048, 0, 2048)
    assert (pool.misses, pool.hits) == (2, 1)
    pool.release(first)
    pool.release(second)


def test_buffers_of_another_use_are_not_exchanged(pool: Pool):
    data = pool.acquire("a", 1000)
    pool.release(data)
    staging = pool.acquire("b", 1000, Use.READBACK)
    assert staging is not data
    pool.release(staging)


def test_the_budget_holds_what_fits_and_refuses_the_next_byte(pool: Pool):
    held = [pool.acquire("a", 2 * MIB), pool.acquire("b", 2 * MIB)]
    with pytest.raises(UserError, match="GPU memory budget") as caught:
        pool.acquire("one more", 1)
    assert caught.value.value == "4.0 MiB, 4.0 MiB of it in use"
    assert "at least 4.0 MiB" in caught.value.allowed
    assert pool.in_use == 4 * MIB
    for one in held:
        pool.release(one)


def test_kept_buffers_give_way_to_a_new_size(pool: Pool):
    pool.release(pool.acquire("a", 3 * MIB))
    assert pool.idle == 3 * MIB
    wide = pool.acquire("b", 4 * MIB)
    assert (pool.in_use, pool.idle) == (4 * MIB, 0)
    pool.release(wide)


def test_a_buffer_larger_than_any_binding_is_refused(device: Device):
    with pytest.raises(UserError, match="larger than one binding") as caught:
        device.pool.acquire("frame", MAX_BINDING_BYTES + 4)
    assert "128.0 MiB" in caught.value.allowed


def test_residents_count_until_they_are_destroyed(device: Device):
    before = device.pool.in_use
    one = device.resident("one", np.zeros((16, 16), np.float32))
    assert device.pool.in_use == before + 1024
    one.destroy()
    one.destroy()
    assert device.pool.in_use == before
    with pytest.raises(ShaderError, match="'one' is used after destroy"):
        device.read(one)


def test_a_recording_over_the_budget_gives_everything_back(
    device: Device, monkeypatch: pytest.MonkeyPatch
):
    rec = Recording(device)
    for n in range(3):
        rec.clear(rec.buffer(f"b{n}", MIB, np.float32))
    before = device.pool.in_use
    monkeypatch.setattr(device.pool, "budget", before + 10 * MIB)
    with pytest.raises(UserError, match="'b2'"):
        rec.run()
    assert device.pool.in_use == before
    monkeypatch.setattr(device.pool, "budget", before + 13 * MIB)
    rec.run()  # the control: 12 MiB and the params fit
    assert device.pool.in_use == before
