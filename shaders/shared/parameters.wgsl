// Parameters of the run that every kernel can read: the grid, the levels of bins, and limits.
// stages/particles/src/gpu/parameters.rs sets them, and its tests compare this layout with the
// layout that naga computes.

// One level of bins, for the particles of one octave of h. Edges are in mm.
struct Level {
    edge: f32,
    inverse_edge: f32,
    // Maximum h in mm of the particles of the level.
    largest: f32,
    // Index of the first bin of the level.
    first_bin: u32,
    bins: vec3<u32>,
    unused: u32,
}

struct Parameters {
    grid_size: vec3<u32>,
    level_count: u32,
    // Voxel spacing in mm.
    spacing: vec3<f32>,
    // Tolerance on |F| in mm.
    tolerance: f32,
    inverse_spacing: vec3<f32>,
    // Maximum length in mm of a single projection step.
    projection_step: f32,
    // Voxel whose centre is the origin of device positions.
    centre: vec3<i32>,
    // Number of values in each slab of a field.
    slab_length: u32,
    // Device position in mm of the corner of bin (0, 0, 0).
    bins_origin: vec3<f32>,
    normal_agreement: f32,
    ideal_energy: f32,
    add_below: f32,
    delete_above: f32,
    // Upper bound of h on the surface in mm; interpolated values of h are clamped to it.
    largest_size: f32,
    bin_total: u32,
    // Capacity of each neighbour list.
    list_room: u32,
    seed: u32,
    initial_lambda: f32,
    // Lengths in units of h: the spacing of the target lattice, the radius of the first ring, and
    // the minimum distances of a newcomer from other particles and from its parent.
    spacing_in_h: f32,
    first_ring: f32,
    newcomer_distance: f32,
    parent_distance: f32,
    levels: array<Level, MOST_LEVELS>,
}

// Values that change from pass to pass.
struct Pass {
    number: u32,
    // Number of particles.
    count: u32,
    allow_insert: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> parameters: Parameters;
@group(0) @binding(1) var<uniform> now: Pass;

// Returns the linear index of a workgroup in a two-dimensional dispatch.
fn flat_group(group: vec3<u32>, groups: vec3<u32>) -> u32 {
    return group.y * groups.x + group.x;
}
