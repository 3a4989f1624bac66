// Counts the particles in each class.

@group(0) @binding(3) var<storage, read> classes: array<u32>;
@group(0) @binding(4) var<storage, read_write> class_counts: array<atomic<u32>>;

var<workgroup> here: array<atomic<u32>, CLASSES>;

@compute @workgroup_size(SUM_GROUP)
fn class_count(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    if lane < CLASSES {
        atomicStore(&here[lane], 0u);
    }
    workgroupBarrier();
    let i = flat_group(group, groups) * SUM_GROUP + lane;
    if i < now.count && classes[i] < CLASSES {
        atomicAdd(&here[classes[i]], 1u);
    }
    workgroupBarrier();
    if lane < CLASSES {
        let count = atomicLoad(&here[lane]);
        if count > 0u {
            atomicAdd(&class_counts[lane], count);
        }
    }
}
