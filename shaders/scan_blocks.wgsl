// Exclusive prefix sum, kernel 1 of 3: computes the prefix sum within each block of SUM_BLOCK
// elements. The output has one element more than the input; the last element is the total.

@group(0) @binding(2) var<storage, read> scan_input: array<u32>;
@group(0) @binding(3) var<storage, read_write> scan_output: array<u32>;
@group(0) @binding(4) var<storage, read_write> scan_sums: array<u32>;

var<workgroup> lane_sums: array<u32, SUM_GROUP>;

@compute @workgroup_size(SUM_GROUP)
fn scan_blocks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = group.y * groups.x + group.x;
    let first = (block * SUM_GROUP + lane) * SUM_ELEMENTS;
    var values: array<u32, SUM_ELEMENTS>;
    var sum = 0u;
    for (var k = 0u; k < SUM_ELEMENTS; k++) {
        values[k] = sum;
        if first + k < scan.length {
            sum += scan_input[first + k];
        }
    }
    lane_sums[lane] = sum;
    workgroupBarrier();
    for (var step = 1u; step < SUM_GROUP; step <<= 1u) {
        var before = 0u;
        if lane >= step {
            before = lane_sums[lane - step];
        }
        workgroupBarrier();
        lane_sums[lane] += before;
        workgroupBarrier();
    }
    let start = lane_sums[lane] - sum;
    for (var k = 0u; k < SUM_ELEMENTS; k++) {
        if first + k <= scan.length {
            scan_output[first + k] = start + values[k];
        }
    }
    if lane == SUM_GROUP - 1u && block < scan.blocks {
        scan_sums[block] = lane_sums[lane];
    }
}
