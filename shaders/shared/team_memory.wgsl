// A team is a workgroup of TEAM lanes that works for one particle. Sums go through workgroup memory
// in a fixed order. For adapters without subgroups of 32 lanes.

var<workgroup> team_scratch: array<vec4<f32>, TEAM>;

// The sum over the team's lanes, with the same bits in each lane.
fn team_sum(value: vec4<f32>, lane: u32) -> vec4<f32> {
    workgroupBarrier();
    team_scratch[lane] = value;
    workgroupBarrier();
    var sum = vec4(0.0);
    for (var other = 0u; other < TEAM; other++) {
        sum += team_scratch[other];
    }
    return sum;
}

// The team's value with the largest x, and of equal ones the smallest y; the same in each lane.
fn team_best(value: vec4<f32>, lane: u32) -> vec4<f32> {
    workgroupBarrier();
    team_scratch[lane] = value;
    workgroupBarrier();
    var best = team_scratch[0];
    for (var other = 1u; other < TEAM; other++) {
        let next = team_scratch[other];
        best = select(best, next, next.x > best.x || (next.x == best.x && next.y < best.y));
    }
    return best;
}
