// Index of a round, class or colour, which distinguishes the dispatches of the same kernel in a
// pass.

struct Round {
    number: u32,
    unused_1: u32,
    unused_2: u32,
    unused_3: u32,
}

@group(0) @binding(2) var<uniform> round: Round;
