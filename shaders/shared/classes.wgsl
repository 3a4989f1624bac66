// Independent classes: no two members of a class are neighbours, so all members can move
// concurrently.
//
// Twin: `independent_blocks` in common/field/src/neighbours.rs

// Returns the priority of particle i in a round. If neighbours propose the same class, the
// neighbour with the highest priority gets it.
fn class_priority(i: u32, round: u32) -> u32 {
    return random_bits(0x80000000u + 16u * now.number + round, i);
}
