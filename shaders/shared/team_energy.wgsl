// Energy of a particle with its derivatives, by a team whose lanes share out the neighbours: the twin of energy_jet and energy_at
// in stages/particles/src.

struct Jet {
    energy: f32,
    // In the tangent plane, per mm; with the part of the particle's own h, which changes with its place.
    gradient: vec2<f32>,
    // Entries uu, uv, vv, per mm squared, h held fixed.
    hessian: vec3<f32>,
}

// The lane's first neighbour, kept at hand because it is looked at in every try (most lists are no longer than a team); far
// away when the list is shorter.
fn first_neighbour(range: vec2<u32>, lane: u32) -> vec4<f32> {
    if range.x + lane < range.y {
        return place[lists[range.x + lane]];
    }
    return vec4(1e18, 0.0, 0.0, 1.0);
}

fn team_jet(own: vec4<f32>, plane: Plane, range: vec2<u32>, nearest: vec4<f32>, lane: u32) -> Jet {
    // asked for before it is needed, so that the memory answers meanwhile
    let slope = sizing_at(own.xyz).xyz;
    // energy, gradient (2), derivative by the particle's size
    var a = vec4(0.0);
    var b = vec4(0.0);
    var other = nearest;
    for (var k = range.x + lane; k < range.y; k += TEAM) {
        if k >= range.x + TEAM {
            other = place[lists[k]];
        }
        let offset = own.xyz - other.xyz;
        let reach = SUPPORT * min(own.w, other.w);
        let distance = max(length(offset), 1e-6 * reach);
        if distance < reach {
            let d = distance / reach;
            let c = cotangent(d);
            let first = -HALF_PI * c * c;
            let second = 2.0 * HALF_PI * HALF_PI * c * (1.0 + c * c);
            let direction = vec2(dot(offset, plane.u), dot(offset, plane.v)) / distance;
            let along = second / (reach * reach);
            let across = first / (reach * distance);
            let by_size = select(0.0, -first * d / own.w, own.w <= other.w);
            a += vec4(max(c - HALF_PI * (1.0 - d), 0.0), first / reach * direction, by_size);
            b += vec4(
                (along - across) * direction.x * direction.x + across,
                (along - across) * direction.x * direction.y,
                (along - across) * direction.y * direction.y + across,
                0.0,
            );
        }
    }
    a = team_sum(a, lane);
    b = team_sum(b, lane);
    return Jet(a.x, a.yz + a.w * vec2(dot(slope, plane.u), dot(slope, plane.v)), b.xyz);
}

fn team_energy(own: vec4<f32>, range: vec2<u32>, nearest: vec4<f32>, lane: u32) -> f32 {
    var sum = 0.0;
    var other = nearest;
    for (var k = range.x + lane; k < range.y; k += TEAM) {
        if k >= range.x + TEAM {
            other = place[lists[k]];
        }
        sum += energy_between(own.xyz - other.xyz, own.w, other.w);
    }
    return team_sum(vec4(sum, 0.0, 0.0, 0.0), lane).x;
}
