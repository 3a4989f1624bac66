// Neighbour lists. Each list has room for list_room members, so a single walk over the bins fills
// all lists.

@group(0) @binding(10) var<storage, read> list_lengths: array<u32>;
@group(0) @binding(11) var<storage, read> lists: array<vec4<u32>>;

struct List {
    particle: u32,
    length: u32,
}

// Returns the list of particle i. A list that exceeds list_room is truncated. The host detects this
// and repeats the pass.
fn list_of(i: u32) -> List {
    return List(i, min(list_lengths[i], parameters.list_room));
}

fn member(list: List, n: u32) -> u32 {
    return lists[list_slot(list.particle, n)][n % 4u];
}
