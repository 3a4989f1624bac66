// F and the projection onto F = 0 by a team: the 64 taps are spread over its lanes, each lane's written out (see two_taps).

fn team_surface_at(position: vec3<f32>, lane: u32) -> vec4<f32> {
    let cell = cell_at(position);
    let plane = lane & 15u;
    var sum = vec4(0.0);
    if TEAM == 32u {
        sum = two_taps(cell, plane, 2u * (lane >> 4u));
    } else {
        sum = four_taps(cell, plane);
        if TEAM <= 8u {
            sum += four_taps(cell, plane + 8u);
        }
        if TEAM <= 4u {
            sum += four_taps(cell, plane + 4u) + four_taps(cell, plane + 12u);
        }
    }
    sum = team_sum(sum, lane);
    return vec4(sum.xyz * parameters.inverse_spacing, sum.w);
}

fn team_project(start: vec3<f32>, limit: f32, lane: u32) -> Projected {
    var p = start;
    for (var step = 0u; step < MOST_PROJECTION_STEPS; step++) {
        let field = team_surface_at(p, lane);
        let state = projection_state(field);
        if state == 2u {
            break;
        }
        if state == 1u {
            return Projected(p, true, normalize(field.xyz), sizing_at(p).w);
        }
        p += projection_motion(field);
        if distance(p, start) > limit {
            break;
        }
    }
    return Projected(p, false, vec3(0.0), 0.0);
}
