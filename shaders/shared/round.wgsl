// Index of the round, class or colour, depending on the kernel. It distinguishes the dispatches of
// one kernel in a pass.

struct Round {
    number: u32,
    unused_1: u32,
    unused_2: u32,
    unused_3: u32,
}

@group(0) @binding(2) var<uniform> round: Round;
