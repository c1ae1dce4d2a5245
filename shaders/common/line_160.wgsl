// Transforms of a line of 160 complex samples that one invocation holds: 160 = 10 16, straight through, no workgroup memory.
//
//   X[k] = sum_n x[n] exp(-2 pi i k n / 160),  n = t + 16 r, k = a + 10 m
//   line_160: x[n] in slot n -> X[a + 10 m] in slot 16 a + m (ten transforms of 16 are the last pass)
//   line_160_back: X in those slots -> sum_k X[k] exp(-2 pi i k n / 160) in slot n
// The inverse transform is the forward one with real and imaginary parts exchanged before and after.
// Every index is a constant once the calls are inlined, so that the line lies in registers, or on the stack where there are
// not enough: on lavapipe, where every access to memory is made lane by lane, that is cheaper than workgroup memory.
#include "complex"

alias Line = array<vec2f, 160>;

struct Four { a: vec2f, b: vec2f, c: vec2f, d: vec2f, }
struct Five { a: vec2f, b: vec2f, c: vec2f, d: vec2f, e: vec2f, }
struct Ten { even: Five, odd: Five, }

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

// Of slots t, t + 16 .. t + 144: the transforms of the even and of the odd ones, these turned by exp(-2 pi i k / 10).
fn halves(v: ptr<function, Line>, t: u32) -> Ten {
    let odd = dft5((*v)[t + 16u], (*v)[t + 48u], (*v)[t + 80u], (*v)[t + 112u], (*v)[t + 144u]);
    return Ten(
        dft5((*v)[t], (*v)[t + 32u], (*v)[t + 64u], (*v)[t + 96u], (*v)[t + 128u]),
        Five(
            odd.a,
            cmul(odd.b, vec2f(0.8090169944, -0.5877852523)),
            cmul(odd.c, vec2f(0.3090169944, -0.9510565163)),
            cmul(odd.d, vec2f(-0.3090169944, -0.9510565163)),
            cmul(odd.e, vec2f(-0.8090169944, -0.5877852523)),
        ),
    );
}

// Ten samples transformed, and turned by w^a, w = exp(-2 pi i t / 160). One or two products make the other powers.
fn turned_tens(v: ptr<function, Line>, t: u32, w_w2: vec4f, w4_w8: vec4f) {
    let x = halves(v, t);
    let w = w_w2.xy;
    let w2 = w_w2.zw;
    let w4 = w4_w8.xy;
    let w8 = w4_w8.zw;
    let w3 = cmul(w2, w);
    (*v)[t] = x.even.a + x.odd.a;
    (*v)[t + 16u] = cmul(x.even.b + x.odd.b, w);
    (*v)[t + 32u] = cmul(x.even.c + x.odd.c, w2);
    (*v)[t + 48u] = cmul(x.even.d + x.odd.d, w3);
    (*v)[t + 64u] = cmul(x.even.e + x.odd.e, w4);
    (*v)[t + 80u] = cmul(x.even.a - x.odd.a, cmul(w4, w));
    (*v)[t + 96u] = cmul(x.even.b - x.odd.b, cmul(w4, w2));
    (*v)[t + 112u] = cmul(x.even.c - x.odd.c, cmul(w4, w3));
    (*v)[t + 128u] = cmul(x.even.d - x.odd.d, w8);
    (*v)[t + 144u] = cmul(x.even.e - x.odd.e, cmul(w8, w));
}

fn tens(v: ptr<function, Line>, t: u32) {
    let x = halves(v, t);
    (*v)[t] = x.even.a + x.odd.a;
    (*v)[t + 16u] = x.even.b + x.odd.b;
    (*v)[t + 32u] = x.even.c + x.odd.c;
    (*v)[t + 48u] = x.even.d + x.odd.d;
    (*v)[t + 64u] = x.even.e + x.odd.e;
    (*v)[t + 80u] = x.even.a - x.odd.a;
    (*v)[t + 96u] = x.even.b - x.odd.b;
    (*v)[t + 112u] = x.even.c - x.odd.c;
    (*v)[t + 128u] = x.even.d - x.odd.d;
    (*v)[t + 144u] = x.even.e - x.odd.e;
}

