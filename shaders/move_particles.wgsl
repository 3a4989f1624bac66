// Moves each particle of one class once (sections 3.2.1 and 3.2.2, Algorithm 1 of the paper). A
// team of lanes moves each particle.
//
// Teams do not conflict: each reads its particle and the neighbours in the particle's list, and
// writes only the particle. No two members of a class are in each other's lists.
//
// Twin: `pass` in stages/particles/src/movement.rs

@group(0) @binding(5) var<storage, read> class_starts: array<u32>;
@group(0) @binding(6) var<storage, read> class_members: array<u32>;

@compute @workgroup_size(TEAM * TEAMS)
fn move_particles(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let member = class_starts[round.number] + flat_group(group, groups) * TEAMS + local / TEAM;
    if member < class_starts[round.number + 1u] {
        move_particle(class_members[member], local % TEAM);
    }
}
