// F and the projection onto F = 0 by one invocation.

fn surface_at(position: vec3<f32>) -> vec4<f32> {
    let cell = cell_at(position);
    var sum = vec4(0.0);
    for (var plane = 0u; plane < 16u; plane++) {
        sum += four_taps(cell, plane);
    }
    return vec4(sum.xyz * parameters.inverse_spacing, sum.w);
}

fn project(start: vec3<f32>, limit: f32) -> Projected {
    var p = start;
    for (var step = 0u; step < MOST_PROJECTION_STEPS; step++) {
        let field = surface_at(p);
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
