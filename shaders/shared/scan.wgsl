// Parameters of a prefix sum. An invocation processes SUM_ELEMENTS elements, and a workgroup
// processes a block of SUM_GROUP * SUM_ELEMENTS elements.

struct Scan {
    // Length of the input. The output has one more element.
    length: u32,
    blocks: u32,
    unused_1: u32,
    unused_2: u32,
}

@group(0) @binding(1) var<uniform> scan: Scan;
