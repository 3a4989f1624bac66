// Parameters of a prefix sum. One invocation takes EACH numbers, one workgroup a block of WIDE *
// EACH.

struct Scan {
    // Length of the input; the result has one number more.
    length: u32,
    blocks: u32,
    unused_1: u32,
    unused_2: u32,
}

@group(0) @binding(1) var<uniform> scan: Scan;
