// Density control, one round of deletion: among oversampled particles that interact, the particle
// with the highest energy is deleted. The CPU deletes particles one by one in descending order of
// energy. A few rounds with updated energies give the same result if few particles are oversampled.
// If the seeds are several times too dense, large groups of oversampled particles interact, and
// each round deletes only one particle of such a group. A GPU pass then deletes far fewer particles
// than a CPU pass.
//
// Twin: `delete` in stages/particles/src/density.rs

@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read> energies: array<f32>;
@group(0) @binding(13) var<storage, read_write> marks: array<atomic<u32>>;
@group(0) @binding(14) var<storage, read_write> touched: array<atomic<u32>>;

// Returns whether particle j still existed when this round began.
fn was_there(j: u32) -> bool {
    let mark = atomicLoad(&marks[j]);
    return mark == 0u || mark == round.number;
}

@compute @workgroup_size(PARTICLE_GROUP)
fn density_delete(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * PARTICLE_GROUP + lane;
    if i >= now.count || !was_there(i) || !is_oversampled(energies[i], i) {
        return;
    }
    let own = place[i];
    let list = list_of(i);
    for (var k = 0u; k < list.length; k++) {
        let j = member(list, k);
        let worse = energies[j] > energies[i] || (energies[j] == energies[i] && j < i);
        if worse && was_there(j) && is_oversampled(energies[j], j) {
            let other = place[j];
            if distance(own.xyz, other.xyz) < SUPPORT * min(own.w, other.w) {
                return;
            }
        }
    }
    atomicStore(&marks[i], round.number);
    for (var k = 0u; k < list.length; k++) {
        atomicStore(&touched[member(list, k)], round.number);
    }
}
