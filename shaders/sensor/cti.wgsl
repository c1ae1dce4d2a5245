// Charge-transfer inefficiency, linear: what arrives of every packet, and with the packets after it.
//   arrived[k] = sum_d weights[d, k] charge[k - d],   d = first[k], first[k] + 1, ...
// along columns, or along rows where SERIAL. The read-out lies before element 0. The weights are worked out on the host
// (gpusim.sensor.cti.shares): with n transfers to make and a fraction e left behind in each, a packet leaves the share
// C(n - 1 + d, d) (1 - e)^n e^d to the d-th packet after it, n being that of the packet that it comes from.
// Units: electrons. In: charge (rows, cols); first (elements); weights (width, elements). Out: arrived (rows, cols).
// Dispatch: ceil(cols/256) x rows workgroups of 64, where SERIAL ceil(cols/64) x ceil(rows/4): four pixels each. Lavapipe, 2 cores: see tools/bench.py cti-linear.

override SERIAL: bool = false;

struct Params {
    rows: u32,
    cols: u32,
    width: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> charge: array<f32>;
@group(0) @binding(2) var<storage, read> first: array<u32>;
@group(0) @binding(3) var<storage, read> weights: array<f32>;
@group(0) @binding(4) var<storage, read_write> arrived: array<f32>;

// Four lines share their weights: rows where SERIAL, else columns, 64 apart so that neighbours read neighbours.
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let col = select(256u, 64u, SERIAL) * group.x + local.x;
    let row = select(1u, 4u, SERIAL) * group.y;
    let k = select(row, col, SERIAL);
    let elements = select(params.rows, params.cols, SERIAL);
    if (k >= elements) {
        return;
    }
    let pixels = params.rows * params.cols;
    let at = vec4u(row * params.cols + col) + select(64u, params.cols, SERIAL) * vec4u(0u, 1u, 2u, 3u);
    let inside = select(vec4u(col) + vec4u(0u, 64u, 128u, 192u) < vec4u(params.cols), at < vec4u(pixels), SERIAL);
    let stride = select(params.cols, 1u, SERIAL);
    let nearest = first[k];
    let farthest = min(nearest + params.width, k + 1u);   // no packet comes before the first
    var sum = vec4f(0.0);
    for (var d = nearest; d < farthest; d++) {
        let from_ = min(at - d * stride, vec4u(pixels - 1u));
        sum += weights[(d - nearest) * elements + k]
            * vec4f(charge[from_.x], charge[from_.y], charge[from_.z], charge[from_.w]);
    }
    for (var i = 0u; i < 4u; i++) {
        if (inside[i]) {
            arrived[at[i]] = sum[i];
        }
    }
}
