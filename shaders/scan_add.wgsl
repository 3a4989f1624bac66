// Exclusive prefix sums, third of three kernels: adds the start of its block to every number.

struct Scan {
    length: u32,
    blocks: u32,
    unused_1: u32,
    unused_2: u32,
}

@group(0) @binding(1) var<uniform> scan: Scan;
@group(0) @binding(3) var<storage, read_write> scan_output: array<u32>;
@group(0) @binding(4) var<storage, read_write> scan_sums: array<u32>;

const EACH: u32 = 8u;

@compute @workgroup_size(256)
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
    for (var k = 0u; k < EACH; k++) {
        let at = block * 2048u + k * 256u + lane;
        if at <= scan.length {
            scan_output[at] += start;
        }
    }
}
