// Classes of particles that may move together: no two members are neighbours.
//
// Twin: `independent_classes` in common/field/src/neighbours.rs

// Which of two particles that want the same class gets it.
fn class_priority(i: u32, round: u32) -> u32 {
    return random_bits(0x80000000u + 16u * now.number + round, i);
}
