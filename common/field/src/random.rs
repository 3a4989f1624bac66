//! Generates counter-based random numbers. Each number is a pure function of the seed, stream and
//! counter, so results do not depend on the order of evaluation or on the number of threads.

/// Returns 64 well-mixed bits for a (seed, stream, counter) triple: the finaliser of SplitMix64,
/// applied three times.
pub fn bits(seed: u64, stream: u64, counter: u64) -> u64 {
    mix(mix(mix(seed ^ 0x9e37_79b9_7f4a_7c15).wrapping_add(stream)).wrapping_add(counter))
}

/// Returns a uniform random number in [0, 1).
pub fn uniform(seed: u64, stream: u64, counter: u64) -> f64 {
    (bits(seed, stream, counter) >> 11) as f64 / (1u64 << 53) as f64
}

fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}
