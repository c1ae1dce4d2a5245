// Numbers kept as a texture, four a texel and 2048 texels a row, and read as if it were a buffer.
// lavapipe fetches a texel of eight invocations at once; of a storage buffer it takes number by number for each: 1.8 to 2.4 G
// numbers/s of texels, 0.3 to 0.95 of a buffer (2 cores).

// Numbers 4 i .. 4 i + 3.
fn texel(numbers: texture_2d<f32>, i: u32) -> vec4f {
    return textureLoad(numbers, vec2u(i % 2048u, i / 2048u), 0);
}
