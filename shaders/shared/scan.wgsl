// What a prefix sum adds up. One invocation takes EACH numbers, one workgroup a block of WIDE * EACH.

struct Scan {
    // Numbers to add up; the result has one more.
    length: u32,
    blocks: u32,
    unused_1: u32,
    unused_2: u32,
}

@group(0) @binding(1) var<uniform> scan: Scan;
