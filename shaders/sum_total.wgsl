// Totals of a pass, second step: one workgroup adds up the blocks in a fixed order and writes the words that the host reads.

@group(0) @binding(6) var<storage, read> block_totals: array<vec4<u32>>;
@group(0) @binding(10) var<storage, read> list_starts: array<u32>;
// Energy (bits of an f32), moved, tries, longest way since the lists were made over h (bits of an f32), members of all lists, particles after density control, kept of the old ones.
@group(0) @binding(15) var<storage, read_write> words: array<u32>;

var<workgroup> partial: array<vec4<u32>, 256>;

@compute @workgroup_size(256)
fn sum_total(@builtin(local_invocation_index) lane: u32) {
    let blocks = (now.count + 2047u) / 2048u;
    var energy = 0.0;
    var totals = vec4(0u);
    for (var block = lane; block < blocks; block += 256u) {
        let own = block_totals[block];
        energy += bitcast<f32>(own.x);
        totals = vec4(0u, totals.yz + own.yz, max(totals.w, own.w));
    }
    totals.x = bitcast<u32>(energy);
    partial[lane] = totals;
    workgroupBarrier();
    for (var step = 128u; step > 0u; step >>= 1u) {
        if lane < step {
            let a = partial[lane];
            let b = partial[lane + step];
            // bits of positive numbers are in the numbers' order
            partial[lane] = vec4(bitcast<u32>(bitcast<f32>(a.x) + bitcast<f32>(b.x)), a.yz + b.yz, max(a.w, b.w));
        }
        workgroupBarrier();
    }
    if lane == 0u {
        words[0] = partial[0].x;
        words[1] = partial[0].y;
        words[2] = partial[0].z;
        words[3] = partial[0].w;
        words[4] = list_starts[now.count];
        words[5] = now.count;
        words[6] = now.count;
    }
}
