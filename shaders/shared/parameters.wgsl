// Parameters of the run for every kernel: grid, levels of bins, limits.
// stages/particles/src/gpu/parameters.rs makes them, and its tests compare this layout with naga's.

// Bins of the particles of one octave of h; edges in mm.
struct Level {
    edge: f32,
    inverse_edge: f32,
    // Maximum h of the level, mm.
    largest: f32,
    // Number of its first bin.
    first_bin: u32,
    bins: vec3<u32>,
    unused: u32,
}

struct Parameters {
    grid_size: vec3<u32>,
    level_count: u32,
    // Voxel spacing, mm.
    spacing: vec3<f32>,
    // Tolerance of |F| = 0, mm.
    tolerance: f32,
    inverse_spacing: vec3<f32>,
    // Longest single step of a projection, mm.
    projection_step: f32,
    // The voxel at the origin of device positions.
    centre: vec3<i32>,
    // Voxels in each slab of a field.
    slab_length: u32,
    // Device position of the corner of bin (0, 0, 0), mm.
    bins_origin: vec3<f32>,
    normal_agreement: f32,
    ideal_energy: f32,
    add_below: f32,
    delete_above: f32,
    // Upper bound of h on the surface, mm; interpolated sizes are clamped to it.
    largest_size: f32,
    bin_total: u32,
    // Members that each neighbour list has room for.
    list_room: u32,
    seed: u32,
    initial_lambda: f32,
    // Lengths in units of h: edge of the target lattice, radius of the first ring, and the minimum
    // distances of a newcomer from other particles and from its parent.
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

// Linear number of a workgroup of a two-dimensional dispatch.
fn flat_group(group: vec3<u32>, groups: vec3<u32>) -> u32 {
    return group.y * groups.x + group.x;
}
