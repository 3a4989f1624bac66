// Exclusive prefix sum, kernel 2 of 3: a single workgroup turns the sums of the blocks into their
// start values.

@group(0) @binding(4) var<storage, read_write> scan_sums: array<u32>;

var<workgroup> partial: array<u32, WIDE>;

@compute @workgroup_size(WIDE)
fn scan_sums_kernel(@builtin(local_invocation_index) lane: u32) {
    var carried = 0u;
    for (var first = 0u; first < scan.blocks; first += WIDE) {
        var own = 0u;
        if first + lane < scan.blocks {
            own = scan_sums[first + lane];
        }
        partial[lane] = own;
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
        if first + lane < scan.blocks {
            scan_sums[first + lane] = carried + partial[lane] - own;
        }
        carried += partial[WIDE - 1u];
        workgroupBarrier();
    }
}
