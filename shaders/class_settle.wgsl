// Class assignment, second half of a round: if neighbours propose the same class, the neighbour
// with the highest priority gets it. A particle that has no class after the last round does not
// move until the lists are rebuilt.

@group(0) @binding(3) var<storage, read_write> classes: array<u32>;
@group(0) @binding(4) var<storage, read> proposed_classes: array<u32>;

@compute @workgroup_size(PARTICLE_GROUP)
fn class_settle(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * PARTICLE_GROUP + lane;
    if i >= now.count {
        return;
    }
    let choice = proposed_classes[i];
    if round.number == 0u {
        classes[i] = UNCLASSED;
    }
    if choice == UNCLASSED {
        return;
    }
    let priority = class_priority(i, round.number);
    let list = list_of(i);
    for (var k = 0u; k < list.length; k++) {
        let j = member(list, k);
        if proposed_classes[j] == choice {
            let other = class_priority(j, round.number);
            if other > priority || (other == priority && j < i) {
                return;
            }
        }
    }
    classes[i] = choice;
}
