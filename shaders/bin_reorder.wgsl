// Counting sort into bins, step 3: copies the particles into sorted order. Within a bin, held
// particles come first; otherwise the previous order is kept. The result does not depend on the
// order of the atomic operations in step 2, so a resumed run is reproducible.

@group(0) @binding(2) var<storage, read> listed_place: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> bin_of: array<u32>;
@group(0) @binding(5) var<storage, read> bin_starts: array<u32>;
@group(0) @binding(6) var<storage, read> order: array<u32>;
@group(0) @binding(7) var<storage, read> listed_normal: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> place: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> normal: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read_write> place_at_listing: array<vec4<f32>>;
@group(0) @binding(13) var<storage, read_write> outcome: array<u32>;

// Returns the sort key of a particle within its bin.
fn rank_of(i: u32) -> u32 {
    return i | select(0x80000000u, 0u, is_held(listed_normal[i].w));
}

@compute @workgroup_size(PARTICLE_GROUP)
fn bin_reorder(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let slot = flat_group(group, groups) * PARTICLE_GROUP + lane;
    if slot >= now.count {
        return;
    }
    let i = order[slot];
    let bin = bin_of[i];
    let first = bin_starts[bin];
    let end = bin_starts[bin + 1u];
    let own = rank_of(i);
    var rank = 0u;
    for (var k = first; k < end; k++) {
        rank += select(0u, 1u, rank_of(order[k]) < own);
    }
    let to = first + rank;
    place[to] = listed_place[i];
    place_at_listing[to] = listed_place[i];
    normal[to] = listed_normal[i];
    // reset here, because the move kernels skip particles without a class
    outcome[to] = 0u;
}
