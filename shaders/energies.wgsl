// Computes the energy (Eq. 1) and the lattice-defect flag of every particle, and resets the marks
// of density control. Particles with a held particle in their first ring are not counted as
// defects.
//
// Twin: `measure` in stages/particles/src/state.rs

@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> normal: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read_write> energies: array<f32>;
// Mark of each particle: 0 if it is kept, n if it was deleted in round n.
@group(0) @binding(13) var<storage, read_write> marks: array<u32>;
// Last round that deleted a neighbour of the particle; 0 if there is none.
@group(0) @binding(14) var<storage, read_write> touched: array<u32>;

// Number of attempted steps, combined with the flags STEP_TAKEN and LATTICE_DEFECT.
@group(0) @binding(15) var<storage, read_write> outcome: array<u32>;

@compute @workgroup_size(PARTICLE_GROUP)
fn energies_kernel(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * PARTICLE_GROUP + lane;
    if i >= now.count {
        return;
    }
    let own = place[i];
    let list = list_of(i);
    var sum = 0.0;
    var ring = 0u;
    let held = is_held(normal[i].w);
    var at_border = held;
    for (var k = 0u; k < list.length; k++) {
        let other = place[member(list, k)];
        let offset = own.xyz - other.xyz;
        sum += energy_between(offset, own.w, other.w);
        let reach = parameters.first_ring * min(own.w, other.w);
        let is_in_ring = dot(offset, offset) < reach * reach;
        ring += select(0u, 1u, is_in_ring);
        at_border = at_border || (is_in_ring && is_held(normal[member(list, k)].w));
    }
    energies[i] = select(sum, 0.0, held);
    outcome[i] = (outcome[i] & ~LATTICE_DEFECT) | select(0u, LATTICE_DEFECT, ring != LATTICE_NEIGHBOURS && !at_border);
    marks[i] = 0u;
    touched[i] = 0u;
}
