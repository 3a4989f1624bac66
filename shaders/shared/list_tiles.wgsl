// Where the members of neighbour lists lie: in tiles of LIST_TILE particles, of each four members, then the next four of each. So one invocation a particle reads and writes
// beside its neighbours, and a team that shares out a list reads few pieces.

// The four that hold member n of the list of particle i.
fn list_slot(i: u32, n: u32) -> u32 {
    return ((i / LIST_TILE) * (parameters.list_room / 4u) + n / 4u) * LIST_TILE + i % LIST_TILE;
}
