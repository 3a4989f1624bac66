// Layout of the neighbour lists: tiles of LIST_TILE particles, each with the first four members of
// every list, then the next four, and so on. Adjacent invocations access adjacent memory, and a
// team that shares one list reads few cache lines.

// Index of the group of four that holds member n of the list of particle i.
fn list_slot(i: u32, n: u32) -> u32 {
    return ((i / LIST_TILE) * (parameters.list_room / 4u) + n / 4u) * LIST_TILE + i % LIST_TILE;
}
