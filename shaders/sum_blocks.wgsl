// Totals of a pass, first step: energy, particles moved, steps tried, and the longest way of a particle since the lists were
// made, by blocks of 2048 particles and in a fixed order.

@group(0) @binding(3) var<storage, read> energies: array<f32>;
@group(0) @binding(4) var<storage, read> outcome: array<u32>;
@group(0) @binding(5) var<storage, read> place_at_listing: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> block_totals: array<vec4<u32>>;
@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;

var<workgroup> partial: array<vec4<u32>, 256>;

@compute @workgroup_size(256)
fn sum_blocks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_group(group, groups);
    var energy = 0.0;
    var longest = 0.0;
    var totals = vec4(0u);
    for (var k = 0u; k < 8u; k++) {
        let i = (block * 8u + k) * 256u + lane;
        if i < now.count {
            energy += energies[i];
            let own = place[i];
            longest = max(longest, distance(own.xyz, place_at_listing[i].xyz) / own.w);
            totals += vec4(0u, outcome[i] >> 31u, outcome[i] & 0x7fffffffu, 0u);
        }
    }
    totals.x = bitcast<u32>(energy);
    totals.w = bitcast<u32>(longest);
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
    if lane == 0u && block * 2048u < now.count {
        block_totals[block] = partial[0];
    }
}
