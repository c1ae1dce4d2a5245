// Rays of one field and wavelength start on the plane wavefront through a point E of the chief ray in
// object space: at E + p_x (1, 0, 0) + p_y (0, cos theta, -sin theta), along (0, sin theta, cos theta).
//
// Depends on the globals of common/surface.
#include "surface"

struct Pair {
    sine: vec2f,              // of the field angle theta, high and low part
    cosine: vec2f,
    start_y: vec2f,           // E, mm from the first vertex
    start_z: vec2f,
    image_y: vec2f,           // where the chief ray lands, mm
    image_z: vec2f,           // image plane, mm from the last vertex
    chief_path: vec2f,        // optical path of the chief ray from E to the image plane, mm
    first_index: u32,         // of its refractive indices: before the lens, behind each surface
    waves_per_mm: f32,
    aim: vec4f,               // at the chief ray: d(p_x, p_y) / d(stop x), d(p_x, p_y) / d(stop y)
}

fn launched(pair: Pair, p: vec2f) -> Ray {
    return Ray(
        vec3f(p.x, pair.start_y.x + p.y * pair.cosine.x, pair.start_z.x - p.y * pair.sine.x),
        vec3f(0.0, pair.sine.x, pair.cosine.x),
        true,
    );
}
