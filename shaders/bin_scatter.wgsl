// Counting sort into bins, step 2: writes the indices of the particles bin by bin. The order within
// a bin is arbitrary. This step also decrements the counts to zero for the next sort.

@group(0) @binding(3) var<storage, read> bin_of: array<u32>;
@group(0) @binding(4) var<storage, read_write> bin_counts: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read> bin_starts: array<u32>;
@group(0) @binding(6) var<storage, read_write> order: array<u32>;

@compute @workgroup_size(PARTICLE_GROUP)
fn bin_scatter(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * PARTICLE_GROUP + lane;
    if i >= now.count {
        return;
    }
    let bin = bin_of[i];
    order[bin_starts[bin] + atomicSub(&bin_counts[bin], 1u) - 1u] = i;
}
