// Exclusive prefix sum, kernel 1 of 3: computes the prefix sum within each block of BLOCK numbers.
// The last output value is the total.

@group(0) @binding(2) var<storage, read> scan_input: array<u32>;
@group(0) @binding(3) var<storage, read_write> scan_output: array<u32>;
@group(0) @binding(4) var<storage, read_write> scan_sums: array<u32>;

var<workgroup> partial: array<u32, WIDE>;

@compute @workgroup_size(WIDE)
fn scan_blocks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = group.y * groups.x + group.x;
    let first = (block * WIDE + lane) * EACH;
    var values: array<u32, EACH>;
    var sum = 0u;
    for (var k = 0u; k < EACH; k++) {
        values[k] = sum;
        if first + k < scan.length {
            sum += scan_input[first + k];
        }
    }
    partial[lane] = sum;
    workgroupBarrier();
    for (var step = 1u; step < WIDE; step <<= 1u) {
        var before = 0u;
        if lane >= step {
            before = partial[lane - step];
        }
        workgroupBarrier();
        partial[lane] += before;
        workgroupBarrier();
    }
    let start = partial[lane] - sum;
    for (var k = 0u; k < EACH; k++) {
        if first + k <= scan.length {
            scan_output[first + k] = start + values[k];
        }
    }
    if lane == WIDE - 1u && block < scan.blocks {
        scan_sums[block] = partial[lane];
    }
}