// Sixteen neighbouring slots: four transforms of four, turned by exp(-2 pi i j m / 16), and four across them.
fn sixteens(v: ptr<function, Line>, b: u32) {
    let x0 = dft4((*v)[b], (*v)[b + 4u], (*v)[b + 8u], (*v)[b + 12u]);
    let x1 = dft4((*v)[b + 1u], (*v)[b + 5u], (*v)[b + 9u], (*v)[b + 13u]);
    let x2 = dft4((*v)[b + 2u], (*v)[b + 6u], (*v)[b + 10u], (*v)[b + 14u]);
    let x3 = dft4((*v)[b + 3u], (*v)[b + 7u], (*v)[b + 11u], (*v)[b + 15u]);
    let y0 = dft4(x0.a, x1.a, x2.a, x3.a);
    let y1 = dft4(
        x0.b,
        cmul(x1.b, vec2f(0.9238795325, -0.3826834324)),
        cmul(x2.b, vec2f(0.7071067812, -0.7071067812)),
        cmul(x3.b, vec2f(0.3826834324, -0.9238795325)),
    );
    let y2 = dft4(
        x0.c,
        cmul(x1.c, vec2f(0.7071067812, -0.7071067812)),
        cmul(x2.c, vec2f(0.0000000000, -1.0000000000)),
        cmul(x3.c, vec2f(-0.7071067812, -0.7071067812)),
    );
    let y3 = dft4(
        x0.d,
        cmul(x1.d, vec2f(0.3826834324, -0.9238795325)),
        cmul(x2.d, vec2f(-0.7071067812, -0.7071067812)),
        cmul(x3.d, vec2f(-0.9238795325, 0.3826834324)),
    );
    (*v)[b] = y0.a;
    (*v)[b + 4u] = y0.b;
    (*v)[b + 8u] = y0.c;
    (*v)[b + 12u] = y0.d;
    (*v)[b + 1u] = y1.a;
    (*v)[b + 5u] = y1.b;
    (*v)[b + 9u] = y1.c;
    (*v)[b + 13u] = y1.d;
    (*v)[b + 2u] = y2.a;
    (*v)[b + 6u] = y2.b;
    (*v)[b + 10u] = y2.c;
    (*v)[b + 14u] = y2.d;
    (*v)[b + 3u] = y3.a;
    (*v)[b + 7u] = y3.b;
    (*v)[b + 11u] = y3.c;
    (*v)[b + 15u] = y3.d;
}

// Sixteen slots transformed, and slot t turned by w^t.
fn turned_sixteens(v: ptr<function, Line>, b: u32, w_w2: vec4f, w4_w8: vec4f) {
    sixteens(v, b);
    let w = w_w2.xy;
    let w2 = w_w2.zw;
    let w4 = w4_w8.xy;
    let w8 = w4_w8.zw;
    let w3 = cmul(w2, w);
    let w12 = cmul(w8, w4);
    (*v)[b + 1u] = cmul((*v)[b + 1u], w);
    (*v)[b + 2u] = cmul((*v)[b + 2u], w2);
    (*v)[b + 3u] = cmul((*v)[b + 3u], w3);
    (*v)[b + 4u] = cmul((*v)[b + 4u], w4);
    (*v)[b + 5u] = cmul((*v)[b + 5u], cmul(w4, w));
    (*v)[b + 6u] = cmul((*v)[b + 6u], cmul(w4, w2));
    (*v)[b + 7u] = cmul((*v)[b + 7u], cmul(w4, w3));
    (*v)[b + 8u] = cmul((*v)[b + 8u], w8);
    (*v)[b + 9u] = cmul((*v)[b + 9u], cmul(w8, w));
    (*v)[b + 10u] = cmul((*v)[b + 10u], cmul(w8, w2));
    (*v)[b + 11u] = cmul((*v)[b + 11u], cmul(w8, w3));
    (*v)[b + 12u] = cmul((*v)[b + 12u], w12);
    (*v)[b + 13u] = cmul((*v)[b + 13u], cmul(w12, w));
    (*v)[b + 14u] = cmul((*v)[b + 14u], cmul(w12, w2));
    (*v)[b + 15u] = cmul((*v)[b + 15u], cmul(w12, w3));
}

