// Cross-talk: shares of a pixel's signal are found in the pixels around it.
//   out[r, c] = sum_ij share[site(r, c), i, j] in[r + i - K/2, c + j - K/2],   0 <= i, j < K
// share: of the signal of the pixel at [i, j] around a pixel of the site, what that pixel takes. Beyond the edge of the
// sensor lies what the nearest pixel of the same site sees, so that a flat field stays flat.
// Units: those of the input: electrons per second, or electrons.
// In: signal (from_rows, from_cols), the rectangle from `from_first`, which holds that of the output and K/2 pixels, or a
// filter pattern, around it, as far as the sensor goes. Out: spread (rows, cols). All rectangles count from the
// output's first pixel. shares (PY, QUADS, K, K): from that pixel on, four neighbouring columns side by side.
// An invocation takes two groups of four columns, which share their shares, and ROWS rows one after another, in sums for
// the K rows that a row of the input gives to: each of them is added up in the same order wherever a rectangle begins.
// Dispatch: (ceil(QUADS ceil(cols/(8 QUADS))/64), ceil(rows/ROWS), 1) workgroups of 64. Lavapipe, 2 cores, K = 3: 270 MP/s,
// 2.7 times as long as copying; pixel by pixel 5.2 times.

override K: u32 = 3u;        // 3, 5 or 7: side of the kernels
override PY: u32;            // rows and columns of the filter pattern
override PX: u32;
override QUADS: u32 = 1u;    // fours of columns after which the pattern is the same again

const ROWS = 16u;

struct Params {
    rows: u32,
    cols: u32,
    from_rows: i32,
    from_cols: i32,
    from_first: vec2i,   // row, column
    low: vec2i,          // first row, column of the sensor
    high: vec2i,         // last row, column of the sensor
}

// What ten columns of a row hold, or where in the row they lie.
struct Ten { a: vec4f, b: vec4f, c: vec2f }
struct Places { a: vec4u, b: vec4u, c: vec2u }
// For both groups of columns.
struct Both { left: vec4f, right: vec4f }
// The rows that are not done.
struct Sums { s0: Both, s1: Both, s2: Both, s3: Both, s4: Both, s5: Both, s6: Both }

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> shares: array<vec4f>;
@group(0) @binding(2) var<storage, read> signal: array<f32>;
@group(0) @binding(3) var<storage, read_write> spread: array<f32>;

// Where a row (axis 0) or column (1) lies in the input: beyond the sensor's edge the next of the same site.
fn source(at: i32, axis: u32, period: i32, first: i32, size: i32) -> u32 {
    let before = (max(params.low[axis] - at, 0) + period - 1) / period;
    let beyond = (max(at - params.high[axis], 0) + period - 1) / period;
    return u32(clamp(at + (before - beyond) * period - first, 0, size - 1));
}

fn place(col: i32) -> u32 {
    return source(col, 1u, i32(PX), params.from_first.y, params.from_cols);
}

fn places(col: i32) -> Places {
    var found = Places(vec4u(place(col), place(col + 1), place(col + 2), place(col + 3)), vec4u(0u), vec2u(0u));
    found.b.x = place(col + 4);
    found.b.y = place(col + 5);
    if (K > 3u) {
        found.b.z = place(col + 6);
        found.b.w = place(col + 7);
    }
    if (K > 5u) {
        found.c = vec2u(place(col + 8), place(col + 9));
    }
    return found;
}

fn load(row: u32, at: Places) -> Ten {
    let a = vec4f(signal[row + at.a.x], signal[row + at.a.y], signal[row + at.a.z], signal[row + at.a.w]);
    var b = vec4f(signal[row + at.b.x], signal[row + at.b.y], 0.0, 0.0);
    var c = vec2f(0.0);
    if (K > 3u) {
        b.z = signal[row + at.b.z];
        b.w = signal[row + at.b.w];
    }
    if (K > 5u) {
        c = vec2f(signal[row + at.c.x], signal[row + at.c.y]);
    }
    return Ten(a, b, c);
}

