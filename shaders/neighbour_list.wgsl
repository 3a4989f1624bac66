// Builds the neighbour lists, writing four members at a time. The stored length counts all
// neighbours, including those that do not fit into the list.
//
// Twin: `NeighbourLists` in common/field/src/neighbours.rs

@group(0) @binding(10) var<storage, read_write> list_lengths: array<u32>;
@group(0) @binding(11) var<storage, read_write> lists: array<vec4<u32>>;

var<private> particle: u32;
// The last four members found, with the most recent one in w.
var<private> last_four: vec4<u32>;

fn found(n: u32, j: u32) {
    last_four = vec4(last_four.yzw, j);
    if n % 4u == 3u && n < parameters.list_room {
        lists[list_slot(particle, n)] = last_four;
    }
}

@compute @workgroup_size(PARTICLE_GROUP)
fn neighbour_list(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * PARTICLE_GROUP + lane;
    if i >= now.count {
        return;
    }
    particle = i;
    let length = walk_neighbours(i);
    list_lengths[i] = length;
    let rest = length % 4u;
    if rest > 0u && length < parameters.list_room {
        // the last group has one to three members, which must be at its front
        let four = select(select(vec4(last_four.w), last_four.zwzw, rest == 2u), last_four.yzwy, rest == 3u);
        lists[list_slot(i, length)] = four;
    }
}
