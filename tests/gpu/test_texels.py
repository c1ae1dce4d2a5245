"""Texels: a texture read as if it were a buffer, over the ends of its rows, and what is refused."""

import numpy as np
import pytest

from gpusim.gpu import Device, Kernel, Recording, ShaderError, Use
from gpusim.gpu.pool import MAX_BINDING_BYTES, TEXEL_ROW_BYTES, size_class

ROW = TEXEL_ROW_BYTES // 16  # texels
BACKWARDS = """
struct Params { count: u32, }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var numbers: texture_2d<f32>;
@group(0) @binding(2) var<storage, read_write> out: array<vec4f>;
#include "texels"
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x < params.count) {
        out[id.x] = texel(numbers, params.count - 1u - id.x);
    }
}
"""


def numbers(texels: int) -> np.ndarray:
    return np.random.default_rng(texels).random((texels, 4), np.float32)


def backwards(rec: Recording, source, count: int) -> np.ndarray:
    kernel = Kernel.from_text("backwards", BACKWARDS)
    out = rec.buffer("out", (count, 4), np.float32)
    kernel.record(rec, kernel.cover(count), {"count": count}, numbers=source, out=out)
    label = rec.download(out)
    return rec.run()[label]


# One texel; a row and less, and more; some rows and part of one; rows that fill a texture.
COUNTS = (1, ROW - 1, ROW, ROW + 1, 3 * ROW + 5, 6 * ROW)


@pytest.mark.parametrize("count", COUNTS)
def test_uploaded_texels_are_read_in_their_order(device: Device, count: int):
    given = numbers(count)
    resident = device.resident("numbers", given, Use.TEXELS)
    assert np.array_equal(backwards(Recording(device), resident, count), given[::-1])
    assert np.array_equal(device.read(resident), given)
    resident.destroy()


@pytest.mark.parametrize("count", COUNTS)
def test_copied_texels_are_those_of_the_buffer(device: Device, count: int):
    """The memory was used by another recording: what it left is not read."""
    for given in (numbers(count), -numbers(count)):
        rec = Recording(device)
        buffer = rec.buffer("buffer", given.shape, np.float32)
        texels = rec.buffer("texels", given.shape, np.float32, Use.TEXELS)
        rec.upload(buffer, given)
        rec.copy(buffer, texels)
        assert np.array_equal(backwards(rec, texels, count), given[::-1])


def test_an_upload_is_read_without_a_copy(device: Device):
    given, rec = numbers(ROW + 7), Recording(device)
    texels = rec.buffer("texels", given.shape, np.float32, Use.TEXELS)
    rec.upload(texels, given)
    assert np.array_equal(backwards(rec, texels, len(given)), given[::-1])


def test_textures_have_whole_rows_no_power_of_two_and_fit_an_adapter(device: Device):
    largest = MAX_BINDING_BYTES // TEXEL_ROW_BYTES
    for rows, expected in ((0.01, 3), (1, 3), (2, 3), (3, 3), (4, 5), (5.1, 6), (63.5, 65)):
        size = size_class(int(rows * TEXEL_ROW_BYTES), Use.TEXELS)
        assert size == expected * TEXEL_ROW_BYTES
    assert size_class(MAX_BINDING_BYTES, Use.TEXELS) == (largest + 1) * TEXEL_ROW_BYTES
    assert largest < device.gpu.limits["max-texture-dimension-2d"] == 8192


def test_memory_goes_back_to_the_pool(device: Device):
    pool = device.pool
    before, given = pool.in_use, numbers(3 * ROW)
    resident = device.resident("numbers", given, Use.TEXELS)
    assert pool.in_use == before + 3 * TEXEL_ROW_BYTES
    first = resident.buffer
    resident.destroy()
    assert pool.in_use == before
    again = device.resident("again", given, Use.TEXELS)
    assert again.buffer is first
    buffer = device.resident("buffer", given)  # of the same size, but no texture
    assert buffer.buffer is not first
    again.destroy()
    buffer.destroy()


def test_what_texels_cannot_be_is_refused(device: Device):
    rec = Recording(device)
    with pytest.raises(ShaderError, match="four float32"):
        rec.buffer("three", 3, np.float32, Use.TEXELS)
    with pytest.raises(ShaderError, match="four float32"):
        rec.buffer("words", 4, np.uint32, Use.TEXELS)
    buffer = rec.buffer("buffer", 8, np.float32)
    texels = rec.buffer("texels", 8, np.float32, Use.TEXELS)
    fewer = rec.buffer("fewer", 4, np.float32, Use.TEXELS)
    rec.upload(buffer, np.zeros(8, np.float32))
    for source, target in ((texels, buffer), (buffer, fewer), (buffer, buffer)):
        with pytest.raises(ShaderError, match="cannot be copied"):
            rec.copy(source, target)
    with pytest.raises(ShaderError, match="upload and copy"):
        rec.clear(texels)
    rec.copy(buffer, texels)
    with pytest.raises(ShaderError, match="download that"):
        rec.download(texels)


def test_a_buffer_is_no_texels_and_texels_are_no_buffer(device: Device):
    kernel, rec = Kernel.from_text("backwards", BACKWARDS), Recording(device)
    buffer = rec.buffer("buffer", 4, np.float32)
    texels = rec.buffer("texels", 4, np.float32, Use.TEXELS)
    for given, out, name in ((buffer, buffer, "numbers"), (texels, texels, "out")):
        with pytest.raises(ShaderError, match=f"{name}: "):
            kernel.record(rec, (1, 1, 1), {"count": 1}, numbers=given, out=out)


def test_more_textures_than_every_adapter_has_are_refused():
    more = "\n".join(f"@group(0) @binding({n}) var t{n}: texture_2d<f32>;" for n in range(3, 19))
    with pytest.raises(ShaderError, match="17 textures, every adapter has only 16"):
        Kernel.from_text("many", BACKWARDS.replace("#include", more + "\n#include"))