// Adds a row of K taps from shares[first] on.
fn add(sum: Both, x: Ten, y: Ten, first: u32) -> Both {
    let s0 = shares[first];
    let s1 = shares[first + 1u];
    let s2 = shares[first + 2u];
    var left = sum.left + s0 * x.a;
    var right = sum.right + s0 * y.a;
    left += s1 * vec4f(x.a.yzw, x.b.x);
    right += s1 * vec4f(y.a.yzw, y.b.x);
    left += s2 * vec4f(x.a.zw, x.b.xy);
    right += s2 * vec4f(y.a.zw, y.b.xy);
    if (K > 3u) {
        let s3 = shares[first + 3u];
        let s4 = shares[first + 4u];
        left += s3 * vec4f(x.a.w, x.b.xyz);
        right += s3 * vec4f(y.a.w, y.b.xyz);
        left += s4 * x.b;
        right += s4 * y.b;
    }
    if (K > 5u) {
        let s5 = shares[first + 5u];
        let s6 = shares[first + 6u];
        left += s5 * vec4f(x.b.yzw, x.c.x);
        right += s5 * vec4f(y.b.yzw, y.c.x);
        left += s6 * vec4f(x.b.zw, x.c);
        right += s6 * vec4f(y.b.zw, y.c);
    }
    return Both(left, right);
}

fn put(row: u32, col: u32, value: vec4f) {
    let at = row * params.cols + col;
    if (col + 3u < params.cols) {
        spread[at] = value.x;
        spread[at + 1u] = value.y;
        spread[at + 2u] = value.z;
        spread[at + 3u] = value.w;
        return;
    }
    for (var i = 0u; col + i < params.cols; i++) {
        spread[at + i] = value[i];
    }
}

// Takes row i of the input: the last of `next.s0`'s rows, the one before of s1's, and so on; `odd` is i modulo 2.
fn step(next: Sums, x: Ten, y: Ten, i: u32, odd: u32, quad: u32) -> Sums {
    // For a pattern of one or two rows it is known before the shader runs which shares these are: fewer loads.
    var row = i;
    if (PY <= 2u) {
        row = odd;
    }
    row += PY * K - (K - 1u);   // of the same site, and not negative
    var sums = next;
    sums.s0 = add(sums.s0, x, y, (((row % PY) * QUADS + quad) * K + K - 1u) * K);
    sums.s1 = add(sums.s1, x, y, ((((row + 1u) % PY) * QUADS + quad) * K + K - 2u) * K);
    sums.s2 = add(sums.s2, x, y, ((((row + 2u) % PY) * QUADS + quad) * K + K - 3u) * K);
    if (K > 3u) {
        sums.s3 = add(sums.s3, x, y, ((((row + 3u) % PY) * QUADS + quad) * K + K - 4u) * K);
        sums.s4 = add(sums.s4, x, y, ((((row + 4u) % PY) * QUADS + quad) * K + K - 5u) * K);
    }
    if (K > 5u) {
        sums.s5 = add(sums.s5, x, y, ((((row + 5u) % PY) * QUADS + quad) * K + K - 6u) * K);
        sums.s6 = add(sums.s6, x, y, ((((row + 6u) % PY) * QUADS + quad) * K + K - 7u) * K);
    }
    return sums;
}

// The first sum is done; the others move up.
fn shifted(sums: Sums) -> Sums {
    let none = Both(vec4f(0.0), vec4f(0.0));
    if (K > 5u) {
        return Sums(sums.s1, sums.s2, sums.s3, sums.s4, sums.s5, sums.s6, none);
    }
    if (K > 3u) {
        return Sums(sums.s1, sums.s2, sums.s3, sums.s4, none, none, none);
    }
    return Sums(sums.s1, sums.s2, none, none, none, none, none);
}

fn finish(sum: Both, i: u32, first: u32, col: u32, next: u32) {
    let done = first + i - (K - 1u);
    if (i >= K - 1u && done < params.rows) {
        put(done, col, sum.left);
        if (next < params.cols) {
            put(done, next, sum.right);
        }
    }
}

fn input_row(at: u32) -> u32 {
    return source(i32(at) - i32(K / 2u), 0u, i32(PY), params.from_first.x, params.from_rows) * u32(params.from_cols);
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let quad = id.x % QUADS;
    let col = 4u * (2u * QUADS * (id.x / QUADS) + quad);
    let next = col + 4u * QUADS;
    if (col >= params.cols) {
        return;
    }
    let x_at = places(i32(col) - i32(K / 2u));
    let y_at = places(i32(next) - i32(K / 2u));
    let first = ROWS * id.y;
    let none = Both(vec4f(0.0), vec4f(0.0));
    var sums = Sums(none, none, none, none, none, none, none);
    // Two rows at a time; K is odd, so their number is even.
    for (var i = 0u; i < ROWS + K - 1u; i += 2u) {
        let even = input_row(first + i);
        sums = step(sums, load(even, x_at), load(even, y_at), first + i, 0u, quad);
        finish(sums.s0, i, first, col, next);
        sums = shifted(sums);
        let odd = input_row(first + i + 1u);
        sums = step(sums, load(odd, x_at), load(odd, y_at), first + i + 1u, 1u, quad);
        finish(sums.s0, i + 1u, first, col, next);
        sums = shifted(sums);
    }
}
