// The energy of a particle and its derivatives. The lanes of a team share the sum over the
// neighbours.
//
// Twin: `jet` in stages/particles/src/neighbourhood.rs
// Twin: `energy` in stages/particles/src/neighbourhood.rs
// Twin: `pair_jet`, `pair_size_derivative` in common/field/src/energy.rs

struct Jet {
    energy: f32,
    // Gradient per mm in the tangent plane. It includes the effect of the change in the particle's
    // own h with position.
    gradient: vec2<f32>,
    // Hessian per mm squared for fixed h: entries uu, uv, vv.
    hessian: vec3<f32>,
}

// The first three neighbours of a lane as (position, h). A missing neighbour is placed far away.
// Most lists have at most 24 members, three for each lane of a team of eight. They are loaded once
// and used by every attempted step.
struct Nearest {
    a: vec4<f32>,
    b: vec4<f32>,
    c: vec4<f32>,
}

fn neighbour_or_none(list: List, n: u32) -> vec4<f32> {
    if n < list.length {
        return place[member(list, n)];
    }
    return vec4(1e18, 0.0, 0.0, 1.0);
}

fn nearest_neighbours(list: List, lane: u32) -> Nearest {
    return Nearest(
        neighbour_or_none(list, lane),
        neighbour_or_none(list, lane + TEAM),
        neighbour_or_none(list, lane + 2u * TEAM),
    );
}

// first: energy, gradient (2 components), and derivative with respect to the particle's own h;
// second: Hessian (3 components).
struct Terms {
    first: vec4<f32>,
    second: vec4<f32>,
}

fn add_pair(sum: Terms, own: vec4<f32>, plane: Plane, other: vec4<f32>) -> Terms {
    let offset = own.xyz - other.xyz;
    let reach = SUPPORT * min(own.w, other.w);
    let distance = max(length(offset), LEAST_SCALED_DISTANCE * reach);
    if distance >= reach {
        return sum;
    }
    let d = distance / reach;
    let c = cotangent(d);
    let first = -FRAC_PI_2 * c * c;
    let second = 2.0 * FRAC_PI_2 * FRAC_PI_2 * c * (1.0 + c * c);
    let direction = vec2(dot(offset, plane.u), dot(offset, plane.v)) / distance;
    let along = second / (reach * reach);
    let across = first / (reach * distance);
    let by_size = select(0.0, -first * d / own.w, own.w <= other.w);
    return Terms(
        sum.first + vec4(max(c - FRAC_PI_2 * (1.0 - d), 0.0), first / reach * direction, by_size),
        sum.second + vec4(
            (along - across) * direction.x * direction.x + across,
            (along - across) * direction.x * direction.y,
            (along - across) * direction.y * direction.y + across,
            0.0,
        ),
    );
}

fn team_jet(own: vec4<f32>, plane: Plane, list: List, nearest: Nearest, lane: u32) -> Jet {
    // the gradient of h is read early to hide the latency
    let slope = sizing_at(own.xyz).xyz;
    var sum = Terms(vec4(0.0), vec4(0.0));
    sum = add_pair(sum, own, plane, nearest.a);
    sum = add_pair(sum, own, plane, nearest.b);
    sum = add_pair(sum, own, plane, nearest.c);
    for (var k = lane + 3u * TEAM; k < list.length; k += TEAM) {
        sum = add_pair(sum, own, plane, place[member(list, k)]);
    }
    let a = team_sum(sum.first, lane);
    let b = team_sum(sum.second, lane);
    return Jet(a.x, a.yz + a.w * vec2(dot(slope, plane.u), dot(slope, plane.v)), b.xyz);
}

fn team_energy(own: vec4<f32>, list: List, nearest: Nearest, lane: u32) -> f32 {
    var sum = energy_between(own.xyz - nearest.a.xyz, own.w, nearest.a.w);
    sum += energy_between(own.xyz - nearest.b.xyz, own.w, nearest.b.w);
    sum += energy_between(own.xyz - nearest.c.xyz, own.w, nearest.c.w);
    for (var k = lane + 3u * TEAM; k < list.length; k += TEAM) {
        let other = place[member(list, k)];
        sum += energy_between(own.xyz - other.xyz, own.w, other.w);
    }
    return team_sum(vec4(sum, 0.0, 0.0, 0.0), lane).x;
}
