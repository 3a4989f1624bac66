// Moves one particle with a team of lanes (sections 3.2.1 and 3.2.2, Algorithm 1 of the paper): a
// damped Newton step in the tangent plane, projection onto F = 0 (Eq. 5) and the energy test. The
// damping lambda is multiplied by ten until a step lowers the energy. The team reads the particle
// and the neighbours in its list, and writes only the particle.
//
// Twin: `step` in stages/particles/src/movement.rs

@group(0) @binding(8) var<storage, read_write> place: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> normal: array<vec4<f32>>;
// Number of attempted steps, combined with the flag STEP_TAKEN.
@group(0) @binding(12) var<storage, read_write> outcome: array<u32>;

fn move_particle(i: u32, lane: u32) {
    let own = place[i];
    let facing = normal[i];
    let list = list_of(i);
    let plane = tangent_plane(facing.xyz);
    let nearest = nearest_neighbours(list, lane);
    // most steps end in the brick where they start; loading its record early hides the latency
    choose_surface(facing.w);
    ask_for_cell(cell_at(own.xyz));
    let jet = team_jet(own, plane, list, nearest, lane);
    var tries = 0u;
    var moved = false;
    if jet.energy > 0.0 && !is_held(facing.w) {
        let curvature = positive_definite(jet.hessian);
        var lambda = damping_of(facing.w);
        while lambda < LARGEST_LAMBDA {
            let step = damped_newton(curvature, jet.gradient, lambda);
            if !(-0.5 * dot(step, jet.gradient) > LEAST_DECREASE * jet.energy) {
                break;
            }
            tries++;
            var motion = plane.u * step.x + plane.v * step.y;
            let stretch = length(motion);
            motion *= select(1.0, LONGEST_STEP * own.w / stretch, stretch > LONGEST_STEP * own.w);
            let there = project(own.xyz + motion, length(motion) + PROJECTION_REACH * own.w, lane);
            if there.found && dot(there.normal, facing.xyz) > 0.0 && distance(there.position, own.xyz) < FARTHEST_MOVE * own.w {
                let candidate = vec4(there.position, there.size);
                if team_energy(candidate, list, nearest, lane) < jet.energy {
                    moved = true;
                    if lane == 0u {
                        place[i] = candidate;
                        // if the first attempt is accepted, the next pass starts with less damping
                        let damping = select(lambda, max(LAMBDA_FALL * lambda, LEAST_LAMBDA), tries == 1u);
                        normal[i] = vec4(there.normal, with_damping(facing.w, damping));
                    }
                    break;
                }
            }
            lambda *= LAMBDA_GROWTH;
        }
    }
    if lane == 0u {
        outcome[i] = tries | select(0u, STEP_TAKEN, moved);
    }
}
