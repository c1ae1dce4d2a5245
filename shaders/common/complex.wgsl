// Complex numbers as vec2f(re, im), and pairs of them as vec4f(re, im, re, im).

fn cmul(a: vec2f, b: vec2f) -> vec2f {
    return vec2f(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

fn conj(a: vec2f) -> vec2f {
    return vec2f(a.x, -a.y);
}

// i * a
fn times_i(a: vec2f) -> vec2f {
    return vec2f(-a.y, a.x);
}

// Both numbers of a pair, times b.
fn pair_mul(a: vec4f, b: vec2f) -> vec4f {
    return a * b.x + vec4f(-a.y, a.x, -a.w, a.z) * b.y;
}

fn pair_conj(a: vec4f) -> vec4f {
    return vec4f(a.x, -a.y, a.z, -a.w);
}

// i times both numbers of a pair
fn pair_times_i(a: vec4f) -> vec4f {
    return vec4f(-a.y, a.x, -a.w, a.z);
}
