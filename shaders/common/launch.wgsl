// Rays of one field and wavelength start on the plane across the chief ray through a point E of it in object
// space: at E + p, p = p_x (1, 0, 0) + p_y (0, cos theta, -sin theta). The chief ray goes along d = (0, sin theta,
// cos theta), the others along d + p / D: they come from a point of the object, D before E, or from infinity.
//
// Depends on the globals of common/surface.
#include "surface"

struct Pair {
    sine: vec2f,              // of the chief ray's angle theta before the lens, high and low part
    cosine: vec2f,
    start_y: vec2f,           // E, mm from the first vertex
    start_z: vec2f,
    image_y: vec2f,           // where the chief ray lands, mm
    image_z: vec2f,           // image plane, mm from the last vertex
    chief_path: vec2f,        // optical path of the chief ray from E to the image plane, mm
    first_index: u32,         // of its refractive indices: before the lens, behind each surface
    waves_per_mm: f32,
    vergence: vec2f,          // 1 / D, 1/mm: 0 where the object is at infinity
    unused: vec2f,
    aim: vec4f,               // at the chief ray: d(p_x, p_y) / d(stop x), d(p_x, p_y) / d(stop y)
}

fn launched(pair: Pair, p: vec2f) -> Ray {
    let across = pair.vergence.x * p;
    let far = sqrt(1.0 + dot(across, across));
    return Ray(
        vec3f(p.x, pair.start_y.x + p.y * pair.cosine.x, pair.start_z.x - p.y * pair.sine.x),
        vec3f(across.x, pair.sine.x + across.y * pair.cosine.x, pair.cosine.x - across.y * pair.sine.x) / far,
        true,
    );
}
