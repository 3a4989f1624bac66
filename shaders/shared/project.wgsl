// Projection onto F = 0 or onto a material interface by a team of lanes (Eq. 5 with its sign
// corrected).
//
// Twin: `project_with_gradient` in common/field/src/spline/mod.rs

struct Projected {
    position: vec3<f32>,
    found: bool,
    normal: vec3<f32>,
    size: f32,
}

// Returns the state of a projection: 0 if it must continue, 1 if it has converged, 2 if it fails
// because the gradient is too small. `field` contains the gradient per mm (xyz) and the value (w).
fn projection_state(field: vec4<f32>) -> u32 {
    let squared = dot(field.xyz, field.xyz);
    if !(squared > LEAST_SQUARED_GRADIENT) {
        return 2u;
    }
    return select(0u, 1u, abs(field.w) <= parameters.tolerance * min(sqrt(squared), 1.0));
}

// Returns the Newton step of Eq. 5 in mm, limited to projection_step.
fn projection_motion(field: vec4<f32>) -> vec3<f32> {
    let motion = field.xyz * (-field.w / dot(field.xyz, field.xyz));
    let distance = length(motion);
    return motion * select(1.0, parameters.projection_step / distance, distance > parameters.projection_step);
}

// Projects `start`. The projection fails if it displaces the point by more than `limit` mm. With
// many materials, the end point is rejected if a third material is at least as close as the two
// materials of the interface. The differences from third materials are evaluated in the same loop
// as the Newton steps, because a second copy of `surface_at` would cost registers in every step.
fn project(start: vec3<f32>, limit: f32, lane: u32) -> Projected {
    var there = Projected(start, false, vec3(0.0), 0.0);
    var is_there = false;
    var checks = CHECKS_PASS;
    var step = 0u;
    loop {
        let field = surface_at(there.position, lane);
        if !is_there {
            let state = projection_state(field);
            if state == 2u {
                break;
            }
            if state == 0u {
                there.position += projection_motion(field);
                step++;
                if step >= PROJECTION_STEPS || distance(there.position, start) > limit {
                    break;
                }
                continue;
            }
            is_there = true;
            there.normal = normalize(field.xyz);
            checks = begin_checks(cell_at(there.position));
        } else if !passes_check(field.w) {
            checks = CHECKS_FAIL;
        }
        if checks != CHECKS_FAIL {
            checks = open_check(cell_at(there.position));
        }
        if checks != CHECKS_GO_ON {
            break;
        }
    }
    if is_there {
        there.found = checks == CHECKS_PASS && is_in_grid(there.position);
        there.size = sizing_at(there.position).w;
        end_checks();
    }
    return there;
}
