// Memory layout of the neighbour lists. The lists of LIST_TILE particles form a tile. A tile stores
// the first four members of every list, then the next four members of every list, and so on.
// Adjacent invocations therefore access adjacent memory, and a team that shares one list touches
// few cache lines.

// Returns the index of the group of four that contains member n of the list of particle i.
fn list_slot(i: u32, n: u32) -> u32 {
    return ((i / LIST_TILE) * (parameters.list_room / 4u) + n / 4u) * LIST_TILE + i % LIST_TILE;
}
