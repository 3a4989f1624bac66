// F and the projection onto F = 0 by a team: the 64 taps are spread over its lanes.

fn team_surface_at(position: vec3<f32>, lane: u32) -> vec4<f32> {
    let cell = cell_at(position);
    var sum = vec4(0.0);
    for (var tap = lane; tap < 64u; tap += TEAM) {
        sum += spline_tap(cell, tap);
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
