// Philox4x32-10: a counter-based generator on u32 (Salmon, Moraes, Dror & Shaw 2011, "Parallel random numbers:
// as easy as 1, 2, 3", section 3.3 and the multipliers and Weyl constants of their reference implementation).
//
// Use: words = philox(vec4u(col, row, frame, purpose + draw), key). Every random number is a pure function of
// its counter and key, so tiles, order and adapter never change it. Where a purpose needs one word a pixel, one call
// serves the four pixels 4q .. 4q+3 of a row: counter.x = q, and pixel col takes word col % 4.

// Purposes: the upper half of counter.w; the lower half counts draws. Temporal noise is keyed by the capture's seed and
// counts frames; what belongs to the sensor is keyed by its serial number, with frame 0. What rows and columns have in
// common takes the first call of the row, or the first row.
const PURPOSE_SHOT = 0x10000u;            // seed
const PURPOSE_READ = 0x20000u;            // seed
const PURPOSE_PRNU = 0x30000u;            // serial number
const PURPOSE_DSNU = 0x40000u;            // serial number
const PURPOSE_PRNU_ROW = 0x50000u;        // serial number
const PURPOSE_PRNU_COLUMN = 0x60000u;     // serial number
const PURPOSE_DSNU_ROW = 0x70000u;        // serial number
const PURPOSE_DSNU_COLUMN = 0x80000u;     // serial number
const PURPOSE_ROW_NOISE = 0x90000u;       // seed
const PURPOSE_COLUMN_NOISE = 0xA0000u;    // seed
const PURPOSE_RESET = 0xB0000u;           // seed
const PURPOSE_DARK_CURRENT = 0xC0000u;    // serial number
const PURPOSE_COLUMN = 0x200000u;         // serial number: offset of a column's converter; row 0

// The upper 32 bits of a * b, by 16-bit halves; no partial sum exceeds 32 bits.
fn multiply_high(a: u32, b: u32) -> u32 {
    let a_low = a & 0xFFFFu;
    let a_high = a >> 16u;
    let b_low = b & 0xFFFFu;
    let b_high = b >> 16u;
    let carry = a_high * b_low + ((a_low * b_low) >> 16u);
    let middle = a_low * b_high + (carry & 0xFFFFu);
    return a_high * b_high + (carry >> 16u) + (middle >> 16u);
}

fn philox(counter: vec4u, key: vec2u) -> vec4u {
    var c = counter;
    var k = key;
    for (var round = 0u; round < 10u; round++) {
        c = vec4u(
            multiply_high(0xCD9E8D57u, c.z) ^ c.y ^ k.x,
            0xCD9E8D57u * c.z,
            multiply_high(0xD2511F53u, c.x) ^ c.w ^ k.y,
            0xD2511F53u * c.x,
        );
        k += vec2u(0x9E3779B9u, 0xBB67AE85u);
    }
    return c;
}