fn line_160(v: ptr<function, Line>) {
    tens(v, 0u);
    turned_tens(v, 1u, vec4f(0.999229036, -0.039259816, 0.996917334, -0.078459096), vec4f(0.987688341, -0.156434465, 0.951056516, -0.309016994));
    turned_tens(v, 2u, vec4f(0.996917334, -0.078459096, 0.987688341, -0.156434465), vec4f(0.951056516, -0.309016994, 0.809016994, -0.587785252));
    turned_tens(v, 3u, vec4f(0.993068457, -0.117537397, 0.972369920, -0.233445364), vec4f(0.891006524, -0.453990500, 0.587785252, -0.809016994));
    turned_tens(v, 4u, vec4f(0.987688341, -0.156434465, 0.951056516, -0.309016994), vec4f(0.809016994, -0.587785252, 0.309016994, -0.951056516));
    turned_tens(v, 5u, vec4f(0.980785280, -0.195090322, 0.923879533, -0.382683432), vec4f(0.707106781, -0.707106781, 0.0, -1.0));
    turned_tens(v, 6u, vec4f(0.972369920, -0.233445364, 0.891006524, -0.453990500), vec4f(0.587785252, -0.809016994, -0.309016994, -0.951056516));
    turned_tens(v, 7u, vec4f(0.962455236, -0.271440450, 0.852640164, -0.522498565), vec4f(0.453990500, -0.891006524, -0.587785252, -0.809016994));
    turned_tens(v, 8u, vec4f(0.951056516, -0.309016994, 0.809016994, -0.587785252), vec4f(0.309016994, -0.951056516, -0.809016994, -0.587785252));
    turned_tens(v, 9u, vec4f(0.938191336, -0.346117057, 0.760405966, -0.649448048), vec4f(0.156434465, -0.987688341, -0.951056516, -0.309016994));
    turned_tens(v, 10u, vec4f(0.923879533, -0.382683432, 0.707106781, -0.707106781), vec4f(0.0, -1.0, -1.0, 0.0));
    turned_tens(v, 11u, vec4f(0.908143174, -0.418659738, 0.649448048, -0.760405966), vec4f(-0.156434465, -0.987688341, -0.951056516, 0.309016994));
    turned_tens(v, 12u, vec4f(0.891006524, -0.453990500, 0.587785252, -0.809016994), vec4f(-0.309016994, -0.951056516, -0.809016994, 0.587785252));
    turned_tens(v, 13u, vec4f(0.872496007, -0.488621241, 0.522498565, -0.852640164), vec4f(-0.453990500, -0.891006524, -0.587785252, 0.809016994));
    turned_tens(v, 14u, vec4f(0.852640164, -0.522498565, 0.453990500, -0.891006524), vec4f(-0.587785252, -0.809016994, -0.309016994, 0.951056516));
    turned_tens(v, 15u, vec4f(0.831469612, -0.555570233, 0.382683432, -0.923879533), vec4f(-0.707106781, -0.707106781, 0.0, 1.0));
    sixteens(v, 0u);
    sixteens(v, 16u);
    sixteens(v, 32u);
    sixteens(v, 48u);
    sixteens(v, 64u);
    sixteens(v, 80u);
    sixteens(v, 96u);
    sixteens(v, 112u);
    sixteens(v, 128u);
    sixteens(v, 144u);
}

fn line_160_back(v: ptr<function, Line>) {
    sixteens(v, 0u);
    turned_sixteens(v, 16u, vec4f(0.999229036, -0.039259816, 0.996917334, -0.078459096), vec4f(0.987688341, -0.156434465, 0.951056516, -0.309016994));
    turned_sixteens(v, 32u, vec4f(0.996917334, -0.078459096, 0.987688341, -0.156434465), vec4f(0.951056516, -0.309016994, 0.809016994, -0.587785252));
    turned_sixteens(v, 48u, vec4f(0.993068457, -0.117537397, 0.972369920, -0.233445364), vec4f(0.891006524, -0.453990500, 0.587785252, -0.809016994));
    turned_sixteens(v, 64u, vec4f(0.987688341, -0.156434465, 0.951056516, -0.309016994), vec4f(0.809016994, -0.587785252, 0.309016994, -0.951056516));
    turned_sixteens(v, 80u, vec4f(0.980785280, -0.195090322, 0.923879533, -0.382683432), vec4f(0.707106781, -0.707106781, 0.0, -1.0));
    turned_sixteens(v, 96u, vec4f(0.972369920, -0.233445364, 0.891006524, -0.453990500), vec4f(0.587785252, -0.809016994, -0.309016994, -0.951056516));
    turned_sixteens(v, 112u, vec4f(0.962455236, -0.271440450, 0.852640164, -0.522498565), vec4f(0.453990500, -0.891006524, -0.587785252, -0.809016994));
    turned_sixteens(v, 128u, vec4f(0.951056516, -0.309016994, 0.809016994, -0.587785252), vec4f(0.309016994, -0.951056516, -0.809016994, -0.587785252));
    turned_sixteens(v, 144u, vec4f(0.938191336, -0.346117057, 0.760405966, -0.649448048), vec4f(0.156434465, -0.987688341, -0.951056516, -0.309016994));
    tens(v, 0u);
    tens(v, 1u);
    tens(v, 2u);
    tens(v, 3u);
    tens(v, 4u);
    tens(v, 5u);
    tens(v, 6u);
    tens(v, 7u);
    tens(v, 8u);
    tens(v, 9u);
    tens(v, 10u);
    tens(v, 11u);
    tens(v, 12u);
    tens(v, 13u);
    tens(v, 14u);
    tens(v, 15u);
}
