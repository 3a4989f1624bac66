// Neighbour lists. Each list has a fixed capacity of list_room members, so that a single walk over
// the bins can fill it.

@group(0) @binding(10) var<storage, read> list_lengths: array<u32>;
@group(0) @binding(11) var<storage, read> lists: array<vec4<u32>>;

struct List {
    particle: u32,
    length: u32,
}

// Returns the list of particle i. A list with more than list_room members is truncated; the host
// detects this and repeats the pass.
fn list_of(i: u32) -> List {
    return List(i, min(list_lengths[i], parameters.list_room));
}

fn member(list: List, n: u32) -> u32 {
    return lists[list_slot(list.particle, n)][n % 4u];
}
