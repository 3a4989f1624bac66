// Independent classes: no two members of a class are neighbours, so all may move at once.
//
// Twin: `independent_blocks` in common/field/src/neighbours.rs

// Priority of particle i in a round. Of neighbours that propose the same class, the one with the
// highest priority gets it.
fn class_priority(i: u32, round: u32) -> u32 {
    return random_bits(0x80000000u + 16u * now.number + round, i);
}
