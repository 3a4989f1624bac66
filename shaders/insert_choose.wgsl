// Density control, who is kept and who comes: one newcomer a neighbourhood and pass, the proposer of highest priority first, and
// none too near another's newcomer. Writes the flags whose prefix sum gives everybody's next place: first the old ones, then the
// newcomers.

@group(0) @binding(13) var<storage, read> marks: array<u32>;
@group(0) @binding(14) var<storage, read> proposals: array<u32>;
@group(0) @binding(15) var<storage, read> newcomer_place: array<vec4<f32>>;
@group(0) @binding(17) var<storage, read_write> keep: array<u32>;

// Two newcomers keep this share of h from each other.
const APART: f32 = 0.7;

fn beats(j: u32, i: u32) -> bool {
    let other = random_bits(stream_of(2u), j);
    let own = random_bits(stream_of(2u), i);
    return other > own || (other == own && j < i);
}

fn is_chosen(i: u32) -> bool {
    if proposals[i] == 0u {
        return false;
    }
    let own = newcomer_place[i];
    let range = list_of(i);
    for (var k = range.x; k < range.y; k++) {
        let j = lists[k];
        if proposals[j] != 0u && beats(j, i) {
            return false;
        }
        let second = list_of(j);
        for (var m = second.x; m < second.y; m++) {
            let far = lists[m];
            if far != i && proposals[far] != 0u && beats(far, i) {
                let other = newcomer_place[far];
                if distance(own.xyz, other.xyz) < APART * min(own.w, other.w) {
                    return false;
                }
            }
        }
    }
    return true;
}

@compute @workgroup_size(64)
fn insert_choose(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * 64u + lane;
    if i >= now.count {
        return;
    }
    keep[i] = select(0u, 1u, marks[i] == 0u);
    keep[now.count + i] = select(0u, 1u, is_chosen(i));
}
