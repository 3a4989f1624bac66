// Density control, after each round of deletion: subtracts the pair energies of the particles
// deleted in the round from the energies of their remaining neighbours.

@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read_write> energies: array<f32>;
@group(0) @binding(13) var<storage, read> marks: array<u32>;
@group(0) @binding(14) var<storage, read> touched: array<u32>;

@compute @workgroup_size(PARTICLE_GROUP)
fn density_relieve(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * PARTICLE_GROUP + lane;
    if i >= now.count || marks[i] != 0u || touched[i] != round.number {
        return;
    }
    let own = place[i];
    let list = list_of(i);
    var sum = 0.0;
    for (var k = 0u; k < list.length; k++) {
        let j = member(list, k);
        if marks[j] == round.number {
            let other = place[j];
            sum += energy_between(own.xyz - other.xyz, own.w, other.w);
        }
    }
    energies[i] -= sum;
}
