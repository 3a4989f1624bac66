// Counting sort into bins, step 1: finds the bin of each particle and counts the particles of each
// bin.

@group(0) @binding(2) var<storage, read> listed_place: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> bin_of: array<u32>;
@group(0) @binding(4) var<storage, read_write> bin_counts: array<atomic<u32>>;

@compute @workgroup_size(PARTICLE_GROUP)
fn bin_count(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * PARTICLE_GROUP + lane;
    if i >= now.count {
        return;
    }
    let particle = listed_place[i];
    let level = level_of(particle.w);
    let bin = bin_number(bin_coordinate(particle.xyz, level), level);
    bin_of[i] = bin;
    atomicAdd(&bin_counts[bin], 1u);
}
