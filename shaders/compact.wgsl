// Density control, last step: writes the remaining particles, followed by the newcomers. There are
// two sets of `listed_*` buffers; the output goes to the set that the pass did not read. If a list
// was truncated, the kernel does nothing and the host repeats the pass. If too few classes were
// dispatched, the host ignores the output and repeats the pass as well.

@group(0) @binding(2) var<storage, read_write> listed_place: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> keep: array<u32>;
@group(0) @binding(4) var<storage, read> destinations: array<u32>;
@group(0) @binding(5) var<storage, read> newcomer_place: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> newcomer_normal: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> listed_normal: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> normal: array<vec4<f32>>;
@group(0) @binding(15) var<storage, read_write> words: array<u32>;

@compute @workgroup_size(PARTICLE_GROUP)
fn compact(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * PARTICLE_GROUP + lane;
    let kept = destinations[now.count];
    let total = destinations[2u * now.count];
    if i >= now.count || words[WORD_LONGEST_LIST] > parameters.list_room {
        return;
    }
    if keep[i] != 0u {
        listed_place[destinations[i]] = place[i];
        listed_normal[destinations[i]] = normal[i];
    }
    if keep[now.count + i] != 0u {
        listed_place[destinations[now.count + i]] = newcomer_place[i];
        listed_normal[destinations[now.count + i]] = newcomer_normal[i];
    }
    if i == 0u {
        words[WORD_COUNT] = total;
        words[WORD_KEPT] = kept;
    }
}
