// Writes the neighbour lists.
//
// Twin: `NeighbourLists` in common/field/src/neighbours.rs

@group(0) @binding(10) var<storage, read> list_starts: array<u32>;
@group(0) @binding(11) var<storage, read_write> lists: array<u32>;

var<private> list_first: u32;

fn found(n: u32, j: u32) {
    if list_first + n < parameters.list_capacity {
        lists[list_first + n] = j;
    }
}

@compute @workgroup_size(NARROW)
fn neighbour_fill(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * NARROW + lane;
    if i < now.count {
        list_first = list_starts[i];
        walk_neighbours(i);
    }
}
