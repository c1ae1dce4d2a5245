"""Size classes, reuse, counters and the budget of the buffer pool."""

import numpy as np
import pytest
import wgpu

from gpusim.gpu import Device, OutOfMemoryError, Recording, ShaderError
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
    with pytest.raises(OutOfMemoryError, match="GPU memory budget") as caught:
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


def test_no_more_gives_way_than_must(pool: Pool):
    held = [pool.acquire("a", MIB) for _ in range(3)]
    for one in held:
        pool.release(one)
    wide = pool.acquire("b", 2 * MIB)
    assert (pool.in_use, pool.idle) == (2 * MIB, 2 * MIB)
    pool.release(wide)


def test_a_buffer_larger_than_any_binding_is_refused(device: Device):
    with pytest.raises(OutOfMemoryError, match="larger than one binding") as caught:
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
    device.pool.clear()  # or what other tests left there would serve, whatever the budget
    before = device.pool.in_use
    monkeypatch.setattr(device.pool, "budget", before + 10 * MIB)
    with pytest.raises(OutOfMemoryError, match="'b2'"):
        rec.run()
    assert device.pool.in_use == before
    monkeypatch.setattr(device.pool, "budget", before + 13 * MIB)
    rec.run()  # the control: 12 MiB and the params fit
    assert device.pool.in_use == before


def test_the_peak_counts_what_is_kept_for_reuse_too(pool: Pool):
    pool.release(pool.acquire("a", MIB))
    held = pool.acquire("b", 2 * MIB)
    assert (pool.in_use, pool.idle, pool.peak) == (2 * MIB, MIB, 3 * MIB)
    pool.release(held)


def test_another_budget_holds_for_a_while(pool: Pool):
    held = pool.acquire("a", MIB)
    pool.release(pool.acquire("b", 2 * MIB))
    with pool.within(2 * MIB):
        assert (pool.budget, pool.idle, pool.peak) == (2 * MIB, 0, MIB)  # the rest was given back
        with pytest.raises(OutOfMemoryError):
            pool.acquire("c", 2 * MIB)
        pool.release(pool.acquire("c", MIB))
        assert pool.peak == 2 * MIB
    assert pool.budget == 4 * MIB
    pool.release(held)


class Adapter:
    """A device that has only so many bytes, and counts them as buffers come and go."""

    def __init__(self, device: Device, nbytes: int) -> None:
        self.device, self.left = device.gpu, nbytes

    def create_buffer(self, *, label: str, size: int, usage: int) -> object:
        """Return a buffer, or say that there is no memory."""
        if size > self.left:
            raise wgpu.GPUOutOfMemoryError("Not enough memory left.")
        self.left -= size
        buffer = self.device.create_buffer(label=label, size=size, usage=usage)
        adapter = self

        class Buffer:
            def __init__(self) -> None:
                self.size, self.usage = size, usage

            def destroy(self) -> None:
                adapter.left += size
                buffer.destroy()

        return Buffer()


def test_what_is_kept_is_given_back_to_an_adapter_without_memory(device: Device):
    pool = Pool(Adapter(device, 3 * MIB), 100 * MIB)
    held = [pool.acquire("a", MIB), pool.acquire("b", MIB)]
    pool.release(held.pop())
    # Two more do not fit beside the one kept for reuse, but in its place.
    held.append(pool.acquire("c", 2 * MIB))
    assert (pool.in_use, pool.idle) == (3 * MIB, 0)
    with pytest.raises(OutOfMemoryError, match="no memory left for the buffer 'd'") as caught:
        pool.acquire("d", MIB)
    assert caught.value.value == "1.0 MiB beside 3.0 MiB in use"
    for one in held:
        pool.release(one)
    pool.clear()
