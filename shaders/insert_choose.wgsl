// Density control: selects the particles to keep and the newcomers to insert. Two newcomers
// conflict if their parents are neighbours or if the newcomers are closer together than
// newcomer_distance. A newcomer is inserted only if its parent has a higher random priority than
// the parents of all conflicting newcomers. The kernel writes flags whose prefix sum gives the new
// indices: first the kept particles, then the newcomers.
//
// Twin: `insert` in stages/particles/src/density.rs

@group(0) @binding(5) var<storage, read> bin_starts: array<u32>;
@group(0) @binding(13) var<storage, read> marks: array<u32>;
@group(0) @binding(14) var<storage, read> proposals: array<u32>;
@group(0) @binding(15) var<storage, read> newcomer_place: array<vec4<f32>>;
@group(0) @binding(16) var<storage, read> newcomer_normal: array<vec4<f32>>;
@group(0) @binding(17) var<storage, read_write> keep: array<u32>;

fn beats(j: u32, i: u32) -> bool {
    let other = random_bits(stream_of(2u), j);
    let own = random_bits(stream_of(2u), i);
    return other > own || (other == own && j < i);
}

// Returns whether the newcomer of i is too close to a newcomer of higher priority. The parents are
// in the bins of their positions at the time of the sort. Since then, a parent with target edge
// length h has moved by at most (REBUILD_MOVE + FARTHEST_MOVE) h. A newcomer is within two lattice
// spacings of its parent: it starts one spacing away, and the projection displaces it by at most
// one spacing.
fn is_too_near(i: u32) -> bool {
    let own = newcomer_place[i];
    let facing = newcomer_normal[i];
    for (var level = 0u; level < parameters.level_count; level++) {
        let farthest = 2.0 * parameters.spacing_in_h + REBUILD_MOVE + FARTHEST_MOVE;
        let radius = parameters.newcomer_distance * own.w + farthest * parameters.levels[level].largest;
        let low = bin_coordinate(own.xyz - radius, level);
        let high = bin_coordinate(own.xyz + radius, level);
        for (var z = low.z; z <= high.z; z++) {
            for (var y = low.y; y <= high.y; y++) {
                let first = bin_starts[bin_number(vec3(low.x, y, z), level)];
                let end = bin_starts[bin_number(vec3(high.x, y, z), level) + 1u];
                for (var j = first; j < end; j++) {
                    if j == i || proposals[j] == 0u || !beats(j, i) {
                        continue;
                    }
                    let other = newcomer_place[j];
                    let near = distance(own.xyz, other.xyz) < parameters.newcomer_distance * min(own.w, other.w);
                    if near && see_each_other(facing, newcomer_normal[j]) {
                        return true;
                    }
                }
            }
        }
    }
    return false;
}

fn is_chosen(i: u32) -> bool {
    if proposals[i] == 0u {
        return false;
    }
    let list = list_of(i);
    for (var k = 0u; k < list.length; k++) {
        let j = member(list, k);
        if proposals[j] != 0u && beats(j, i) {
            return false;
        }
    }
    return !is_too_near(i);
}

@compute @workgroup_size(PARTICLE_GROUP)
fn insert_choose(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * PARTICLE_GROUP + lane;
    if i >= now.count {
        return;
    }
    keep[i] = select(0u, 1u, marks[i] == 0u);
    keep[now.count + i] = select(0u, 1u, is_chosen(i));
}
