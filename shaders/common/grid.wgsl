// Grids in direction cosines of one beam: the nodes at which W is known, and the finer cells of the transform.

struct Grid {
    first: vec2f,             // alpha, beta of the first node; where the pupil is mirrored, alpha > 0 alone is kept
    step: vec2f,              // from node to node
    origin: vec2f,            // alpha where the first row of cells begins, beta between the two middle cells
    chief: vec2f,             // direction cosines of the chief ray
    cell: f32,                // side of a cell: lambda / (T pitch)
    waves_per_mm: f32,
}
