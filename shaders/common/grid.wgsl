// Grids in direction cosines of one beam: the nodes at which rays were traced, and the finer cells of the transform.

struct Grid {
    first: vec2f,             // alpha, beta of the first node; alpha > 0 alone is kept, nodes mirror one another
    step: vec2f,              // from node to node
    centre: f32,              // beta between the two middle cells
    cell: f32,                // side of a cell: lambda / (T pitch)
    chief_beta: f32,
    waves_per_mm: f32,
}
