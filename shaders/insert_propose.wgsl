// Density control, insertion: a particle where the surface is undersampled proposes a newcomer at one spacing of the lattice in the middle of its widest gap, on the surface,
// where it has room.
//
// Twin: `propose`, `place_in_widest_gap` in stages/particles/src/density.rs

@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> normal: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read> energies: array<f32>;
@group(0) @binding(13) var<storage, read> marks: array<u32>;
@group(0) @binding(14) var<storage, read_write> proposals: array<u32>;
@group(0) @binding(15) var<storage, read_write> newcomer_place: array<vec4<f32>>;
@group(0) @binding(16) var<storage, read_write> newcomer_normal: array<vec4<f32>>;

// The angle under which particle i sees neighbour j in the tangent plane; beyond a turn when j does not count.
fn angle_of(own: vec4<f32>, plane: Plane, j: u32) -> f32 {
    let offset = place[j].xyz - own.xyz;
    let edge = parameters.spacing_in_h * own.w;
    // the second ring of a lattice is as many of its edges away as the support is h
    if marks[j] != 0u || dot(offset, offset) >= SUPPORT * SUPPORT * edge * edge {
        return 2.0 * TAU;
    }
    return atan2(dot(plane.v, offset), dot(plane.u, offset));
}

fn widest_gap(own: vec4<f32>, plane: Plane, range: vec2<u32>) -> f32 {
    var lowest = TAU;
    for (var k = range.x; k < range.y; k++) {
        lowest = min(lowest, angle_of(own, plane, lists[k]));
    }
    var widest = 0.0;
    var direction = 0.0;
    for (var k = range.x; k < range.y; k++) {
        let angle = angle_of(own, plane, lists[k]);
        if angle > TAU {
            continue;
        }
        // the next one round; of equal angles the later in the list is the next
        var next = lowest + TAU;
        for (var m = range.x; m < range.y; m++) {
            let other = angle_of(own, plane, lists[m]);
            if other < next && (other > angle || (other == angle && m > k)) {
                next = other;
            }
        }
        if next - angle > widest {
            widest = next - angle;
            direction = 0.5 * (angle + next);
        }
    }
    return direction;
}

@compute @workgroup_size(NARROW)
fn insert_propose(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * NARROW + lane;
    if i >= now.count {
        return;
    }
    proposals[i] = 0u;
    if now.allow_insert == 0u || marks[i] != 0u || is_held(normal[i].w) || !is_undersampled(energies[i], i) {
        return;
    }
    let own = place[i];
    let facing = normal[i].xyz;
    let plane = tangent_plane(facing);
    let range = list_of(i);
    choose_surface(normal[i].w);
    let direction = widest_gap(own, plane, range);
    let edge = parameters.spacing_in_h * own.w;
    let there = project(own.xyz + edge * (plane.u * cos(direction) + plane.v * sin(direction)), edge, lane);
    if !there.found || dot(there.normal, facing) <= parameters.normal_agreement
        || distance(there.position, own.xyz) <= parameters.parent_distance * min(own.w, there.size) {
        return;
    }
    for (var k = range.x; k < range.y; k++) {
        let other = place[lists[k]];
        if marks[lists[k]] == 0u && distance(there.position, other.xyz) <= parameters.newcomer_distance * min(there.size, other.w) {
            return;
        }
    }
    proposals[i] = 1u;
    newcomer_place[i] = vec4(there.position, there.size);
    newcomer_normal[i] = vec4(there.normal, with_damping(normal[i].w, parameters.initial_lambda));
}
