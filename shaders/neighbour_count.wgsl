// How many neighbours each particle has; the prefix sum of these gives the starts of the lists.

@group(0) @binding(13) var<storage, read_write> neighbour_counts: array<u32>;

fn found(n: u32, j: u32) {}

@compute @workgroup_size(NARROW)
fn neighbour_count(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * NARROW + lane;
    if i < now.count {
        neighbour_counts[i] = walk_neighbours(i);
    }
}
