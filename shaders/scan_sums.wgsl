// Exclusive prefix sums, second of three kernels: one workgroup turns the sums of the blocks into their starts.

struct Scan {
    length: u32,
    blocks: u32,
    unused_1: u32,
    unused_2: u32,
}

@group(0) @binding(1) var<uniform> scan: Scan;
@group(0) @binding(4) var<storage, read_write> scan_sums: array<u32>;

const LANES: u32 = 256u;

var<workgroup> partial: array<u32, LANES>;

@compute @workgroup_size(256)
fn scan_sums_kernel(@builtin(local_invocation_index) lane: u32) {
    var carried = 0u;
    for (var first = 0u; first < scan.blocks; first += LANES) {
        var own = 0u;
        if first + lane < scan.blocks {
            own = scan_sums[first + lane];
        }
        partial[lane] = own;
        workgroupBarrier();
        for (var step = 1u; step < LANES; step <<= 1u) {
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
        carried += partial[LANES - 1u];
        workgroupBarrier();
    }
}
