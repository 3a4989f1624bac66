// Density control, insertion: each undersampled particle proposes a newcomer. The newcomer is
// placed one lattice spacing from the particle, in the middle of the widest gap between neighbours,
// and projected onto the surface. It is rejected if the projection fails, if its normal differs too
// much from the particle's normal, or if it is too close to another particle.
//
// Twin: `propose`, `place_in_widest_gap` in stages/particles/src/density.rs

@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> normal: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read> energies: array<f32>;
@group(0) @binding(13) var<storage, read> marks: array<u32>;
@group(0) @binding(14) var<storage, read_write> proposals: array<u32>;
@group(0) @binding(15) var<storage, read_write> newcomer_place: array<vec4<f32>>;
@group(0) @binding(16) var<storage, read_write> newcomer_normal: array<vec4<f32>>;

// Returns the direction from the particle to neighbour j, as an angle in the tangent plane in
// radians. Returns 2 TAU if j is deleted or not inside the second ring.
fn angle_of(own: vec4<f32>, plane: Plane, j: u32) -> f32 {
    let offset = place[j].xyz - own.xyz;
    let edge = parameters.spacing_in_h * own.w;
    // the radius of the second ring is SUPPORT lattice spacings
    if marks[j] != 0u || dot(offset, offset) >= SUPPORT * SUPPORT * edge * edge {
        return 2.0 * TAU;
    }
    return atan2(dot(plane.v, offset), dot(plane.u, offset));
}

// Returns the direction of the middle of the widest gap between neighbours. The lanes of the team
// share the loop over the neighbours. Of several equally wide gaps, the function uses the gap that
// starts at the neighbour with the lowest list index.
fn widest_gap(own: vec4<f32>, plane: Plane, list: List, lane: u32) -> f32 {
    var lowest = TAU;
    for (var k = lane; k < list.length; k += TEAM) {
        lowest = min(lowest, angle_of(own, plane, member(list, k)));
    }
    lowest = -team_best(vec4(-lowest, 0.0, 0.0, 0.0), lane).x;
    // components: width, index in the list, direction
    var widest = vec4(0.0);
    for (var k = lane; k < list.length; k += TEAM) {
        let angle = angle_of(own, plane, member(list, k));
        if angle > TAU {
            continue;
        }
        // angle of the next neighbour counter-clockwise; at equal angles, of the next in the list
        var next = lowest + TAU;
        for (var m = 0u; m < list.length; m++) {
            let other = angle_of(own, plane, member(list, m));
            if other < next && (other > angle || (other == angle && m > k)) {
                next = other;
            }
        }
        if next - angle > widest.x {
            widest = vec4(next - angle, f32(k), 0.5 * (angle + next), 0.0);
        }
    }
    return team_best(widest, lane).z;
}

fn propose(i: u32, lane: u32) {
    if lane == 0u {
        proposals[i] = 0u;
    }
    let own = place[i];
    let facing = normal[i].xyz;
    let plane = tangent_plane(facing);
    let list = list_of(i);
    choose_surface(normal[i].w);
    let direction = widest_gap(own, plane, list, lane);
    let edge = parameters.spacing_in_h * own.w;
    let there = project(own.xyz + edge * (plane.u * cos(direction) + plane.v * sin(direction)), edge, lane);
    if !there.found || dot(there.normal, facing) <= parameters.normal_agreement
        || distance(there.position, own.xyz) <= parameters.parent_distance * min(own.w, there.size) {
        return;
    }
    var too_near = 0.0;
    for (var k = lane; k < list.length; k += TEAM) {
        let other = place[member(list, k)];
        if marks[member(list, k)] == 0u && distance(there.position, other.xyz) <= parameters.newcomer_distance * min(there.size, other.w) {
            too_near = 1.0;
        }
    }
    if team_sum(vec4(too_near), lane).x == 0.0 && lane == 0u {
        proposals[i] = 1u;
        newcomer_place[i] = vec4(there.position, there.size);
        newcomer_normal[i] = vec4(there.normal, with_damping(normal[i].w, parameters.initial_lambda));
    }
}

// Undersampled particles among the PARTICLE_GROUP particles of the workgroup, in arbitrary order.
var<workgroup> lacking: array<u32, PARTICLE_GROUP>;
var<workgroup> lacking_count: atomic<u32>;

@compute @workgroup_size(TEAM * TEAMS)
fn insert_propose(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    if local == 0u {
        atomicStore(&lacking_count, 0u);
    }
    workgroupBarrier();
    let first = flat_group(group, groups) * PARTICLE_GROUP;
    for (var i = first + local; i < min(first + PARTICLE_GROUP, now.count); i += TEAM * TEAMS) {
        if now.allow_insert != 0u && marks[i] == 0u && !is_held(normal[i].w) && is_undersampled(energies[i], i) {
            lacking[atomicAdd(&lacking_count, 1u)] = i;
        } else {
            proposals[i] = 0u;
        }
    }
    workgroupBarrier();
    // a team processes each undersampled particle; these are few, so with one invocation per
    // particle most lanes would be idle
    let count = atomicLoad(&lacking_count);
    for (var k = local / TEAM; k < count; k += TEAMS) {
        propose(lacking[k], local % TEAM);
    }
}
