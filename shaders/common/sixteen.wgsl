// Sixteen pairs of complex numbers that one invocation holds, and their transforms, in natural order, both numbers of a pair
// alike:  sixteen: X[k] = sum_n x[n] exp(-2 pi i n k / 16),  sixteen_back: x[n] = sum_k X[k] exp(2 pi i n k / 16).
// 16 = 4 4. The inverse transform is the forward one with real and imaginary parts exchanged before and after.
// Every index is a constant once the calls are inlined, so that all lies in registers, or on the stack where there are not
// enough: on lavapipe, where every access to memory is made lane by lane and number by number, that costs next to nothing.
#include "octet"

alias Sixteen = array<vec4f, 16>;

fn sixteen(v: ptr<function, Sixteen>) {
    #repeat k 4
    let x${k} = fft4((*v)[${k}], (*v)[${k + 4}], (*v)[${k + 8}], (*v)[${k + 12}]);
    #end
    let y0 = fft4(x0.v0, x1.v0, x2.v0, x3.v0);
    let y1 = fft4(
        x0.v1,
        pair_mul(x1.v1, vec2f(0.9238795325, -0.3826834324)),
        pair_mul(x2.v1, vec2f(0.7071067812, -0.7071067812)),
        pair_mul(x3.v1, vec2f(0.3826834324, -0.9238795325)),
    );
    let y2 = fft4(
        x0.v2,
        pair_mul(x1.v2, vec2f(0.7071067812, -0.7071067812)),
        -pair_times_i(x2.v2),
        pair_mul(x3.v2, vec2f(-0.7071067812, -0.7071067812)),
    );
    let y3 = fft4(
        x0.v3,
        pair_mul(x1.v3, vec2f(0.3826834324, -0.9238795325)),
        pair_mul(x2.v3, vec2f(-0.7071067812, -0.7071067812)),
        pair_mul(x3.v3, vec2f(-0.9238795325, 0.3826834324)),
    );
    #repeat k 4
    (*v)[${k}] = y${k}.v0;
    (*v)[${k + 4}] = y${k}.v1;
    (*v)[${k + 8}] = y${k}.v2;
    (*v)[${k + 12}] = y${k}.v3;
    #end
}

fn exchange(v: ptr<function, Sixteen>) {
    #repeat k 16
    (*v)[${k}] = (*v)[${k}].yxwz;
    #end
}

fn sixteen_back(v: ptr<function, Sixteen>) {
    exchange(v);
    sixteen(v);
    exchange(v);
}

// Number n turned by w^n, from w, w^2, w^4 and w^8: the other powers are one or two roundings away from these.
fn turn_sixteen(v: ptr<function, Sixteen>, w: vec2f, w2: vec2f, w4: vec2f, w8: vec2f) {
    let w3 = cmul(w2, w);
    let w12 = cmul(w8, w4);
    (*v)[1] = pair_mul((*v)[1], w);
    (*v)[2] = pair_mul((*v)[2], w2);
    (*v)[3] = pair_mul((*v)[3], w3);
    (*v)[4] = pair_mul((*v)[4], w4);
    (*v)[5] = pair_mul((*v)[5], cmul(w4, w));
    (*v)[6] = pair_mul((*v)[6], cmul(w4, w2));
    (*v)[7] = pair_mul((*v)[7], cmul(w4, w3));
    (*v)[8] = pair_mul((*v)[8], w8);
    (*v)[9] = pair_mul((*v)[9], cmul(w8, w));
    (*v)[10] = pair_mul((*v)[10], cmul(w8, w2));
    (*v)[11] = pair_mul((*v)[11], cmul(w8, w3));
    (*v)[12] = pair_mul((*v)[12], w12);
    (*v)[13] = pair_mul((*v)[13], cmul(w12, w));
    (*v)[14] = pair_mul((*v)[14], cmul(w12, w2));
    (*v)[15] = pair_mul((*v)[15], cmul(w12, w3));
}
