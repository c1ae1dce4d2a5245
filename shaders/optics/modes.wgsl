// First half of the space-variant convolution where the PSFs are sums of few modes, H_cj(x; s) = sum_r m_r(s) h_rcj(x):
// forward transform of every row of one source block, weighted with the maps m_r.
//
// A line is a coefficient plane times a map: line l has the plane l / RANK and the map l % RANK. Two real lines, 2 p and
// 2 p + 1, share one complex transform:
//   spectra[p, y, k] = sum_x (a_j m_r + i a_j' m_r') exp(-2 pi i k x / T)
// The maps are given at nodes and interpolated bilinearly: sample x, y of the block lies first + step (x, y) nodes from
// `node`, between two nodes: at least half a sample from the last.
// planes (J, BY, BX) in the planes' own unit, maps (RANK, MAP_Y, MAP_X) -> spectra (ceil(lines/2), BY, T), same unit.
// An odd number of lines leaves the last imaginary part zero.
// Dispatch: (ceil(BY/2), ceil(lines/2), 1) workgroups of LANES = T/8 invocations, two rows each.
#include "line_fft"

override T: u32 = 512u;           // transform length, samples
override LANES: u32 = 64u;        // T/8
override FIRST_RADIX: u32 = 8u;   // 2, 4 or 8: T = FIRST_RADIX 8^k
override BX: u32 = 336u;          // block width, samples
override BY: u32 = 336u;          // block height, samples
override RANK: u32 = 2u;          // maps
override MAP_X: u32 = 5u;         // nodes of a map across, 2 to T
override MAP_Y: u32 = 4u;         // nodes of a map down, 2 or more

struct Params {
    first: vec2f,
    step: vec2f,
    node: vec2u,
    lines: u32,                   // of the planes that the block needs
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> twiddle: array<vec2f>;
@group(0) @binding(2) var<storage, read> planes: array<f32>;
@group(0) @binding(3) var<storage, read> maps: array<f32>;
@group(0) @binding(4) var<storage, read_write> spectra: array<vec2f>;

var<workgroup> sh_line: array<vec4f, T>;

// One map at node x of a row of the block.
fn map_at(line: u32, x: u32, y: u32) -> f32 {
    let position = params.first.y + f32(y) * params.step.y;
    let i = (line % RANK * MAP_Y + params.node.y + u32(position)) * MAP_X + x;
    return mix(maps[i], maps[i + MAP_X], fract(position));
}

// Two rows: the first line and the second of each.
fn weighted(line: u32, other: u32, y: u32, next: u32, x: u32) -> vec4f {
    if (x >= BX) {
        return vec4f(0.0);
    }
    let position = params.first.x + f32(x) * params.step.x;
    let left = params.node.x + u32(position);
    let weights = mix(sh_line[left], sh_line[left + 1u], fract(position));
    let plane = line / RANK * BY;
    let a = vec2f(planes[(plane + y) * BX + x], planes[(plane + next) * BX + x]);
    var b = a;
    if (other / RANK != line / RANK) {
        let second = other / RANK * BY;
        b = vec2f(planes[(second + y) * BX + x], planes[(second + next) * BX + x]);
    }
    return vec4f(a.x, b.x, a.y, b.y) * weights;
}

fn keep(row: u32, last: bool, k: u32, pair: vec4f) {
    spectra[row * T + k] = pair.xy;
    if (!last) {
        spectra[(row + 1u) * T + k] = pair.zw;
    }
}

@compute @workgroup_size(LANES, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    let y = 2u * group.x;
    let last = y + 1u >= BY;            // none after the last of an odd number
    let next = select(y + 1u, y, last);
    let line = 2u * group.y;
    let single = line + 1u >= params.lines;
    let other = select(line + 1u, line, single);
    for (var x = t; x < MAP_X; x += LANES) {
        let own = vec2f(map_at(line, x, y), map_at(line, x, next));
        var second = vec2f(0.0);
        if (!single) {
            second = vec2f(map_at(other, x, y), map_at(other, x, next));
        }
        sh_line[x] = vec4f(own.x, second.x, own.y, second.y);
    }
    workgroupBarrier();
    let x = Octet(
        #repeat k 8
        weighted(line, other, y, next, t + ${k}u * LANES),
        #end
    );
    workgroupBarrier();
    let v = line_fft(x, t, 0u, T, FIRST_RADIX);
    let row = group.y * BY + y;
    #repeat k 8
    keep(row, last, t + ${k}u * LANES, v.v${k});
    #end
}
