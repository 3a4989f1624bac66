// Writes the indices of the particles, class by class. The order within a class is arbitrary; it
// has no effect because members of a class do not interact.

@group(0) @binding(3) var<storage, read> classes: array<u32>;
@group(0) @binding(4) var<storage, read_write> class_counts: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> class_members: array<u32>;

var<workgroup> here: array<atomic<u32>, CLASSES>;
var<workgroup> first: array<u32, CLASSES>;

@compute @workgroup_size(SUM_GROUP)
fn class_scatter(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    if lane < CLASSES {
        atomicStore(&here[lane], 0u);
    }
    workgroupBarrier();
    let i = flat_group(group, groups) * SUM_GROUP + lane;
    var own = UNCLASSED;
    var rank = 0u;
    if i < now.count {
        own = classes[i];
        if own < CLASSES {
            rank = atomicAdd(&here[own], 1u);
        }
    }
    workgroupBarrier();
    if lane < CLASSES {
        let count = atomicLoad(&here[lane]);
        if count > 0u {
            first[lane] = atomicAdd(&class_counts[lane], count);
        }
    }
    workgroupBarrier();
    if own < CLASSES {
        class_members[first[own] + rank] = i;
    }
}
