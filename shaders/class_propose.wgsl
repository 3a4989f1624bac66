// Class assignment, first half of a round: each particle without a class proposes a class that none
// of its neighbours has. The class is chosen at random from the free classes among the first
// sixteen. If all sixteen are taken, it is chosen from the next three free classes. The higher
// classes therefore stay mostly empty, and fewer classes need a dispatch.

@group(0) @binding(3) var<storage, read> classes: array<u32>;
@group(0) @binding(4) var<storage, read_write> proposed_classes: array<u32>;

@compute @workgroup_size(PARTICLE_GROUP)
fn class_propose(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * PARTICLE_GROUP + lane;
    if i >= now.count {
        return;
    }
    if classes[i] < CLASSES && round.number > 0u {
        proposed_classes[i] = UNCLASSED;
        return;
    }
    var taken = 0u;
    if round.number > 0u {
        let list = list_of(i);
        for (var k = 0u; k < list.length; k++) {
            let class_of_other = classes[member(list, k)];
            if class_of_other < CLASSES {
                taken |= 1u << class_of_other;
            }
        }
    }
    var free = ~taken & 0xffffu;
    var choices = 16u;
    if free == 0u {
        free = ~taken;
        choices = 3u;
    }
    var choice = UNCLASSED;
    if free != 0u {
        // selects the n-th free class
        var n = random_bits(0xc0000000u + 16u * now.number + round.number, i) % min(choices, countOneBits(free));
        while n > 0u {
            free &= free - 1u;
            n--;
        }
        choice = countTrailingZeros(free);
    }
    proposed_classes[i] = choice;
}
