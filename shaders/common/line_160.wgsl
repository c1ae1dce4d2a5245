// Transforms of a line of 160 complex samples that one invocation holds, straight through, no workgroup memory: 160 = 5 32 by
// prime factors (Good 1958), without turns between the two; 32 = 4 8.
//
//   X[k] = sum_n x[n] exp(-2 pi i k n / 160) = sum_r exp(-2 pi i l r / 32) sum_m exp(-2 pi i j m / 5) x[n],
//   r = n mod 32, m = n mod 5, j = 3 k mod 5, l = 13 k mod 32
//   line_160: x[n] in slot n -> X[k] in slot 32 j + 8 (l mod 4) + l / 4
//   line_160_back: X in those slots -> sum_k X[k] exp(-2 pi i k n / 160) in slot n
// The inverse transform is the forward one with real and imaginary parts exchanged before and after.
// Every index is a constant once the calls are inlined, so that the line lies in registers, or on the stack where there are
// not enough: on lavapipe, where every access to memory is made lane by lane, that is cheaper than workgroup memory.
#include "complex"

alias Line = array<vec2f, 160>;

struct Four { a: vec2f, b: vec2f, c: vec2f, d: vec2f, }
struct Five { a: vec2f, b: vec2f, c: vec2f, d: vec2f, e: vec2f, }

fn dft4(x0: vec2f, x1: vec2f, x2: vec2f, x3: vec2f) -> Four {
    let a = x0 + x2;
    let b = x0 - x2;
    let c = x1 + x3;
    let d = times_i(x3 - x1);
    return Four(a + c, b + d, a - c, b - d);
}

// cos and sin of 2 pi / 5 and 4 pi / 5.
fn dft5(x0: vec2f, x1: vec2f, x2: vec2f, x3: vec2f, x4: vec2f) -> Five {
    const C1 = 0.30901699437494742;
    const C2 = -0.80901699437494742;
    const S1 = 0.95105651629515357;
    const S2 = 0.58778525229247313;
    let p = x1 + x4;
    let q = x2 + x3;
    let u = times_i(x4 - x1);
    let v = times_i(x3 - x2);
    let near = x0 + C1 * p + C2 * q;
    let far = x0 + C2 * p + C1 * q;
    let turn_near = S1 * u + S2 * v;
    let turn_far = S2 * u - S1 * v;
    return Five(x0 + p + q, near + turn_near, far + turn_far, far - turn_far, near - turn_near);
}

// The one of the slots r, r + 32 .. r + 128 that is m modulo 5.
fn slot(r: u32, m: u32) -> u32 {
    return r + 32u * (3u * (m + 4u * r) % 5u);
}

fn fives(v: ptr<function, Line>, r: u32) {
    let x = dft5((*v)[slot(r, 0u)], (*v)[slot(r, 1u)], (*v)[slot(r, 2u)], (*v)[slot(r, 3u)], (*v)[slot(r, 4u)]);
    (*v)[r] = x.a;
    (*v)[r + 32u] = x.b;
    (*v)[r + 64u] = x.c;
    (*v)[r + 96u] = x.d;
    (*v)[r + 128u] = x.e;
}

fn fives_back(v: ptr<function, Line>, r: u32) {
    let x = dft5((*v)[r], (*v)[r + 32u], (*v)[r + 64u], (*v)[r + 96u], (*v)[r + 128u]);
    (*v)[slot(r, 0u)] = x.a;
    (*v)[slot(r, 1u)] = x.b;
    (*v)[slot(r, 2u)] = x.c;
    (*v)[slot(r, 3u)] = x.d;
    (*v)[slot(r, 4u)] = x.e;
}

fn fours(v: ptr<function, Line>, b: u32) {
    let x = dft4((*v)[b], (*v)[b + 8u], (*v)[b + 16u], (*v)[b + 24u]);
    (*v)[b] = x.a;
    (*v)[b + 8u] = x.b;
    (*v)[b + 16u] = x.c;
    (*v)[b + 24u] = x.d;
}

// Eight neighbouring slots: transforms of the even and of the odd ones, these turned by exp(-2 pi i k / 8).
fn eights(v: ptr<function, Line>, b: u32) {
    const H = 0.70710678118654752;
    let even = dft4((*v)[b], (*v)[b + 2u], (*v)[b + 4u], (*v)[b + 6u]);
    let odd = dft4((*v)[b + 1u], (*v)[b + 3u], (*v)[b + 5u], (*v)[b + 7u]);
    let turned_b = H * (odd.b - times_i(odd.b));
    let turned_c = -times_i(odd.c);
    let turned_d = -H * (odd.d + times_i(odd.d));
    (*v)[b] = even.a + odd.a;
    (*v)[b + 1u] = even.b + turned_b;
    (*v)[b + 2u] = even.c + turned_c;
    (*v)[b + 3u] = even.d + turned_d;
    (*v)[b + 4u] = even.a - odd.a;
    (*v)[b + 5u] = even.b - turned_b;
    (*v)[b + 6u] = even.c - turned_c;
    (*v)[b + 7u] = even.d - turned_d;
}

