// Exclusive prefix sum, kernel 2 of 3: a single workgroup computes the start value of each block,
// which is the sum over all previous blocks.

@group(0) @binding(4) var<storage, read_write> scan_sums: array<u32>;

var<workgroup> lane_sums: array<u32, SUM_GROUP>;

@compute @workgroup_size(SUM_GROUP)
fn scan_sums_kernel(@builtin(local_invocation_index) lane: u32) {
    var carried = 0u;
    for (var first = 0u; first < scan.blocks; first += SUM_GROUP) {
        var own = 0u;
        if first + lane < scan.blocks {
            own = scan_sums[first + lane];
        }
        lane_sums[lane] = own;
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
        if first + lane < scan.blocks {
            scan_sums[first + lane] = carried + lane_sums[lane] - own;
        }
        carried += lane_sums[SUM_GROUP - 1u];
        workgroupBarrier();
    }
}
