// Counter-based random numbers: each number is a pure function of seed, stream and counter. The
// mixer is the PCG hash of Jarzynski and Olano (2020). The CPU uses a 64-bit generator
// (common/field/src/random.rs), so its random numbers differ.

fn mix_bits(x: u32) -> u32 {
    let state = x * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

fn random_bits(stream: u32, counter: u32) -> u32 {
    return mix_bits(mix_bits(mix_bits(parameters.seed) + stream) + counter);
}

// Returns a random number, uniformly distributed in [0, 1).
fn random_uniform(stream: u32, counter: u32) -> f32 {
    return f32(random_bits(stream, counter) >> 8u) * 5.9604645e-8;
}

// Returns the stream of a given kind for the current pass n: 4n for deletion, 4n + 1 for insertion,
// and 4n + 2 for the priority of newcomers. Class assignment uses streams 2^31 and above.
fn stream_of(kind: u32) -> u32 {
    return 4u * now.number + kind;
}
