// Totals of a pass, step 1: computes the totals of each block of SUM_BLOCK particles.

@group(0) @binding(3) var<storage, read> energies: array<f32>;
@group(0) @binding(4) var<storage, read> outcome: array<u32>;
@group(0) @binding(5) var<storage, read> place_at_listing: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> block_totals: array<Totals>;
@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read> list_lengths: array<u32>;

@compute @workgroup_size(SUM_GROUP)
fn sum_blocks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_group(group, groups);
    var own = Totals();
    for (var k = 0u; k < SUM_ELEMENTS; k++) {
        let i = (block * SUM_ELEMENTS + k) * SUM_GROUP + lane;
        if i < now.count {
            let particle = place[i];
            let way = distance(particle.xyz, place_at_listing[i].xyz) / particle.w;
            let bits = outcome[i];
            own = add_totals(own, Totals(
                energies[i],
                way,
                select(0u, 1u, (bits & STEP_TAKEN) != 0u),
                bits & ~(STEP_TAKEN | LATTICE_DEFECT),
                select(0u, 1u, (bits & LATTICE_DEFECT) != 0u),
                list_lengths[i],
                list_lengths[i],
            ));
        }
    }
    let total = total_of_group(own, lane);
    if lane == 0u && block * SUM_BLOCK < now.count {
        block_totals[block] = total;
    }
}
