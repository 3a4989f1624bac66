// Exclusive prefix sum, kernel 3 of 3: adds the start value of each block to all elements of the
// block.

@group(0) @binding(3) var<storage, read_write> scan_output: array<u32>;
@group(0) @binding(4) var<storage, read_write> scan_sums: array<u32>;

@compute @workgroup_size(SUM_GROUP)
fn scan_add(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = group.y * groups.x + group.x;
    if block >= scan.blocks {
        return;
    }
    let start = scan_sums[block];
    for (var k = 0u; k < SUM_ELEMENTS; k++) {
        let at = block * SUM_BLOCK + k * SUM_GROUP + lane;
        if at <= scan.length {
            scan_output[at] += start;
        }
    }
}
