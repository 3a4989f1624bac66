// Neighbour lists. Each has room for list_room members, so that one walk over the bins fills them.

@group(0) @binding(10) var<storage, read> list_lengths: array<u32>;
@group(0) @binding(11) var<storage, read> lists: array<vec4<u32>>;

struct List {
    particle: u32,
    length: u32,
}

// The list of particle i. A list that exceeds its room is truncated; the host detects this and
// repeats the pass.
fn list_of(i: u32) -> List {
    return List(i, min(list_lengths[i], parameters.list_room));
}

fn member(list: List, n: u32) -> u32 {
    return lists[list_slot(list.particle, n)][n % 4u];
}
