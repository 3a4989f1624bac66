// The projection onto F = 0 (Eq. 5 with its sign mended), by one invocation or by a team, as `surface_at` goes.
//
// Twin: `project_with_gradient` in common/field/src/spline/mod.rs

struct Projected {
    position: vec3<f32>,
    found: bool,
    normal: vec3<f32>,
    size: f32,
}

// What a step of the projection says: 0 go on, 1 arrived, 2 lost. `field` is gradient per mm and value.
fn projection_state(field: vec4<f32>) -> u32 {
    let squared = dot(field.xyz, field.xyz);
    if !(squared > LEAST_SQUARED_GRADIENT) {
        return 2u;
    }
    return select(0u, 1u, abs(field.w) <= parameters.tolerance * min(sqrt(squared), 1.0));
}

fn projection_motion(field: vec4<f32>) -> vec3<f32> {
    let motion = field.xyz * (-field.w / dot(field.xyz, field.xyz));
    let distance = length(motion);
    return motion * select(1.0, parameters.projection_step / distance, distance > parameters.projection_step);
}

fn project(start: vec3<f32>, limit: f32, lane: u32) -> Projected {
    var p = start;
    for (var step = 0u; step < PROJECTION_STEPS; step++) {
        let field = surface_at(p, lane);
        let state = projection_state(field);
        if state == 2u {
            break;
        }
        if state == 1u {
            return Projected(p, is_real(p, lane), normalize(field.xyz), sizing_at(p).w);
        }
        p += projection_motion(field);
        if distance(p, start) > limit {
            break;
        }
    }
    return Projected(p, false, vec3(0.0), 0.0);
}