// Slots b + 8 s turned by w^s, w = exp(-2 pi i p / 32).
fn turn(v: ptr<function, Line>, b: u32, w: vec2f, w2: vec2f, w3: vec2f) {
    (*v)[b + 8u] = cmul((*v)[b + 8u], w);
    (*v)[b + 16u] = cmul((*v)[b + 16u], w2);
    (*v)[b + 24u] = cmul((*v)[b + 24u], w3);
}

fn turns(v: ptr<function, Line>, b: u32) {
    turn(v, b + 1u, vec2f(0.9807852804, -0.1950903220), vec2f(0.9238795325, -0.3826834324), vec2f(0.8314696123, -0.5555702330));
    turn(v, b + 2u, vec2f(0.9238795325, -0.3826834324), vec2f(0.7071067812, -0.7071067812), vec2f(0.3826834324, -0.9238795325));
    turn(v, b + 3u, vec2f(0.8314696123, -0.5555702330), vec2f(0.3826834324, -0.9238795325), vec2f(-0.1950903220, -0.9807852804));
    turn(v, b + 4u, vec2f(0.7071067812, -0.7071067812), vec2f(0.0000000000, -1.0000000000), vec2f(-0.7071067812, -0.7071067812));
    turn(v, b + 5u, vec2f(0.5555702330, -0.8314696123), vec2f(-0.3826834324, -0.9238795325), vec2f(-0.9807852804, -0.1950903220));
    turn(v, b + 6u, vec2f(0.3826834324, -0.9238795325), vec2f(-0.7071067812, -0.7071067812), vec2f(-0.9238795325, 0.3826834324));
    turn(v, b + 7u, vec2f(0.1950903220, -0.9807852804), vec2f(-0.9238795325, -0.3826834324), vec2f(-0.5555702330, 0.8314696123));
}

fn all_fours(v: ptr<function, Line>, b: u32) {
    fours(v, b); fours(v, b + 1u); fours(v, b + 2u); fours(v, b + 3u); fours(v, b + 4u); fours(v, b + 5u);
    fours(v, b + 6u); fours(v, b + 7u);
}

fn all_eights(v: ptr<function, Line>, b: u32) {
    eights(v, b); eights(v, b + 8u); eights(v, b + 16u); eights(v, b + 24u);
}

// Thirty-two neighbouring slots.
fn thirty_twos(v: ptr<function, Line>, b: u32) {
    all_fours(v, b);
    turns(v, b);
    all_eights(v, b);
}

fn thirty_twos_back(v: ptr<function, Line>, b: u32) {
    all_eights(v, b);
    turns(v, b);
    all_fours(v, b);
}

fn line_160(v: ptr<function, Line>) {
    fives(v, 0u); fives(v, 1u); fives(v, 2u); fives(v, 3u); fives(v, 4u); fives(v, 5u); fives(v, 6u); fives(v, 7u);
    fives(v, 8u); fives(v, 9u); fives(v, 10u); fives(v, 11u); fives(v, 12u); fives(v, 13u); fives(v, 14u); fives(v, 15u);
    fives(v, 16u); fives(v, 17u); fives(v, 18u); fives(v, 19u); fives(v, 20u); fives(v, 21u); fives(v, 22u); fives(v, 23u);
    fives(v, 24u); fives(v, 25u); fives(v, 26u); fives(v, 27u); fives(v, 28u); fives(v, 29u); fives(v, 30u); fives(v, 31u);
    thirty_twos(v, 0u); thirty_twos(v, 32u); thirty_twos(v, 64u); thirty_twos(v, 96u); thirty_twos(v, 128u);
}

fn line_160_back(v: ptr<function, Line>) {
    thirty_twos_back(v, 0u); thirty_twos_back(v, 32u); thirty_twos_back(v, 64u); thirty_twos_back(v, 96u);
    thirty_twos_back(v, 128u);
    fives_back(v, 0u); fives_back(v, 1u); fives_back(v, 2u); fives_back(v, 3u); fives_back(v, 4u); fives_back(v, 5u);
    fives_back(v, 6u); fives_back(v, 7u); fives_back(v, 8u); fives_back(v, 9u); fives_back(v, 10u); fives_back(v, 11u);
    fives_back(v, 12u); fives_back(v, 13u); fives_back(v, 14u); fives_back(v, 15u); fives_back(v, 16u); fives_back(v, 17u);
    fives_back(v, 18u); fives_back(v, 19u); fives_back(v, 20u); fives_back(v, 21u); fives_back(v, 22u); fives_back(v, 23u);
    fives_back(v, 24u); fives_back(v, 25u); fives_back(v, 26u); fives_back(v, 27u); fives_back(v, 28u); fives_back(v, 29u);
    fives_back(v, 30u); fives_back(v, 31u);
}
